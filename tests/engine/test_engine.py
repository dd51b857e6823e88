"""The engine: scenes, horizons, scores, determinism, clear errors, and arbitrary legal scenes."""

from __future__ import annotations

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import magical_mj
from magical_mj.actions import Action, Drive
from magical_mj.engine import Engine
from magical_mj.observations import CAMERAS, MAX_BLOCKS, MAX_REGIONS, START_NAMES, STATE_NAMES
from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import (
    ClosedError,
    InvalidActionError,
    InvalidSceneError,
    InvalidSeedError,
    PhysicsError,
    SettingsError,
    StateError,
    UnknownNameError,
)

FORWARD = Action(drive=Drive.FORWARD).number


def poses(scene: Scene) -> np.ndarray:
    return np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])


def test_scenes_survive_the_simulator_and_nothing_moves_when_nothing_acts() -> None:
    for task, variant in magical_mj.ENVIRONMENTS:
        engine, scene = Engine(task, variant, seed=6), magical_mj.sample_scene(task, variant, 5)
        engine.reset(seed=5)
        now = engine.scene
        assert engine.initial_scene == scene
        np.testing.assert_allclose(poses(now), poses(scene), atol=1e-6)
        np.testing.assert_allclose(now.robot.fingers, scene.robot.fingers, atol=1e-6)
        assert (now.regions, now.dynamics) == (scene.regions, scene.dynamics)
        assert [(b.shape, b.colour) for b in now.blocks] == [(b.shape, b.colour) for b in scene.blocks]
        for _ in range(min(100, task_spec(task).horizon() - 1)):
            engine.step(0)
        assert np.abs(poses(engine.scene) - poses(scene)).max() < 1e-4
        assert np.abs(np.subtract(engine.fingers(), scene.robot.fingers)).max() < 1e-4


@pytest.mark.parametrize("rules", ["paper", "released"])
def test_horizons_are_exact(rules: Any) -> None:
    for task in magical_mj.TASKS:
        engine = Engine(task, seed=0, rules=rules)
        assert engine.horizon == task_spec(task).horizon(rules)
        for seed in range(2):
            engine.reset(seed=seed)
            ends = [engine.step(FORWARD) for _ in range(engine.horizon)]
            assert ends == [False] * (engine.horizon - 1) + [True]
            assert engine.over
            assert engine.score() == magical_mj.score(task, engine.initial_scene, engine.scene, rules=rules)
            with pytest.raises(StateError, match="over"):
                engine.step(0)


def test_seeds_give_the_sampled_scenes_and_a_reset_alone_starts_again() -> None:
    for task, variant in magical_mj.ENVIRONMENTS[::7]:
        engine = Engine(task, variant, seed=7)
        assert engine.initial_scene == magical_mj.sample_scene(task, variant, 7)
        engine.step(FORWARD)
        engine.reset()
        assert (engine.seed, engine.steps) == (7, 0)
        assert engine.initial_scene == magical_mj.sample_scene(task, variant, 7)
        engine.reset(seed=2**80)
        assert engine.initial_scene == magical_mj.sample_scene(task, variant, 2**80)
        engine.reset(scene=magical_mj.sample_scene(task, variant, 3))
        assert engine.seed is None


DIGEST_PROGRAM = """
import hashlib, numpy, magical_mj
digest = hashlib.sha256()
for task, variant in [("FindDupe", "All"), ("ClusterShape", "CountPlus"), ("MoveToCorner", "Jitter")]:
    engine = magical_mj.Engine(task, variant, seed=3)
    for action in numpy.random.default_rng(0).integers(18, size=engine.horizon):
        engine.step(action)
        for value in (engine.state_vector(), engine.render("ego", 96), engine.render("allo", 96)):
            digest.update(value.tobytes())
    digest.update(repr((engine.score(), engine.scene)).encode())
print(digest.hexdigest())
"""


def test_processes_agree_bit_for_bit() -> None:
    """Same seed and actions: the same scenes, pictures, states and scores in every process."""
    outputs = [
        subprocess.run([sys.executable, "-c", DIGEST_PROGRAM], capture_output=True, text=True, check=True)
        for _ in range(2)
    ]
    assert outputs[0].stdout == outputs[1].stdout != ""
    assert outputs[0].stderr == ""  # no output when the interpreter exits


def test_a_model_that_is_used_again_draws_and_moves_as_a_fresh_one() -> None:
    used, fresh = Engine("FixColour", "All", seed=0), Engine("FixColour", "All", seed=1)
    for seed in (3, 4, 5):
        used.reset(seed=seed)
        used.step(10)
    used.reset(seed=1)
    for action in np.random.default_rng(3).integers(18, size=30).tolist():
        for view in ("ego", "allo"):
            np.testing.assert_array_equal(used.render(view, 96), fresh.render(view, 96))
        assert used.get_state() == fresh.get_state()
        used.step(action)
        fresh.step(action)


def test_state_vector_by_name() -> None:
    scene = Scene(
        Robot(0.5, -0.5, 0.25),
        (Block("star", "blue", -0.3, 0.4, 1.0),),
        (GoalRegion("green", -0.9, -0.8, -0.3, -0.1),),
    )
    engine = Engine.of_scene(scene)
    state = dict(zip(STATE_NAMES, engine.state_vector(), strict=True))
    expected = {
        "robot.x": 0.5,
        "robot.y": -0.5,
        "robot.angle": 0.25,
        "robot.left_finger": np.pi / 8,
        "robot.right_finger": -np.pi / 8,
        "block0.present": 1,
        "block0.x": -0.3,
        "block0.y": 0.4,
        "block0.angle": 1,
        "block0.star": 1,
        "block0.blue": 1,
        "region0.present": 1,
        "region0.green": 1,
        "region0.x_min": -0.9,
        "region0.y_min": -0.8,
        "region0.x_max": -0.3,
        "region0.y_max": -0.1,
    }
    assert {name for name, value in state.items() if value} == set(expected)
    for name, value in expected.items():
        assert state[name] == pytest.approx(value, abs=1e-6), name
    for _ in range(8):
        engine.step(FORWARD)
    state = dict(zip(STATE_NAMES, engine.state_vector(), strict=True))
    heading = np.array([-np.sin(0.25), np.cos(0.25)])
    velocity = np.array([state["robot.x_velocity"], state["robot.y_velocity"]])
    np.testing.assert_allclose(velocity, 0.8 * heading, atol=0.01)


def test_the_state_with_the_start_says_where_blocks_began() -> None:
    """Also in a state that is restored: the blocks that started in a region of another colour can be read from it."""
    task = "intent:in(starts=matched, home) & out(starts=mismatched)"
    engine, names = Engine(task, "All", seed=5), (*STATE_NAMES, *START_NAMES)
    engine.reset()
    for action in (1, 10, 13, 1, 1, 10, 10):
        engine.step(action)
    wanted, saved = engine.initial_scene, engine.get_state()
    engine.reset(seed=6)
    engine.reset(state=saved)
    plain, full = engine.state_vector(), engine.state_vector(start=True)
    assert full.shape == (185 + 33,)
    assert full.dtype == np.float32
    np.testing.assert_array_equal(full[:185], plain)
    np.testing.assert_array_equal(engine.state_vector(), plain)
    np.testing.assert_array_equal(full[185:188], np.array(wanted.robot.pose, np.float32))
    blocks = full[188:].reshape(10, 3)
    np.testing.assert_array_equal(blocks[: len(wanted.blocks)], np.array([b.pose for b in wanted.blocks], np.float32))
    assert not blocks[len(wanted.blocks) :].any()
    assert (full[:3] != full[185:188]).any()
    state = dict(zip(names, full.tolist(), strict=True))
    mismatched = tuple(
        block
        for block in range(len(wanted.blocks))
        for region in range(len(wanted.regions))
        if state[f"region{region}.x_min"] <= state[f"start.block{block}.x"] <= state[f"region{region}.x_max"]
        if state[f"region{region}.y_min"] <= state[f"start.block{block}.y"] <= state[f"region{region}.y_max"]
        if any(state[f"region{region}.{name}"] != state[f"block{block}.{name}"] for name in COLOURS)
    )
    assert mismatched == magical_mj.intents.parse(task.removeprefix("intent:")).blocks(wanted)[1] != ()


def test_plain_scenes_have_no_end_no_score_and_no_seeds() -> None:
    engine = Engine.of_scene(Scene(Robot(0, 0, 0)))
    assert not any(engine.step(action) for action in (np.arange(400) % 18).tolist())
    assert engine.horizon is None
    with pytest.raises(InvalidSceneError, match="no score"):
        engine.score()
    with pytest.raises(SettingsError, match="no seeds"):
        engine.reset(seed=1)


def test_dynamics_reach_the_simulation() -> None:
    """Weaker motors accelerate more slowly."""

    def reached(dynamics: Dynamics) -> float:
        engine = Engine.of_scene(Scene(Robot(0, -0.5, 0), dynamics=dynamics))
        for _ in range(2):
            engine.step(FORWARD)
        return engine.scene.robot.y

    assert reached(Dynamics(drive_force=2.2)) < reached(Dynamics()) - 0.01 < reached(Dynamics(drive_force=3.5)) - 0.02


RESETS = """
from pathlib import Path
import magical_mj

engines = [magical_mj.Engine(task, variant, seed=0) for task, variant in magical_mj.ENVIRONMENTS]

def used_after(resets: int) -> int:
    for number in range(resets):
        engine = engines[number % len(engines)]
        engine.reset(seed=number)
        engine.render("ego", 96)
    return int(Path("/proc/self/status").read_text().split("VmRSS:")[1].split()[0])

before = used_after(240)  # warms up the allocator
print(used_after(240) - before)
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux says here how much memory is used")
def test_memory_is_flat_over_hundreds_of_resets() -> None:
    """Memory in kB, in a new process: that of this one is fragmented by other tests."""
    done = subprocess.run([sys.executable, "-c", RESETS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 5_000


@pytest.mark.parametrize("action", [18, -1, 1.5, None, "1", np.array([1]), np.float64(2), True])
def test_bad_actions_are_refused_and_harmless(action: object) -> None:
    engine = Engine("MoveToRegion", seed=0)
    before = engine.get_state()
    with pytest.raises(InvalidActionError, match=r"integers 0\.\.17"):
        engine.step(action)
    assert engine.get_state() == before


def test_bad_arguments_name_the_remedy() -> None:
    with pytest.raises(UnknownNameError, match="Did you mean 'FindDupe'"):
        Engine("FindDup")
    with pytest.raises(UnknownNameError, match="Did you mean 'Layout'"):
        Engine("FindDupe", "Layot")
    with pytest.raises(UnknownNameError, match="Jitter"):
        Engine("MoveToCorner", "Layout")
    for wrong in ("old", ["FindDupe"], None, 3, {"FindDupe"}, np.array(["a", "b"])):
        for arguments in ({"task": wrong}, {"variant": wrong}, {"rules": wrong}):
            with pytest.raises(UnknownNameError):
                Engine(**{"task": "FindDupe", **arguments})
        with pytest.raises(UnknownNameError, match="unknown preset"):
            magical_mj.MagicalEnv("FindDupe", preset=wrong)
        with pytest.raises(UnknownNameError, match="unknown view"):
            Engine("FindDupe").render(wrong)
    for seed in (-1, 1.5, "7", -(10**5000)):
        with pytest.raises(InvalidSeedError):
            Engine("FindDupe", seed=seed)
    with pytest.raises(SettingsError, match="not seed and scene"):
        Engine("FindDupe").reset(seed=1, scene=magical_mj.sample_scene("FindDupe", "Demo", 0))


def test_illegal_scenes_are_refused() -> None:
    demo = magical_mj.sample_scene("FindDupe", "Demo", 0)
    outside, overlapping = demo.moved(robot=(1.5, 0, 0)), demo.moved(robot=demo.blocks[0].pose)
    for scene, message in ((outside, "walls"), (overlapping, "overlap"), ("{}", "from_json"), (3, "Scene")):
        with pytest.raises(InvalidSceneError, match=message):
            Engine("FindDupe").reset(scene=scene)  # type: ignore[arg-type]
        with pytest.raises(InvalidSceneError, match=message):
            Engine.of_scene(scene)  # type: ignore[arg-type]
    with pytest.raises(InvalidSceneError):
        Engine("FindDupe", scene=magical_mj.sample_scene("MakeLine", "Demo", 0))
    column = tuple(Block("circle", "red", x, -0.9 + 0.25 * k, 0) for x in (-0.8, 0.8) for k in range(7))
    with pytest.raises(InvalidSceneError, match="entries for 10 blocks"):
        Engine.of_scene(Scene(Robot(0, 0, 0), column)).state_vector()


def test_closed_engines_say_so() -> None:
    engine = Engine("MoveToRegion")
    engine.close()
    engine.close()
    uses = (engine.reset, lambda: engine.step(0), lambda: engine.scene, engine.score, engine.render, engine.get_state)
    uses += (engine.clone, lambda: engine.model, lambda: magical_mj.export_mjcf(engine, "never.xml"))
    for use in uses:
        with pytest.raises(ClosedError):
            use()


def test_pictures_are_written_to_arrays_that_fit() -> None:
    engine, out = Engine("MoveToRegion", seed=0), np.zeros((32, 32, 3), np.uint8)
    assert engine.render(size=32, out=out) is out
    for wrong in (np.zeros((16, 16, 3), np.uint8), np.zeros((32, 32, 3)), [[0]], b"bytes"):
        with pytest.raises(SettingsError, match=r"\(32, 32, 3\), uint8"):
            engine.render(size=32, out=wrong)
    out.flags.writeable = False
    with pytest.raises(SettingsError, match="read-only"):
        engine.render(size=32, out=out)


def test_heaps_in_which_some_bodies_sleep_are_restored_or_refused() -> None:
    """MuJoCo refuses some of these states. Then the simulation is unchanged."""
    engine = Engine("ClusterShape", seed=0)
    engine.step(0)
    state, rng, refused = engine.get_state(), np.random.default_rng(0), []
    positions, trees = engine.model.nq, engine.model.ntree
    for _ in range(300):
        heap = state.simulation.copy()
        heap[1 : 1 + positions] = rng.uniform(-0.3, 0.3, positions)  # the first number is the time
        heap[-trees:] = np.where(rng.random(trees) < 0.5, np.arange(trees), -1)
        before = engine.get_state()
        try:
            engine.set_state(replace(state, simulation=heap))
        except StateError as error:
            refused.append(str(error))
        else:
            continue
        assert engine.get_state() == before
    assert 0 < len(refused) < 300
    assert all("MuJoCo cannot continue from it" in problem for problem in refused)


def test_an_unstable_simulation_ends_the_episode_and_can_be_left() -> None:
    env: Any = gymnasium.make("magical_mj/ClusterShape-Demo-State-v0").unwrapped
    env.reset(seed=0)
    env.step(4)
    state = env.get_state()
    env.engine.data.qvel[:] = 1e30
    with pytest.raises(PhysicsError, match="BADQ"):
        env.step(4)
    with pytest.raises(ResetNeeded):
        env.step(4)
    env.set_state(state)
    assert env.get_state() == state
    env.step(4)


ODD_NUMBERS = Scene(Robot(1e-320, -1e-310, 1e-315), (Block("star", "red", 1e-320, 0.5, 1e-320),))


def test_results_do_not_depend_on_numpys_settings() -> None:
    """Numbers that underflow in float32 become 0 without a warning."""
    settings = np.seterr(all="raise")
    try:
        engine = Engine.of_scene(ODD_NUMBERS)
        vectors = [engine.state_vector()]
        for action in (0, 10, 13, 4):
            engine.step(action)
            vectors.append(engine.state_vector())
        env = gymnasium.make("magical_mj/FindDupe-TestAll-LoResFingers-v0")
        env.reset(seed=0)
        env.step(10)
    finally:
        np.seterr(**settings)
    twin = Engine.of_scene(ODD_NUMBERS)
    np.testing.assert_array_equal(vectors[0], twin.state_vector())
    assert np.isfinite(vectors).all()


# Arbitrary scenes

PLACES = [
    (x, y)
    for x in np.linspace(-0.8, 0.8, 6)
    for y in np.linspace(-0.8, 0.8, 6)
    if math.dist((x, y), (-0.7, -0.7)) > 0.55
]
COUNTS = [(0, 0), (0, 30), (30, 0), (30, 30), (3, 4), (10, 3), (11, 3), (1, 4)]


def random_scene(rng: np.random.Generator, blocks: int, regions: int) -> Scene:
    """A legal scene: blocks on a grid around the robot, and regions of all sizes at any position."""
    places = rng.permutation(PLACES)[:blocks].tolist()
    robot = Robot(-0.7, -0.7, float(rng.uniform(-0.2, 0.2)), (float(rng.uniform(0, 0.1)), 0.0))
    return Scene(
        robot,
        tuple(
            Block(str(rng.choice(SHAPES)), str(rng.choice(COLOURS)), x, y, float(rng.uniform(-9, 9)))  # type: ignore[arg-type]
            for x, y in places
        ),
        tuple(random_region(rng) for _ in range(regions)),
    )


def random_region(rng: np.random.Generator) -> GoalRegion:
    width, height = 2 * 10 ** rng.uniform(-4, 0, size=2)
    x, y = rng.uniform(-1, 1 - width), rng.uniform(-1, 1 - height)
    return GoalRegion(str(rng.choice(COLOURS)), x, y, x + width, y + height)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", range(6))
def test_a_legal_scene_can_be_drawn_observed_exported_and_written(number: int, tmp_path: Path) -> None:
    """Or an error says why not."""
    rng = np.random.default_rng(number)
    counts = COUNTS[number] if number < len(COUNTS) else tuple(rng.integers(31, size=2).tolist())
    scene = random_scene(rng, *counts)
    check_scene(scene)
    assert Scene.from_json(scene.to_json()) == scene

    env = Engine.of_scene(scene)
    for view in CAMERAS:
        assert len(np.unique(env.render(view, 64).reshape(-1, 3), axis=0)) > 3

    model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(env, tmp_path / "model.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    env.step(0)
    controls = model.numeric("controls").data.reshape(18, 6)
    data.ctrl[:] = controls[0]
    mujoco.mj_step(model, data, 10)
    np.testing.assert_array_equal(data.qpos, env.data.qpos)
    env.close()

    if len(scene.blocks) <= MAX_BLOCKS and len(scene.regions) <= MAX_REGIONS:
        assert np.isfinite(Engine.of_scene(scene).state_vector()).all()
    else:
        with pytest.raises(InvalidSceneError, match="use pictures as observations"):
            Engine.of_scene(scene).state_vector()


def test_scenes_of_any_size_take_turns_in_one_environment() -> None:
    """A picture does not depend on the scenes that were drawn before."""
    rng = np.random.default_rng(0)
    scenes = [random_scene(rng, *counts) for counts in [*COUNTS, (2, 9), (2, 1)]]
    alone = []
    for scene in scenes:
        env = Engine.of_scene(scene)
        env.reset()
        alone.append(env.render("allo", 64))
        env.close()
    env = Engine.of_scene(scenes[0])
    for index in rng.integers(len(scenes), size=30).tolist():
        env.reset(scene=scenes[index])
        np.testing.assert_array_equal(env.render("allo", 64), alone[index])
    env.close()
