"""Exported MJCF files: plain MuJoCo simulates them exactly as the environment does, and they are readable."""

from __future__ import annotations

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Comment, TreeBuilder, XMLParser, parse

import gymnasium
import mujoco
import numpy as np
import pytest

import magical_mj
from magical_mj._version import __version__
from magical_mj.assets import style
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, SUBSTEPS
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.engine import Engine
from magical_mj.engine.export import DECIMALS, LINE
from magical_mj.protocol import PROTOCOL
from magical_mj.scene import Block, GoalRegion, Pebble, Robot, Scene
from magical_mj.scene.bodies import BODIES
from magical_mj.scene.constants import SHAPES
from magical_mj.shifts import Factor, Shift
from magical_mj.utils.errors import InvalidSceneError, SettingsError
from tests.helpers.environments import TWO_EACH

PAGE = Path(__file__).parents[2] / "docs" / "exported-model.md"
LOAD, SCENES, EPISODE, TWO, MJX, WARP = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
PLAYER = f"""
import sys
import numpy as np
for name in ("magical_mj", "dm_control", "gymnasium"):
    sys.modules[name] = None  # importing them fails
{LOAD}
from pathlib import Path
for path in sorted(Path(sys.argv[1]).glob("*.xml")):
    model, data, act, horizon = load(str(path))
    track = []
    for action in np.load(path.with_suffix(".npy")):
        act(action)
        track.append(np.concatenate([data.qpos, data.qvel, data.sensordata]))
    np.savez(path.with_suffix(".npz"), track=track, horizon=horizon)
"""


def started(task: str, variant: str = "Demo", seed: int = 3) -> Engine:
    env = magical_mj.Engine(task, variant)
    env.reset(seed=seed)
    return env


def exported(source: Scene | Engine, folder: Path) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """Model and data of the file, at its keyframe."""
    model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(source, folder / "model.xml", overwrite=True)))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    return model, data


def numeric(model: mujoco.MjModel, name: str) -> np.ndarray:
    index = model.numeric(name).id
    return model.numeric_data[model.numeric_adr[index] :][: model.numeric_size[index]]


def texts(model: mujoco.MjModel) -> dict[str, str]:
    """The texts in `<custom>`, by name."""
    names = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_TEXT, index): index for index in range(model.ntext)}
    return {
        name: model.text_data[model.text_adr[index] :][: model.text_size[index] - 1].decode()
        for name, index in names.items()
    }


def test_an_export_has_the_number_of_steps_of_its_episode(tmp_path: Path) -> None:
    env = gymnasium.make("magical_mj/FindDupe-Demo-State-v0", max_episode_steps=30)
    env.reset(seed=0)
    model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(env, tmp_path / "short.xml")))
    assert model.numeric("horizon").data.tolist() == [30]


def test_the_file_alone_plays_every_task_and_variant_to_the_bit(tmp_path: Path) -> None:
    """With the program in the docs, which imports only MuJoCo and NumPy."""
    tracks = {}
    for task, variant in TWO_EACH:
        env = started(task, variant)
        path = magical_mj.export_mjcf(env, tmp_path / f"{task}-{variant}.xml")
        assert env.horizon is not None
        actions = np.random.default_rng(0).integers(18, size=env.horizon)
        actions[: env.horizon // 2] = np.resize([1, 1, 1, 1, 9, 10, 10, 10, 13, 2], env.horizon // 2)
        np.save(path.with_suffix(".npy"), actions)
        rows = []
        for action in actions.tolist():
            env.step(action)
            rows.append(np.concatenate([env.data.qpos, env.data.qvel]))
        tracks[f"{task}-{variant}"] = np.array(rows), env.horizon
        env.close()
    subprocess.run([sys.executable, "-c", PLAYER, tmp_path], check=True, timeout=300)
    for name, (expected, horizon) in tracks.items():
        with np.load(tmp_path / f"{name}.npz") as played:
            np.testing.assert_array_equal(played["track"][:, : expected.shape[1]], expected, err_msg=name)
            assert played["horizon"] == horizon


def run_page(*blocks: str, **names: Any) -> dict[str, Any]:
    """Runs code of the docs page in a namespace, and returns the namespace."""
    exec(compile("\n".join(blocks), str(PAGE), "exec"), names)
    return names


def sensed_scene(initial: Scene, data: mujoco.MjData) -> Scene:
    """The scene that the sensors measure. After a step of MuJoCo, they show the state before it."""
    robot, *blocks = (
        [data.sensor(f"{name}_{axis}").data[0] for axis in ("x", "y", "angle")]
        for name in ("robot", *(f"block{index}" for index in range(len(initial.blocks))))
    )
    return initial.moved(robot=robot, blocks=blocks)


def test_the_pages_episode_ends_in_its_last_physics_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The score by the page's code is the engine's. A score from sensors would differ."""
    monkeypatch.chdir(tmp_path)
    printed: list[float] = []
    page = run_page(LOAD, SCENES, EPISODE, print=printed.append)
    engine = magical_mj.Engine("MoveToRegion", "Layout", seed=21)
    for action in [1] * 8 + [7] * 8 + [4] * 24:
        engine.step(action)
    assert printed == [engine.score()] == [1.0]
    late = sensed_scene(engine.initial_scene, page["data"])
    assert magical_mj.score("MoveToRegion", engine.initial_scene, late) == 0.0


def test_the_pages_scores_and_poses_are_the_engines_to_the_bit(tmp_path: Path) -> None:
    """Over 40 seeds, 5 of each task."""
    page, late = run_page(LOAD, SCENES), 0
    for task, variant in dict(magical_mj.ENVIRONMENTS).items():  # keeps the last variant of each task: All
        engine = magical_mj.Engine(task, variant)
        for seed in range(5):
            engine.reset(seed=seed)
            path = magical_mj.export_mjcf(engine, tmp_path / "model.xml", overwrite=True)
            model, data, act, horizon = page["load"](str(path))
            assert horizon == engine.horizon
            for action in np.random.default_rng(seed).choice([1, 4, 7, 10], 4).repeat(4).tolist():
                engine.step(action)
                act(action)
                if seed % 2:  # must not change the rollout
                    mujoco.mj_forward(model, data)
            initial, final = page["scenes"](model, data)
            assert initial == engine.initial_scene
            fingers = engine.scene.robot.fingers
            assert dataclasses.replace(final, robot=dataclasses.replace(final.robot, fingers=fingers)) == engine.scene
            assert magical_mj.score(task, initial, final) == engine.score()
            late += sensed_scene(initial, data) != final
            mujoco.mj_forward(model, data)
            assert sensed_scene(initial, data) == final
    assert late > 15, "without mj_forward, sensors show an earlier state"


def test_two_scenes_in_one_model_move_as_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    tasks = {"left/": "FindDupe", "right/": "MatchRegions"}
    page = run_page(TWO)  # exports both
    for task in tasks.values():
        (tmp_path / f"{task}.xml").unlink()
        magical_mj.export_mjcf(started(task), tmp_path / f"{task}.xml")
    both, data = page["model"], page["data"]
    mujoco.mj_resetDataKeyframe(both, data, both.key("right/now").id)
    alone = {prefix: run_page(LOAD)["load"](f"{task}.xml") for prefix, task in tasks.items()}
    for model in (both, *(model for model, *_ in alone.values())):
        model.opt.tolerance, model.opt.iterations = 1e-15, 100  # the tolerance applies to both scenes together
    for number in range(40):
        for step, (prefix, (model, _, act, _)) in enumerate(alone.items()):
            action = [1, 4, 10, 7][(number // 3 + step) % 4]
            act(action)
            for actuator, value in zip(range(model.nu), controls()[action], strict=True):
                data.actuator(prefix + model.actuator(actuator).name).ctrl = value
        mujoco.mj_step(both, data, SUBSTEPS)
    for prefix, (model, single, _, _) in alone.items():
        names = [model.joint(index).name for index in range(model.njnt)]
        now = [data.joint(prefix + name).qpos[0] for name in names]
        np.testing.assert_allclose(now, [single.joint(name).qpos[0] for name in names], atol=1e-6)
    assert both.opt.enableflags & mujoco.mjtEnableBit.mjENBL_SLEEP
    assert len({both.geom(index).name for index in range(both.ngeom)}) == both.ngeom


def plain(path: Path) -> mujoco.MjData:
    """The state after two actions, computed by MuJoCo."""
    _, data, act, _ = run_page(LOAD)["load"](str(path))
    for action in (1, 4):
        act(action)
    return data


@pytest.mark.weekly
@pytest.mark.xdist_group("warp")
@pytest.mark.filterwarnings("default")
def test_warp_needs_only_the_pages_flag(tmp_path: Path) -> None:
    mujoco_warp, warp = pytest.importorskip("mujoco_warp"), pytest.importorskip("warp")
    path = magical_mj.export_mjcf(started("MoveToRegion"), tmp_path / "MoveToRegion.xml")
    model = mujoco.MjModel.from_xml_path(str(path))
    exec(WARP, {"mujoco": mujoco, "model": model})
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("now").id)
    on_device, state = mujoco_warp.put_model(model), mujoco_warp.put_data(model, data, nworld=2)
    for action in (1, 4):
        state.ctrl = warp.array([controls()[action]] * 2, dtype=float)
        for _ in range(SUBSTEPS):
            mujoco_warp.step(on_device, state)
    np.testing.assert_allclose(state.qpos.numpy(), [plain(path).qpos] * 2, atol=1e-4)


@pytest.mark.slow
def test_the_pages_code_runs_in_mjx(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("mujoco.mjx")
    monkeypatch.chdir(tmp_path)
    path = magical_mj.export_mjcf(started("MoveToRegion"), tmp_path / "MoveToRegion.xml")
    model, data, *_ = run_page(LOAD)["load"](str(path))
    data.ctrl[:] = controls()[1]
    state = run_page(MJX, model=model, data=data)["state"]
    mujoco.mj_step(model, data)
    np.testing.assert_allclose(state.qpos, data.qpos, atol=1e-7)


@pytest.mark.parametrize("camera", ["allo", "ego"])
def test_depths_are_distances(camera: str, tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(started("MoveToRegion"), tmp_path / "model.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with mujoco.Renderer(model, 96, 96) as renderer:
        renderer.enable_depth_rendering()
        renderer.update_scene(data, camera)
        depth = renderer.render()
    assert depth.min() == pytest.approx(style.CAMERA_HEIGHT - style.ROBOT_HEIGHT - 3 * style.LIFT, abs=1e-4)
    assert depth.max() == pytest.approx(
        style.CAMERA_HEIGHT + (FOOT_RADIUS - FOOT_DEPTH if camera == "ego" else 0), abs=1e-4
    )  # outside


@pytest.mark.parametrize(("task", "variant", "seed"), [("FindDupe", "All", 7), ("MatchRegions", "Demo", 2**70)])
def test_files_say_what_they_hold(task: str, variant: str, seed: int, tmp_path: Path) -> None:
    env = started(task, variant, seed)
    env.step(10)
    model, _ = exported(env, tmp_path)
    said = texts(model)
    assert Scene.from_json(said.pop("scene")) == env.initial_scene
    assert said == {"task": task, "variant": variant, "seed": str(seed), "rules": "paper"}
    np.testing.assert_array_equal(numeric(model, "controls").reshape(18, 6), controls())
    for name, value in {"horizon": env.horizon, "substeps": SUBSTEPS, "protocol": PROTOCOL}.items():
        assert numeric(model, name).tolist() == [value]
    head = (tmp_path / "model.xml").read_text()[:500]
    for word in (f"{task}, variant {variant}, seed {seed}", f"magical-mj {__version__}", "mujoco.viewer", '"controls"'):
        assert word in head


def test_a_file_whose_actions_are_speeds_speaks_of_no_controls(tmp_path: Path) -> None:
    model, _ = exported(started("SweepToTop", "Demo", 0), tmp_path)
    with pytest.raises(KeyError):
        numeric(model, "controls")
    head = (tmp_path / "model.xml").read_text()[:600]
    assert "write its speeds into ctrl" in head
    assert '"controls"' not in head


def test_plain_scenes_have_no_task_and_no_horizon(tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("FindDupe", "Demo", 0)
    env = magical_mj.Engine.of_scene(scene)
    env.reset()
    for source in (scene, env):
        model, _ = exported(source, tmp_path)
        assert {name: json.loads(text) for name, text in texts(model).items()} == {"scene": json.loads(scene.to_json())}
        names = {model.numeric(index).name for index in range(model.nnumeric)}
        assert names == {"controls", "substeps", "protocol"}


def test_scenes_that_were_given_have_no_seed(tmp_path: Path) -> None:
    env = magical_mj.Engine("FindDupe", seed=5)
    env.reset()
    assert texts(exported(env, tmp_path)[0])["seed"] == "5"  # of the first episode
    pinned = magical_mj.Engine("FindDupe", scene=magical_mj.sample_scene("FindDupe", "All", 3), rules="released")
    pinned.reset()
    assert texts(exported(pinned, tmp_path)[0]).keys() == {"scene", "task", "rules"}, "nor a variant"
    assert texts(exported(pinned, tmp_path)[0])["rules"] == "released"
    env.reset(scene=magical_mj.sample_scene("FindDupe", "Demo", 4))
    assert "seed" not in texts(exported(env, tmp_path)[0])
    env.reset(seed=9)
    assert texts(exported(env, tmp_path)[0])["seed"] == "9"


def test_files_can_be_read(tmp_path: Path) -> None:
    """One element per line, in short lines, with comments, and legal for every XML parser."""
    env = started("MatchRegions", "All")
    path = magical_mj.export_mjcf(env, tmp_path / "model.xml")
    root = parse(path, XMLParser(target=TreeBuilder(insert_comments=True))).getroot()
    lines = path.read_text().splitlines()
    assert max(len(line) for line in lines if '":' not in line) <= LINE  # except JSON, a line for each object
    assert all(line.count("<") <= 1 for line in lines)
    sections = [section.tag for section in root if section.tag is not Comment]
    expected = (
        "custom compiler option size visual statistic default asset "
        "worldbody contact tendon actuator sensor keyframe asset"
    )
    assert sections == expected.split()
    remarks = " ".join(str(element.text) for element in root.iter(Comment))
    for word in ("wheels", "rotors", "castor", "foot", "motors", "Goal region 0", "Block 0", "lamps"):
        assert word in remarks
    for index, block in enumerate(env.initial_scene.blocks):
        assert root.find(f".//geom[@name='block{index}_{block.colour}_{block.shape}_sides']") is not None
    world = root.find("worldbody")
    assert world is not None
    assert all(element.get("name") for tag in ("body", "geom", "light", "camera") for element in world.iter(tag))
    shown = {geom.get("mesh") for geom in root.iter("geom")} - {None}
    assert [mesh.get("name") for mesh in root.iter("mesh") if mesh.get("name") not in shown] == []
    assert list(root)[-1].find("mesh") is not None, "vertices come last"
    assert not any("rgba" in geom.attrib for geom in root.iter("geom")), "colours have names"
    materials = {material.get("name") for material in root.iter("material")}
    assert materials == {geom.get("material") for geom in root.iter("geom")} - {None}
    soft = [
        value for element in world.iter() for name, value in element.items() if name.startswith(("solref", "solimp"))
    ]
    assert soft == [], "softness is that of classes"


@pytest.mark.parametrize("body", BODIES)
def test_rounded_coordinates_do_not_change_the_physics(body: str, tmp_path: Path) -> None:
    """All physics parameters equal the environment's to the bit. Names, colours and visual geoms differ."""
    blocks = tuple(Block(shape, "red", 0.4 * index - 0.6, 0.5, 0.3) for index, shape in enumerate(SHAPES))
    scene = Scene(
        Robot(0, -0.5, 0.3, body=body), (*blocks, Block("star", "blue", 0, 0.1, 1, 0.01)), pebbles=(Pebble(0.5, -0.5),)
    )
    model, _ = exported(scene, tmp_path)
    right = mujoco.MjModel.from_xml_string(scene_mjcf(scene))
    looks = ("name", "mesh_", "mat_", "bvh_", "skin_", "text_", "numeric_", "sensor_", "key_", "path", "body_bvh")
    drawn = np.isin(right.geom_group, (style.SOLID_GROUP, style.DRAWN_GROUP, style.TASK_GROUP))
    drawn[right.geom("floor").id] = False
    compared = 0
    for name in dir(right):
        numbers = getattr(right, name)
        if name.startswith(("_", *looks)) or not isinstance(numbers, np.ndarray):
            continue
        others = getattr(model, name)
        if name in ("geom_rgba", "geom_matid", "geom_dataid"):
            continue
        if name.startswith("geom_"):
            numbers, others = numbers[~drawn], others[~drawn]
        np.testing.assert_array_equal(others, numbers, err_msg=name)
        compared += 1
    assert compared > 200
    vertices = [
        mesh.get("vertex", "")
        for mesh in parse(tmp_path / "model.xml").getroot().iter("mesh")
        if not mesh.get("name", "").endswith("_outline")
    ]
    assert all(len(word.partition(".")[2]) <= DECIMALS for text in vertices for word in text.split())


def test_numbers_are_short_and_exact(tmp_path: Path) -> None:
    env = started("FindDupe", "Dynamics")
    for action in (1, 1, 10, 13):
        env.step(action)
    root = parse(magical_mj.export_mjcf(env, tmp_path / "model.xml")).getroot()
    checked = 0
    for element in root.iter():
        for name, value in element.items():
            for number in value.split() if name not in ("data", "name") else []:
                if re.fullmatch(r"-?\d+\.\d{7,}(e-?\d+)?", number) and element.tag != "mesh":
                    assert repr(float(number)) == number
                    checked += 1
    assert checked > 50
    option = root.find("option")
    assert option is not None
    assert option.get("timestep") == "0.0125"


def test_keyframe_is_the_present_state(tmp_path: Path) -> None:
    env = started("FindDupe", "Dynamics", 1)
    for action in (1, 1, 10, 13, 13):
        env.step(action)
    model, data = exported(env, tmp_path)
    np.testing.assert_array_equal(data.qpos, env.data.qpos)
    np.testing.assert_array_equal(data.qvel, env.data.qvel)
    for action in (10, 10, 1, 4, 4, 4):  # from then on, both agree up to rounding
        env.step(action)
        data.ctrl[:] = controls()[action]
        mujoco.mj_step(model, data, SUBSTEPS)
    np.testing.assert_allclose(data.qpos, env.data.qpos, atol=1e-6)


def test_sensors_are_world_coordinates_and_only_in_files(tmp_path: Path) -> None:
    env = started("ClusterShape", "All")
    for action in [1, 10, 4] * 4:
        env.step(action)
    assert env.model.nsensor == 0
    model, data = exported(env, tmp_path)
    mujoco.mj_forward(model, data)
    scene = env.scene
    for name, thing in [
        ("robot", scene.robot),
        *((f"block{index}", block) for index, block in enumerate(scene.blocks)),
    ]:
        position = [data.sensor(f"{name}_{axis}").data[0] for axis in ("x", "y", "angle")]
        np.testing.assert_allclose(position, (thing.x, thing.y, thing.angle), atol=1e-12)
        np.testing.assert_allclose(data.body(name).xpos[:2], position[:2], atol=1e-12)
    assert tuple(data.sensor(f"{side}_finger").data[0] for side in ("left", "right")) == scene.robot.fingers
    assert np.hypot(*(data.sensor(f"robot_{axis}_velocity").data[0] for axis in "xy")) > 0.1


def test_reference_pose_is_the_scene(tmp_path: Path) -> None:
    """A viewer that ignores keyframes shows the scene, with a free camera that sees all of it."""
    scene = magical_mj.sample_scene("ClusterShape", "All", 4)
    model, data = exported(scene, tmp_path)
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    for index, block in enumerate(scene.blocks):
        body = data.body(f"block{index}")
        np.testing.assert_allclose(body.xpos[:2], (block.x, block.y), atol=1e-9)
        np.testing.assert_allclose(body.xmat.reshape(3, 3)[0, 0], np.cos(block.angle), atol=1e-9)
    assert {model.camera(i).name for i in range(model.ncam)} == {"ego", "allo"}


def test_solid_things_are_where_they_collide(tmp_path: Path) -> None:
    """Seen from above, visual and collision geoms agree within the overlap that the physics allows."""
    regions = (GoalRegion("green", -0.9, 0.3, -0.2, 0.95),)
    blocks = (Block("square", "red", 0.5, 0.5, 0.3), Block("circle", "blue", -0.5, -0.5, 0))
    model, data = exported(Scene(Robot(0, 0, 0.5), blocks, regions), tmp_path)
    mujoco.mj_forward(model, data)
    for name, half in (("block0_red_square", 0.1063), ("block1_blue_circle", 0.12), ("robot", 0.2)):
        sides = model.geom(f"{name}_sides")
        assert sides.size[0] == pytest.approx(half, abs=1e-3)
        assert 0.07 < sides.pos[2] + sides.size[-1 if "square" in name else 1] < 0.14
    fill = data.geom("region0_green_fill")
    np.testing.assert_allclose(fill.xpos, (-0.55, 0.625, 0.001), atol=1e-9)
    np.testing.assert_allclose(model.geom("region0_green_fill").size[:2], (0.35, 0.325), atol=1e-9)


def test_files_are_not_overwritten_without_a_word(tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("MoveToRegion", "Demo", 0)
    path = magical_mj.export_mjcf(scene, tmp_path / "deep" / "scene.xml")
    with pytest.raises(FileExistsError):
        magical_mj.export_mjcf(scene, path)
    assert json.loads(texts(exported(scene, path.parent)[0])["scene"])["robot"]["x"] == scene.robot.x


def test_only_scenes_and_environments_are_exported(tmp_path: Path) -> None:
    with pytest.raises(InvalidSceneError, match="or an environment that runs one can be exported, not 3"):
        magical_mj.export_mjcf(3, tmp_path / "scene.xml")


def test_illegal_scenes_are_not_exported(tmp_path: Path) -> None:
    scene = magical_mj.sample_scene("MoveToRegion", "Demo", 0).moved(robot=(3, 0, 0))
    with pytest.raises(InvalidSceneError, match="walls"):
        magical_mj.export_mjcf(scene, tmp_path / "scene.xml")
    assert not (tmp_path / "scene.xml").exists()


def test_numbers_below_the_smallest_are_written_as_zero(tmp_path: Path) -> None:
    """MuJoCo's reader refuses them. They occur in scenes, and in actuators during an episode."""
    odd = Scene(Robot(1e-320, -1e-310, 1e-315), (Block("star", "red", 1e-320, 0.5, 1e-320),))
    engine = Engine.of_scene(odd)
    engine.step(10)
    engine.data.act[:], engine.data.qvel[:] = 8.1e-320, -1e-310
    for number, source in enumerate((odd, engine)):
        path = magical_mj.export_mjcf(source, tmp_path / f"{number}.xml")
        model = mujoco.MjModel.from_xml_path(str(path))
        numbers = np.concatenate([model.key_qpos.ravel(), model.key_qvel.ravel(), model.key_act.ravel()])
        assert (np.abs(numbers[numbers != 0]) > 1e-300).all()


class Heavy(Shift):
    name, summary = "heavy", "more mass"
    factors = (Factor("mass", "added share", (1.0, 1.0, 1.0, 1.0, 1.0), "exact"),)

    def model(self, model: Any) -> None:
        model.body_mass[:] *= 1 + self.values["mass"]


def test_physics_that_a_file_would_lack_is_refused(tmp_path: Path) -> None:
    """Changes of pictures are not part of the file, and no reason."""
    engine = magical_mj.Engine("FixColour", seed=0, shifts="camera:3+palette:3+texture:2+friction:2")
    magical_mj.export_mjcf(engine, tmp_path / "a.xml")
    engine.model.geom_friction[:] *= 2
    heavy = magical_mj.Engine("FixColour", shifts=f"{__name__}:Heavy:1")
    for changed, what in ((engine, "geom_friction"), (heavy, "body_mass")):
        with pytest.raises(SettingsError, match=rf"model was changed \(.*{what}.*\), by a shift or by hand"):
            magical_mj.export_mjcf(changed, tmp_path / "b.xml")
    assert not (tmp_path / "b.xml").exists()
