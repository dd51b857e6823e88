"""Worlds on all cores: each is the single environment to the bit, and the vector is Gymnasium's."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

import magical_mj
from magical_mj.envs.vector import VectorEnv
from magical_mj.utils.errors import ClosedError, InvalidActionError, SettingsError, UnknownNameError

STATES = "magical_mj/MatchRegions-TestAll-State-v0"
STACKS = "magical_mj/FindDupe-TestAll-LoResFingers-v0"


def assert_same(one: Any, other: Any) -> None:
    """Equal values of equal types, to the bit."""
    if isinstance(one, dict):
        assert one.keys() == other.keys()
        for key, value in one.items():
            assert_same(value, other[key])
    elif isinstance(one, tuple | list) or (isinstance(one, np.ndarray) and one.dtype == object):
        assert len(one) == len(other)
        for left, right in zip(one, other, strict=True):
            assert_same(left, right)
    else:
        assert getattr(one, "dtype", None) == getattr(other, "dtype", None)
        np.testing.assert_array_equal(one, other)


@pytest.fixture(scope="module")
def alone() -> list[tuple[Any, ...]]:
    """Steps of all 60 environments, each played for itself: episodes of two actions, one after the other."""
    steps: list[tuple[Any, ...]] = []
    for number, pair in enumerate(magical_mj.ENVIRONMENTS):
        env = magical_mj.MagicalEnv(*pair, "LoRes4E", renderer="software", image_size=32, limit=2)
        trace: list[Any] = [env.reset(seed=number)]
        for action in actions()[:, number]:
            trace.append(env.step(action))
            if trace[-1][3]:
                trace.append(env.reset())
        steps.append((trace, env.get_state()))
        env.close()
    return steps


def actions() -> np.ndarray:
    return np.random.default_rng(0).integers(18, size=(3, len(magical_mj.ENVIRONMENTS)))


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_every_environment_is_the_single_one_to_the_bit(threads: int, alone: list[tuple[Any, ...]]) -> None:
    settings: dict[str, Any] = {"renderer": "software", "image_size": 32, "limit": 2}
    worlds = [magical_mj.MagicalEnv(*pair, "LoRes4E", **settings) for pair in magical_mj.ENVIRONMENTS]
    envs = VectorEnv(worlds, threads, AutoresetMode.SAME_STEP)
    traces: list[list[Any]] = [[] for _ in worlds]
    observations, infos = envs.reset(seed=list(range(len(worlds))))
    for world, trace in enumerate(traces):
        trace.append((observations[world], info_of(infos, world)))
    for row in actions():
        observations, rewards, terminated, truncated, infos = envs.step(row)
        for world, trace in enumerate(traces):
            outcome = float(rewards[world]), bool(terminated[world]), bool(truncated[world])
            if truncated[world]:
                trace.append((infos["final_obs"][world], *outcome, info_of(infos["final_info"], world)))
                trace.append((observations[world], info_of(infos, world)))
            else:
                trace.append((observations[world], *outcome, info_of(infos, world)))
    for (expected, state), trace, world in zip(alone, traces, worlds, strict=True):
        assert_same(expected, trace)
        assert world.get_state() == state
    envs.close()


def info_of(infos: dict[str, Any], world: int) -> dict[str, Any]:
    """A world's info, with the types that the single environment gives."""
    assert infos["_eval_score"][world]
    return {"eval_score": infos["eval_score"][world], "is_success": np.array(infos["is_success"][world])}


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", [STATES, STACKS])
def test_it_is_gymnasiums_vector_of_the_same_environments(name: str, mode: AutoresetMode) -> None:
    settings: dict[str, Any] = {"renderer": "software", "reward": "score", "max_episode_steps": 3}
    settings["instruction"] = name == STACKS
    ours = gymnasium.make_vec(name, 3, "vector_entry_point", autoreset_mode=mode, threads=2, **settings)
    theirs = gymnasium.make_vec(name, 3, "sync", vector_kwargs={"autoreset_mode": mode}, **settings)
    assert ours.observation_space == theirs.observation_space
    assert ours.action_space == theirs.action_space
    assert_same(ours.reset(seed=4), theirs.reset(seed=4))
    for row in actions()[:, :3].repeat(3, axis=0):
        step = ours.step(row)
        assert_same(step, theirs.step(row))
        if mode == AutoresetMode.DISABLED and step[3].any():
            some = np.array([True, False, True])
            for mask in (some, ~some):
                assert_same(ours.reset(options={"reset_mask": mask}), theirs.reset(options={"reset_mask": mask.copy()}))
    for envs in (ours, theirs):
        envs.close()


def test_observations_are_fresh_and_in_one_array() -> None:
    envs = magical_mj.make_vec("MoveToCorner", 2, renderer="software")
    before, _ = envs.reset(seed=0)
    assert before.shape == (2, 96, 96, 12)
    held = before.copy()
    after = envs.step([1, 1])[0]
    assert not np.shares_memory(before, after)
    np.testing.assert_array_equal(before, held)
    np.testing.assert_array_equal(after[..., :9], before[..., 3:])
    envs.close()


def test_opengl_draws_in_threads_what_it_draws_alone() -> None:
    frames: list[np.ndarray] = []
    for threads in (1, 2):
        envs = magical_mj.make_vec("MatchRegions", 4, variant="All", renderer="opengl", threads=threads)
        envs.reset(seed=0)
        frames.append(envs.step([1, 4, 10, 13])[0])
        envs.close()
    np.testing.assert_array_equal(frames[0], frames[1])


def test_mistakes_are_explained_and_step_no_world() -> None:
    with pytest.raises(SettingsError, match="num_envs must be an integer of at least 1, not 0"):
        magical_mj.make_vec(STATES, 0)
    with pytest.raises(UnknownNameError, match="FindDupe"):
        magical_mj.make_vec(["FindDupe"], 1)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="autoreset_mode is one of"):
        magical_mj.make_vec(STATES, 1, autoreset_mode="never")
    with pytest.raises(SettingsError, match="max_episode_steps=999 is more than"):
        magical_mj.make_vec(STATES, 1, max_episode_steps=999)
    envs = magical_mj.make_vec(STATES, 2, max_episode_steps=1, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded):
        envs.step([0, 0])
    for seed in ([1], [1, 2, 3]):
        with pytest.raises(SettingsError, match="2 worlds"):
            envs.reset(seed=seed)
    envs.reset(seed=[5, 6])
    before = envs.call("get_state")
    for wrong in ([0], [0, 18], [0, -1], [0.0, 1.0], [[0, 1], [0, 1]], [[0], [0, 1]], None):
        with pytest.raises(InvalidActionError, match="one for each world"):
            envs.step(wrong)
    for mask in ([True], [[True], [True, False]]):
        with pytest.raises(SettingsError, match="reset_mask must hold 2 bools"):
            envs.reset(options={"reset_mask": mask})
    assert envs.call("get_state") == before
    envs.step([0, 0])
    with pytest.raises(ResetNeeded, match="reset_mask"):
        envs.step([0, 0])
    envs.close()
    with pytest.raises(ClosedError):
        envs.reset()
