"""Shifts: strength 0 is nothing, strengths are paired, axes do not touch each other, and states hold all of it."""

from __future__ import annotations

import copy
import hashlib
import json
import pickle
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest

import magical_mj
from magical_mj.engine.export import mjcf_text
from magical_mj.shifts import SHIFTS, Factor, Shift, expand_shifts, parse_shifts, shift_label
from magical_mj.shifts.episode import draw_shifts
from magical_mj.shifts.registry import PHYSICAL, SHIFT_PROTOCOL
from magical_mj.shifts.words import SENTENCES
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import as_sentence
from magical_mj.utils.errors import (
    DemonstrationError,
    InvalidSceneError,
    MagicalError,
    SettingsError,
    ShiftError,
    UnknownNameError,
)

DRAWN = ("camera", "light", "texture", "palette", "clutter", "sensor")
ACTIONS = np.random.default_rng(0).integers(0, 18, 40).tolist()
EVERYTHING = {name: 1 + number % 5 for number, name in enumerate(SHIFTS)}


class Wrong(Shift):
    """Returns what its name says."""

    name = "wrong"

    def scene(self, scene: Any, rules: Any) -> Any:
        return "a scene" if self.values["strength"] == 1 else scene

    def action(self, commands: Any, step: int) -> Any:
        return 18 if self.values["strength"] == 2 else commands[-1]

    def delay(self, step: int) -> Any:
        return -1 if self.values["strength"] == 2 else 0

    def picture(self, picture: Any, frame: Any) -> Any:
        return picture[:-1] if self.values["strength"] == 3 else picture

    def instruction(self, instruction: str, task: str) -> Any:
        return 5 if self.values["strength"] == 4 else 1 / 0


class Nameless(Shift):
    """Has no name of its own."""


class Nothing(Shift):
    """Changes nothing: it has none of the methods."""

    name = "nothing"


class Equal(Shift):
    """Draws nothing, not even its strength."""

    name = "equal"
    factors = ()

    def picture(self, picture: Any, frame: Any) -> Any:
        return 255 - picture


def engine(shifts: Any, seed: int = 3, task: str = "FindDupe") -> magical_mj.Engine:
    return magical_mj.Engine(task, seed=seed, shifts=shifts, renderer="software")


def pictures(env: magical_mj.Engine) -> bytes:
    return env.render("ego", 48).tobytes() + env.render("allo", 48).tobytes()


def test_names_ranges_and_draws_are_those_of_their_protocol() -> None:
    about = {name: [[f.name, f.sizes, f.draw] for f in kind.factors] for name, kind in SHIFTS.items()}
    drawn = [draw_shifts({name: 3}, seed) for name in SHIFTS for seed in (0, 7)]
    with closing(engine({name: 5 for name in SHIFTS if name != "sensor"})) as env:
        start, text = env.initial_scene.digest(), env.instruction
    words = text[:1].lower() + text[1:].removesuffix(
        "."
    )  # the protocol fixes words; a capital and a full stop do not count
    told = json.dumps([about, drawn, start, words, SENTENCES["MakeLine"]])
    digest = hashlib.sha256(told.encode()).hexdigest()[:16]
    assert (SHIFT_PROTOCOL, digest) == (1, "370701a8839d2543"), "a change of shifts needs their next number"


def test_pictures_of_shifts_are_those_of_their_protocol() -> None:
    digest = hashlib.sha256()
    for axis in DRAWN:
        for seed in range(5):
            with closing(engine({axis: 4}, seed)) as env:
                digest.update(pictures(env))
    assert digest.hexdigest()[:16] == "783f13ca31e3d6bc"


def test_noise_in_large_pictures_is_the_same_again() -> None:
    """In a picture with more levels than there are numbers of noise, these are repeated."""
    draws = {"sensor": {"fault": 0, "grade": 5, "x": 0, "y": 0, "seed": 3}}
    pictures = []
    for _ in range(2):
        with closing(engine(None)) as env:
            env.reset(seed=3, draws=draws)
            pictures.append(env.render("allo", 384))
    assert np.array_equal(*pictures)


@pytest.mark.parametrize("text", ["camera:3,latency:1", "latency:1, camera:3", "camera:3,latency:1,light:0"])
def test_shifts_are_written_as_text_or_dicts_and_have_one_label(text: str) -> None:
    assert parse_shifts(text) == {"camera": 3, "latency": 1}
    assert list(parse_shifts(text)) == ["camera", "latency"]
    assert shift_label(parse_shifts(text)) == "camera:3+latency:1"
    assert parse_shifts(shift_label(parse_shifts(text)).replace("+", ",")) == parse_shifts(text)
    assert parse_shifts(None) == parse_shifts("") == {}
    assert shift_label({}) == ""


def test_evaluations_name_several_settings() -> None:
    assert expand_shifts("camera:1-2,camera:2,camera:1+latency:3") == [
        {"camera": 1},
        {"camera": 2},
        {"camera": 1, "latency": 3},
    ]
    assert expand_shifts("light") == [{"light": strength} for strength in range(1, 6)]
    assert len(expand_shifts("all")) == 5 * len(SHIFTS)
    assert not [each for each in expand_shifts("all", "MoveToCorner") if "pose" in each]


@pytest.mark.parametrize(
    ("shifts", "error", "message"),
    [
        ("camra:3", UnknownNameError, "camera"),
        ("camera", SettingsError, "has no strength"),
        ("camera:6", SettingsError, "0 .* to 5"),
        ("camera:-1", SettingsError, "0 .* to 5"),
        *((f"camera:{digits}", SettingsError, "0 .* to 5") for digits in ("2.5", "³", "9" * 5000)),
        ({"camera": True}, SettingsError, "0 .* to 5"),
        ({"camera": None}, SettingsError, "0 .* to 5"),
        ("camera:1,camera:2", SettingsError, "twice"),
        (["camera"], SettingsError, "dict"),
        ({3: 3}, UnknownNameError, "shift 3"),
        ("no.such.module:Fog:3", UnknownNameError, "no.such.module:Fog"),
        ("tests.shifts.test_shifts:DRAWN:3", ShiftError, "derived"),
        ("tests.shifts.test_shifts:Nameless:3", ShiftError, "name"),
        ("tests.shifts.test_shifts:Nothing:3", ShiftError, "changes nothing: override at least one of .* scene, model"),
        ("tests.shifts.test_shifts:Equal:3", ShiftError, "must be a tuple of one or more .* by default, the strength"),
    ],
)
def test_unknown_shifts_and_strengths_are_refused(shifts: Any, error: type[MagicalError], message: str) -> None:
    with pytest.raises(error, match=message):
        magical_mj.Engine("FindDupe", seed=0, shifts=shifts)


def test_a_task_can_lack_a_shift() -> None:
    with pytest.raises(SettingsError, match="MoveToCorner cannot have the shift 'pose'"):
        magical_mj.Engine("MoveToCorner", seed=0, shifts="pose:1")
    with pytest.raises(SettingsError, match="SweepToTop cannot have the shift 'slip'"):
        magical_mj.Engine("SweepToTop", "Layout", seed=0, shifts="slip:1")
    with pytest.raises(SettingsError, match="SweepToTop cannot have the shift 'pose': it defines its own rule"):
        magical_mj.Engine("SweepToTop", seed=0, shifts="pose:1")
    assert not [each for each in expand_shifts("all", "SweepToTop") if "pose" in each]


def test_the_levels_of_the_axis_body_are_names() -> None:
    assert shift_label(parse_shifts("camera:1,body:shortstick")) == "body:shortstick+camera:1"
    offered = [{"body": name} for name in task_spec("MoveToRegion").bodies]
    assert expand_shifts("body", "MoveToRegion") == offered
    assert not any("body" in each for each in expand_shifts("all"))
    shifted = {"shifts": {"camera": 2, "body": "mediumstick"}, "seed": 3, "renderer": "software"}
    with (
        closing(magical_mj.Engine("MoveToRegion", **shifted)) as env,
        closing(magical_mj.Engine("MoveToRegion", shifts="camera:2", body="mediumstick", seed=3)) as same,
    ):
        assert env.initial_scene == same.initial_scene
        assert env.shifts == {"camera": 2}
    for level in ("body:3", "body", "body:"):
        with pytest.raises(InvalidSceneError, match=r"unknown body '.*There are: gripper, shortstick"):
            magical_mj.Engine("MoveToRegion", shifts=level)
    with closing(magical_mj.Engine("MoveToRegion", shifts="body:longstick")) as env:  # which the expert cannot use
        assert env.scene.robot.body == "longstick"
    with closing(magical_mj.Engine("MoveToRegion", shifts="body:tests.xmagical.test_xmagical:WEDGE")) as env:
        assert env.scene.robot.body == "tests.xmagical.test_xmagical:WEDGE"


def test_demonstrations_are_made_in_physical_shifts(tmp_path: Path) -> None:
    assert PHYSICAL == ("pose", "clutter", "latency", "slip", "friction")
    shifts = {"pose": 1, "clutter": 2, "slip": 3, "friction": 5}
    demo = magical_mj.demos.demonstrate("MoveToRegion", "Demo", 4, shifts=shifts)
    assert demo.name == "MoveToRegion-Demo-pose1+clutter2+slip3+friction5"
    path = magical_mj.demos.keep(demo, tmp_path)[0]
    again = magical_mj.demos.read(path)
    assert again.digest == demo.digest
    assert again.shifts == demo.shifts
    verdict = magical_mj.demos.verify(again)
    assert verdict.good
    assert verdict.exact
    assert not magical_mj.demos.verify(replace(demo, shifts="")).good
    for shifts in ({"camera": 3}, {"tests.shifts.test_shifts:Wrong": 1}, {"body": "mediumstick"}):
        with pytest.raises(DemonstrationError, match="can have the shifts pose, clutter"):
            magical_mj.demos.demonstrate("MoveToRegion", "Demo", 4, shifts=shifts)
    with pytest.raises(DemonstrationError, match=r"not evil\.module:NAME:3"):
        magical_mj.demos.write(replace(demo, shifts="evil.module:NAME:3"), tmp_path / "other.npz")


def test_a_shift_of_ones_own_that_returns_something_else_is_named() -> None:
    wrong = "tests.shifts.test_shifts:Wrong"
    with pytest.raises(ShiftError, match=r"Wrong.scene must return a magical_mj.Scene"):
        engine({wrong: 1})
    with closing(engine({wrong: 2})) as env, pytest.raises(ShiftError, match=r"Wrong.action must return an action"):
        env.step(0)
    with closing(engine({wrong: 2})) as env, pytest.raises(ShiftError, match=r"Wrong.delay must return a number"):
        magical_mj.experts.Expert(env, "FindDupe")()
    with closing(engine({wrong: 3})) as env, pytest.raises(ShiftError, match=r"Wrong.picture must return an array"):
        env.render("ego", 48)
    with closing(engine({wrong: 4})) as env, pytest.raises(ShiftError, match=r"Wrong.instruction must return text"):
        _ = env.instruction
    with (
        closing(engine({wrong: 5})) as env,
        pytest.raises(ShiftError, match=r"ZeroDivisionError.*test_shifts.py, line"),
    ):
        _ = env.instruction


@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_strength_0_is_no_shift_and_the_axes_do_not_touch_each_other(task: str) -> None:
    for variant in (each for name, each in magical_mj.ENVIRONMENTS if name == task):
        options: dict[str, Any] = {"seed": 3, "renderer": "software"}
        plain = magical_mj.Engine(task, variant, **options)
        none = magical_mj.Engine(task, variant, shifts=dict.fromkeys(SHIFTS, 0), **options)
        for action in ACTIONS[:10]:
            for each in (plain, none):
                each.step(action)
        assert none.initial_scene == magical_mj.sample_scene(task, variant, 3)  # of which hashes are kept
        assert none.get_state() == plain.get_state()
        assert pictures(none) == pictures(plain)
    able = {name: strength for name, strength in EVERYTHING.items() if not SHIFTS[name].supports(task)}
    with closing(engine(able, task=task)) as env:
        for name, values in env.draws.items():
            assert draw_shifts({name: able[name]}, 3) == {name: values}


def test_an_engine_forgets_shifts_of_a_state_that_it_had_taken_over() -> None:
    with closing(engine(None)) as plain, closing(engine(EVERYTHING)) as shifted:
        before = pictures(plain)
        plain.set_state(shifted.get_state())
        assert pictures(plain) == pictures(shifted) != before
        plain.reset(seed=3)
        assert pictures(plain) == before
        assert not plain.draws


@pytest.mark.parametrize("axis", SHIFTS)
def test_strengths_are_paired(axis: str) -> None:
    draws = [draw_shifts({axis: strength}, 11)[axis] for strength in range(1, 6)]
    for factor in SHIFTS[axis].factors:
        values = [abs(each[factor.name]) for each in draws]
        assert values == sorted(values)
        assert len({np.sign(each[factor.name]) for each in draws} - {0}) <= 1
        assert factor.bounds[0] <= draws[-1][factor.name] <= factor.bounds[1]


def test_pose_5_is_layout_and_less_is_on_the_way() -> None:
    for task in ("MatchRegions", "FindDupe"):
        for seed in range(3):
            starts = [engine({"pose": strength}, seed, task).initial_scene for strength in range(6)]
            assert starts[0] == magical_mj.sample_scene(task, "Demo", seed)
            assert starts[5] == magical_mj.sample_scene(task, "Layout", seed)
            ways = [np.mean(np.hypot(*(places(start) - places(starts[0])).T)) for start in starts]
            assert np.array(ways[1:]) / ways[5] == pytest.approx([1 / 16, 1 / 8, 1 / 4, 1 / 2, 1], abs=0.1)


def places(scene: magical_mj.Scene) -> Any:
    """Where the robot and the blocks are. Shape (1 + blocks, 2)."""
    return np.array([(thing.x, thing.y) for thing in (scene.robot, *scene.blocks)])


def test_pebbles_are_loose_and_belong_to_no_score() -> None:
    counts = []
    for strength in range(1, 6):
        with closing(engine({"clutter": strength})) as env:
            counts.append(len(env.scene.pebbles))
            assert env.scene.blocks == magical_mj.sample_scene("FindDupe", "Demo", 3).blocks
    assert counts == [1, 2, 3, 5, 8]
    scene = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    ahead = scene.robot.x - 0.45 * np.sin(scene.robot.angle), scene.robot.y + 0.45 * np.cos(scene.robot.angle)
    scene = replace(scene, blocks=scene.blocks, pebbles=(magical_mj.scene.Pebble(*ahead),))
    assert magical_mj.Scene.from_json(scene.to_json()) == scene
    assert scene.digest() != replace(scene, pebbles=()).digest()
    with closing(magical_mj.Engine("MoveToCorner", scene=scene)) as env:
        for _ in range(12):
            env.step(1 + 9)
        (pebble,) = env.scene.pebbles
        assert np.hypot(pebble.x - ahead[0], pebble.y - ahead[1]) > 0.1


def test_latency_delays_actions() -> None:
    with closing(engine({"latency": 2})) as late, closing(engine(None)) as prompt:
        for action in (0, 0, *ACTIONS[:-2]):
            prompt.step(action)
        for action in ACTIONS:
            late.step(action)
        assert late.scene == prompt.scene


def test_unequal_wheels_drive_a_curve_and_the_exported_model_too() -> None:
    with closing(engine({"slip": 5})) as env:
        veer = env.initial_scene.dynamics.veer
        model = mujoco.MjModel.from_xml_string(mjcf_text(env))
        rows = model.numeric_data[model.numeric("controls").adr[0] :][: 18 * 6].reshape(18, 6)
        assert rows[1, 2] == pytest.approx(0.8 * veer)
        scene = env.initial_scene
    with closing(magical_mj.Engine("FindDupe", scene=scene)) as env:
        for _ in range(4):
            env.step(1)
        assert np.sign(env.scene.robot.angle - scene.robot.angle) == np.sign(veer)


def test_dm_env_takes_a_body_among_the_shifts() -> None:
    pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")
    shifted = magical_mj.load("MoveToRegion", shifts={"camera": 2, "body": "mediumstick"}, seed=3)
    same = magical_mj.load("MoveToRegion", shifts="camera:2", body="mediumstick", seed=3)
    assert shifted.initial_scene == same.initial_scene


@pytest.mark.parametrize("renderer", ["software", "opengl"])
def test_states_copies_and_both_interfaces_continue_in_the_same_way(renderer: str) -> None:
    pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")
    with closing(magical_mj.Engine("FindDupe", seed=3, shifts=EVERYTHING, renderer=renderer)) as env:
        composer = magical_mj.load("FindDupe", seed=3, shifts=EVERYTHING)
        composer.reset()
        for action in ACTIONS[:20]:
            env.step(action)
            composer.step(action)
        twins = [env.clone(), pickle.loads(pickle.dumps(env)), copy.deepcopy(composer)]
        other = magical_mj.Engine("FindDupe", seed=0, renderer=renderer)
        other.set_state(env.get_state())
        for action in ACTIONS[20:]:
            for each in (env, composer, other, *twins):
                each.step(action)
        for each in (composer, other, *twins):
            assert each.get_state() == env.get_state()
        for each in (other, *twins[:2]):
            assert pictures(each) == pictures(env)
        if renderer == "opengl":
            assert np.array_equal(composer.render("ego", 48), env.render("ego", 48))


def test_both_renderers_show_the_same_shifts() -> None:
    for axis in DRAWN:
        both = [
            magical_mj.Engine("FindDupe", seed=5, shifts={axis: 5}, renderer=each) for each in ("software", "opengl")
        ]
        one, other = (each.render("ego", 96).astype(int) for each in both)
        assert np.mean(np.abs(one - other)) < 0.6, axis


def floor(env: magical_mj.Engine) -> Any:
    """Where the floor alone is seen from above. Shape (96, 96)."""
    return (env.render("allo", 96) == 255).all(axis=2) & (env.render("allo-segmentation", 96) == 0)


def test_the_ground_moves_with_the_world_and_not_with_the_robot() -> None:
    with closing(engine({"texture": 5}, seed=1)) as env, closing(engine(None, seed=1)) as plain:
        bare = floor(plain)
        before = env.render("allo", 96)
        for _ in range(10):
            for each in (env, plain):
                each.step(1)
        bare &= floor(plain)
        assert np.array_equal(before[bare], env.render("allo", 96)[bare])
        assert not (before[bare] == 255).all()


def test_the_four_colours_stay_apart() -> None:
    """Squared distances of levels between the fills of two colours: at least 40 levels for every draw."""
    from magical_mj.assets.style import BLOCK_FILL
    from magical_mj.shifts.drawn import turned

    fills = np.array(list(BLOCK_FILL.values()), np.float32) / 255
    for hue in range(-120, 121, 8):
        for change in (-0.4, 0, 0.4):
            colours = 255 * turned(fills, hue, change)
            gaps = [np.linalg.norm(colours[a] - colours[b]) for a in range(4) for b in range(a)]
            assert min(gaps) > 40, (hue, change)


def test_agents_that_read_get_sentences() -> None:
    for sentences in SENTENCES.values():
        assert [len(group) for group in sentences] == [5] * 5
        assert len({sentence for group in sentences for sentence in group}) == 25
    assert set(SENTENCES) == set(magical_mj.TASKS)
    options: dict[str, Any] = {"shifts": "words:5", "instruction": True, "renderer": "software"}
    with closing(gymnasium.make("magical_mj/FindDupe-Demo-LoResStack-v0", **options)) as env:
        observation, info = env.reset(seed=1)
        assert observation["instruction"] == info["instruction"] in map(as_sentence, SENTENCES["FindDupe"][4])
        assert env.observation_space.contains(observation)
    with closing(gymnasium.make("magical_mj/FindDupe-Demo-LoResStack-v0", renderer="software")) as env:
        observation, info = env.reset(seed=1)
        assert "instruction" not in observation.keys() | info.keys()


def test_intents_have_other_words_at_each_strength() -> None:
    intent = magical_mj.intents.parse("in(colour=red, region)")
    for strength in range(1, 6):
        options: dict[str, Any] = {"shifts": f"words:{strength}", "instruction": True, "renderer": "software"}
        with closing(gymnasium.make(magical_mj.env_id(f"intent:{intent}", "Demo", "LoResStack"), **options)) as env:
            observation, info = env.reset(seed=1)
            assert observation["instruction"] == info["instruction"] in intent.wordings[strength - 1]
            assert env.observation_space.contains(observation)


def test_factors_are_0_without_the_shift() -> None:
    with closing(engine(None)) as plain, closing(engine(None)) as env:
        env.reset(
            seed=3, draws={name: {f.name: 0 for f in kind.factors} | {"seed": 3} for name, kind in SHIFTS.items()}
        )
        assert env.scene == plain.scene
        for action in ACTIONS[:5]:
            env.step(action)
            plain.step(action)
        assert env.scene == plain.scene
        gaps = np.abs(env.render("ego", 96).astype(int) - plain.render("ego", 96))
        assert np.mean(gaps) < 0.1  # at the edge of the ground, which is drawn differently
        assert env.instruction == plain.instruction


def test_a_factor_has_bounds() -> None:
    assert Factor("a", "", (1, 2, 3, 4, 5)).bounds == (-5, 5)
    assert Factor("a", "", (5,) * 5, "choice").bounds == (0, 4)
    for sizes, draw in (((1, 2), "exact"), ((1,) * 5, "unsigned")):
        with pytest.raises(ShiftError, match="needs 5 sizes"):
            Factor("a", "", sizes, draw)  # type: ignore[arg-type]
