"""States, clones, copies and pickles: episodes continue the same, to the bit."""

from __future__ import annotations

import copy
import itertools
import pickle
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.engine import Engine, State
from magical_mj.envs.presets import PRESETS
from magical_mj.utils.errors import ClosedError, InvalidSceneError, StateError
from tests.helpers.environments import TWO_EACH

STEPS = 24


def actions(seed: int, count: int = STEPS) -> list[int]:
    """Random actions, each repeated a few times, so that the robot moves far and pushes blocks."""
    return np.repeat(np.random.default_rng(seed).integers(18, size=count), 4)[:count].tolist()


def trajectory(env: Any, plan: Sequence[int]) -> list[bytes]:
    """The states after these actions: positions, velocities, and the fields that MuJoCo derives from them."""
    data = env.data
    arrays = (data.qpos, data.qvel, data.act, data.xpos, data.xmat, data.tree_asleep)
    return [b"".join(array.tobytes() for array in arrays) for action in plan if env.step(action) is not None]


def test_an_episode_restored_from_a_state_continues_to_the_bit() -> None:
    """In the same engine, after another scene, in an engine with another seed, and in copies."""
    for task, variant in TWO_EACH:
        engine, fresh = Engine(task, variant, seed=2), Engine(task, variant, seed=9)
        states, went = [], []
        for action in actions(0):
            states.append(engine.get_state())
            went += trajectory(engine, [action])
        for other in (engine, fresh):
            for first in (17, 0):
                other.reset(seed=5 + first)
                other.set_state(states[first])
                assert other.get_state() == states[first]
                assert trajectory(other, actions(0)[first:]) == went[first:]
        engine.reset(state=states[9])
        for twin in (engine.clone(), pickle.loads(pickle.dumps(engine)), copy.deepcopy(engine)):
            assert trajectory(twin, actions(0)[9:]) == went[9:]
            assert engine.get_state() == states[9]
            assert (twin.seed, twin.variant, twin.horizon) == (engine.seed, variant, engine.horizon)


def test_something_sleeps_and_something_wakes() -> None:
    """Otherwise the tests above would prove little."""
    env = magical_mj.Engine("ClusterColour", "All", seed=2)
    env.reset()
    asleep = []
    for action in actions(0, 80):
        env.step(action)
        asleep.append(int((env.data.tree_asleep >= 0).sum()))
    assert max(asleep) > 1
    assert min(np.diff(asleep)) < 0
    assert env.data.ncon > 0


def test_states_are_plain_and_small() -> None:
    env = magical_mj.Engine("ClusterShape", "All", seed=1)
    env.reset()
    env.step(10)
    state = env.get_state()
    twin = pickle.loads(pickle.dumps(state))
    assert twin == state
    assert hash(twin) == hash(state)
    by_hand = State(magical_mj.Scene.from_json(state.scene.to_json()), state.steps, np.array(state.simulation.tolist()))
    assert by_hand == state
    env.step(10)
    assert env.get_state() != state
    assert len(pickle.dumps(state)) < 8000


def test_the_horizon_counts_from_the_start_of_the_episode() -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    env.reset()
    for _ in range(30):
        env.step(1)
    state = env.get_state()
    env.reset(state=state)
    assert [env.step(1) for _ in range(10)] == [False] * 9 + [True]
    over = env.get_state()
    with pytest.raises(StateError, match="ended, after 40 steps"):
        env.reset(state=over)
    env.set_state(over)
    assert env.score() == magical_mj.score("MoveToRegion", env.initial_scene, env.scene)
    assert env.over
    assert env.clone().over


def test_a_state_shows_what_was_seen_then() -> None:
    env = magical_mj.Engine("MatchRegions", "All", seed=3)
    env.reset()
    for action in actions(1, 9):
        env.step(action)
    state, vector, picture = env.get_state(), env.state_vector(), env.render("ego", 32)
    env.reset(seed=4)
    env.reset(state=state)
    np.testing.assert_array_equal(env.state_vector(), vector)
    np.testing.assert_array_equal(env.render("ego", 32), picture)


@pytest.mark.parametrize("preset", PRESETS)
def test_gymnasium_states_hold_the_frames(preset: str) -> None:
    env = gymnasium.make(magical_mj.env_id("FixColour", "All", preset), image_size=24).unwrapped
    env.reset(seed=3)
    for action in actions(1, 7):
        observation = env.step(action)[0]
    state, twin = env.get_state(), env.clone()
    expected = [env.step(action) for action in actions(2, 6)]
    env.reset(seed=8)
    env.step(4)
    again, _ = env.reset(options={"state": state})
    assert_same(again, observation)
    for world in (env, twin):
        for action, (observation, *rest) in zip(actions(2, 6), expected, strict=True):
            now, *others = world.step(action)
            assert_same(now, observation)
            assert others == rest
        world.set_state(state)
    env.reset(options={"state": magical_mj.Engine("FixColour", "All", seed=3).get_state()})  # refills the stacks
    assert_same(env.get_state().frames, gymnasium_frames(env, seed=3))


@pytest.mark.parametrize(("one", "other"), list(itertools.permutations(("LoRes4E", "LoRes4A", "LoRes3EA"), 2)))
def test_frames_of_another_preset_are_not_taken_for_its_own(one: str, other: str) -> None:
    """They have the same shape. The current pictures fill the stacks instead."""
    first, second = (gymnasium.make(magical_mj.env_id("FindDupe", "Demo", preset)).unwrapped for preset in (one, other))
    first.reset(seed=0)
    for action in actions(1, 6):
        first.step(action)
    observation, _ = second.reset(options={"state": first.get_state()})
    now = second.engine.render("allo" if other == "LoRes4A" else "ego", 96)
    for count in range(2, 4):
        np.testing.assert_array_equal(observation[..., 3 * count : 3 * count + 3], now)


def gymnasium_frames(env: Any, seed: int) -> Any:
    env.reset(seed=seed)
    return env.get_state().frames


def assert_same(one: Any, other: Any) -> None:
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for name in one:
            np.testing.assert_array_equal(one[name], other[name])
    else:
        np.testing.assert_array_equal(one, other)


def test_wrapped_environments_are_copied_and_pickled() -> None:
    env = gymnasium.make("magical_mj/FindDupe-TestAll-LoRes4E-v0")
    env.reset(seed=1)
    env.action_space.seed(4)
    for action in actions(0, 5):
        env.step(action)
    for twin in (copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        assert twin.spec == env.spec
        assert twin.unwrapped.get_state() == env.unwrapped.get_state()
        here = copy.deepcopy(env)
        assert_same(twin.step(4)[0], here.step(4)[0])
        assert_same(twin.reset()[0], here.reset()[0])
        assert twin.action_space.sample() == here.action_space.sample()


def test_copies_of_environments_without_a_seed_draw_the_same_scenes() -> None:
    env = gymnasium.make("magical_mj/FindDupe-TestLayout-State-v0").unwrapped
    env.reset(options={"scene": magical_mj.sample_scene("FindDupe", "Layout", 3)})
    twins = [env.clone(), pickle.loads(pickle.dumps(env))]
    for world in (env, *twins):
        world.reset()
    assert [twin.initial_scene for twin in twins] == [env.initial_scene] * 2


def test_states_that_do_not_fit_are_refused_and_harm_nothing() -> None:
    env = magical_mj.Engine("FindDupe", seed=0)
    env.reset()
    state = env.get_state()
    values = state.simulation
    asleep = values.copy()
    asleep[-3:] = 10**6
    for wrong in (values[:-1], np.append(values, 0), np.full_like(values, np.nan), asleep, values[None]):
        with pytest.raises(StateError):
            env.set_state(State(state.scene, 0, wrong))
    for wrong in (None, values.tolist(), values.astype(np.float32), values.astype(object)):
        with pytest.raises(StateError, match="finite float64"):
            env.set_state(State(state.scene, 0, wrong))
    bad_parts = [State(wrong, 0, values) for wrong in (None, "", {}, state, values)]
    bad_parts += [State(state.scene, wrong, values) for wrong in (-1, 1.5, "3", None)]
    bad_parts += [State(state.scene, 0, values, 5)]
    for wrong in (None, state.scene, values, {"scene": state.scene}, *bad_parts):
        with pytest.raises(StateError, match="get_state"):
            env.set_state(wrong)
    with pytest.raises(InvalidSceneError):
        env.set_state(magical_mj.Engine("MakeLine").get_state())
    assert env.get_state() == state
    assert not env.step(4)
    env.close()
    for use in (env.get_state, env.clone, lambda: env.set_state(state), lambda: pickle.dumps(env)):
        with pytest.raises(ClosedError, match="closed"):
            use()


@pytest.mark.parametrize("change", ["body_mass", "timestep"])
def test_models_changed_by_hand_are_not_copied(change: str) -> None:
    """A model that was changed by hand: the copy would have another future. Resets and shifts are no such changes."""
    engine = magical_mj.Engine("ClusterShape", "All", seed=0, shifts="camera:3+palette:2+friction:1")
    for seed in range(1, 5):  # also of other structures
        engine.reset(seed=seed)
        engine.step(4)
        assert engine.clone().get_state() == pickle.loads(pickle.dumps(engine)).get_state() == engine.get_state()
    if change == "body_mass":
        engine.model.body_mass[:] *= 2
    else:
        engine.model.opt.timestep /= 2
    env = gymnasium.make("magical_mj/FixColour-Demo-State-v0").unwrapped
    env.reset(seed=0)
    env.engine.model.geom_friction[:] *= 2  # type: ignore[attr-defined]
    for changed in (engine, env):
        for make in (copy.copy, copy.deepcopy, pickle.dumps, lambda source: source.clone()):
            with pytest.raises(
                StateError, match=r"model was changed by hand \((body_mass|timestep|geom_friction)\), and"
            ):
                make(changed)


def test_a_closed_engine_has_no_episode() -> None:
    """All that describes the episode raises the same error; all that describes the engine is still known."""
    engines = (
        magical_mj.Engine("FixColour", seed=3),
        magical_mj.Engine.of_scene(magical_mj.sample_scene("FixColour", "Demo", 0)),
    )
    for engine in engines:
        known = {
            name: getattr(engine, name) for name in ("task", "variant", "rules", "horizon", "limit", "shifts", "seed")
        }
        engine.close()
        engine.close()
        assert {name: getattr(engine, name) for name in known} == known
        for name in (
            "scene",
            "initial_scene",
            "steps",
            "over",
            "draws",
            "instruction",
            "model",
            "data",
            "scored_scenes",
        ):
            with pytest.raises(ClosedError, match="make another one"):
                getattr(engine, name)
        for call in (engine.score, engine.remaining, engine.reset, engine.render, engine.state_vector, engine.fingers):
            with pytest.raises(ClosedError, match="make another one"):
                call()


def test_numbers_that_mujoco_would_not_take_are_refused() -> None:
    """MuJoCo would reset silently. An accepted state is returned unchanged by `get_state`."""
    env = magical_mj.Engine("FixColour", seed=0)
    env.reset()
    env.step(4)
    state = env.get_state()
    numbers, size = (
        state.simulation,
        len(state.simulation) - env.model.ntree,
    )  # then the entries about sleep

    def with_number(index: int, number: float) -> State:
        return State(state.scene, 1, np.where(np.arange(len(numbers)) == index, number, numbers))

    for index, number in itertools.product(range(len(numbers)), (1e308, -1e11)):
        with pytest.raises(StateError, match="from -1e"):
            env.set_state(with_number(index, number))
    for index, number in itertools.product(range(size), (1e9, -0.5)):
        taken = with_number(index, number)
        env.set_state(taken)
        assert env.get_state().simulation[:size].tobytes() == taken.simulation[:size].tobytes()
    with pytest.raises(StateError, match="damaged"):
        env.set_state(with_number(size, -1.5))
    env.set_state(State(state.scene, np.int64(1), numbers))  # the type of numbers in numpy's files
    assert env.get_state() == state
