"""The vector environment: each environment equals a single one to the bit, with Gymnasium's interface."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import vector as wrappers

import magical_mj
from magical_mj.envs.vector import VectorEnv
from magical_mj.utils.errors import ClosedError, InvalidActionError, SettingsError, StateError, UnknownNameError

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
    """Steps of all 60 environments, each run on its own: episodes of two actions."""
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


@pytest.mark.parametrize("threads", [1, 4])
def test_every_environment_is_the_single_one_to_the_bit(threads: int, alone: list[tuple[Any, ...]]) -> None:
    settings: dict[str, Any] = {"renderer": "software", "image_size": 32, "limit": 2}
    singles = [magical_mj.MagicalEnv(*pair, "LoRes4E", **settings) for pair in magical_mj.ENVIRONMENTS]
    envs = VectorEnv(singles, threads, AutoresetMode.SAME_STEP)
    traces: list[list[Any]] = [[] for _ in singles]
    observations, infos = envs.reset(seed=list(range(len(singles))))
    for index, trace in enumerate(traces):
        trace.append((observations[index], info_of(infos, index)))
    for row in actions():
        observations, rewards, terminated, truncated, infos = envs.step(row)
        for index, trace in enumerate(traces):
            outcome = float(rewards[index]), bool(terminated[index]), bool(truncated[index])
            if truncated[index]:
                trace.append((infos["final_obs"][index], *outcome, info_of(infos["final_info"], index)))
                trace.append((observations[index], info_of(infos, index)))
            else:
                trace.append((observations[index], *outcome, info_of(infos, index)))
    for (expected, state), trace, env in zip(alone, traces, singles, strict=True):
        assert_same(expected, trace)
        assert env.get_state() == state
    envs.close()


def info_of(infos: dict[str, Any], index: int) -> dict[str, Any]:
    """An environment's info, with the types of a single environment."""
    assert infos["_eval_score"][index]
    return {"eval_score": infos["eval_score"][index], "is_success": bool(infos["is_success"][index])}


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


def test_mistakes_are_explained_and_step_no_environment() -> None:
    with pytest.raises(SettingsError, match="num_envs must be an integer of at least 1, not 0"):
        magical_mj.make_vec(STATES, 0)
    with pytest.raises(UnknownNameError, match="FindDupe"):
        magical_mj.make_vec(["FindDupe"], 1)  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="autoreset_mode must be one of"):
        magical_mj.make_vec(STATES, 1, autoreset_mode="never")
    with pytest.raises(SettingsError, match="max_episode_steps=999 is more than"):
        magical_mj.make_vec(STATES, 1, max_episode_steps=999)
    envs = magical_mj.make_vec(STATES, 2, max_episode_steps=1, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded):
        envs.step([0, 0])
    for seed in ([1], [1, 2, 3]):
        with pytest.raises(SettingsError, match="2 environments"):
            envs.reset(seed=seed)
    envs.reset(seed=[5, 6])
    before = envs.call("get_state")
    for wrong in ([0], [0, 18], [0, -1], [0.0, 1.0], [[0, 1], [0, 1]], [[0], [0, 1]], None):
        with pytest.raises(InvalidActionError, match="one for each environment"):
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


REGION = "magical_mj/MoveToRegion-TestAll-State-v0"
KINDS = ("single", "sync", "async", "vector_entry_point")


def made(kind: str, name: str = REGION, **settings: Any) -> Any:
    """A single environment, or a vector environment of two."""
    if kind == "single":
        return gymnasium.make(name, **settings)
    own = {"vector_kwargs": {"context": "spawn"}} if kind == "async" else {}
    return gymnasium.make_vec(name, 2, kind, **own, **settings)


@pytest.fixture(scope="module")
def states() -> list[magical_mj.State]:
    """All states of an episode of driving forward."""
    env = magical_mj.MagicalEnv("MoveToRegion", "All", "State")
    env.reset(seed=2)
    passed = [env.get_state()]
    while not env.step(1)[3]:
        passed.append(env.get_state())
    return [*passed, env.get_state()]


@pytest.mark.parametrize("kind", KINDS)
def test_a_limit_counts_the_steps_of_an_episode_wherever_it_goes_on(kind: str, states: list[magical_mj.State]) -> None:
    env = made(kind, max_episode_steps=30)
    action = 1 if kind == "single" else np.ones(2, int)
    env.reset(options={"state": states[10]})
    ends, scores = [], []
    for _ in range(20):
        _, _, _, truncated, info = env.step(action)
        ends.append(np.all(truncated))
        scores.append(np.min(info["eval_score"]))
    assert ends == [False] * 19 + [True]
    engine = magical_mj.Engine("MoveToRegion", "All")
    engine.set_state(states[30])
    assert scores == [0.0] * 19 + [engine.score()]
    for late in (30, 35, 40) if kind != "async" else ():  # an error ends the processes of async environments
        with pytest.raises(StateError, match="give a state with fewer than 30"):
            env.reset(options={"state": states[late]})
    env.close()


@pytest.mark.parametrize("kind", ["single", "sync", "vector_entry_point"])
@pytest.mark.parametrize("limit", [None, 30])
def test_who_goes_back_to_a_state_plays_the_rest_of_its_episode(
    kind: str, limit: int | None, states: list[magical_mj.State]
) -> None:
    settings = {} if limit is None else {"max_episode_steps": limit}
    env = made(kind, **settings)
    action = 1 if kind == "single" else np.ones(2, int)
    env.reset(seed=0)
    for start in (5, 25, 25):  # the second 25 starts from an ended episode
        if kind == "single":
            env.unwrapped.set_state(states[start])
        else:
            env.call("set_state", states[start])
        ends = [bool(np.all(env.step(action)[3])) for _ in range((limit or 40) - start)]
        assert ends == [False] * (len(ends) - 1) + [True]
        if kind == "sync":  # SyncVectorEnv resets after an end, even if a state was set
            return
    env.close()


VARIATIONS: list[Any] = [["camera"], ["all"], {"scene": {"block_count": 0}}, {"camera": {"heading": 9.0}, "seed": 3}]


@pytest.mark.parametrize("variation", VARIATIONS)
def test_variations_are_those_of_the_single_environments(variation: Any) -> None:
    settings: dict[str, Any] = {"renderer": "software", "image_size": 24, "shifts": "camera:1"}
    name = "magical_mj/MoveToRegion-TestAll-LoRes4E-v0"
    ours, theirs = (made(kind, name, **settings) for kind in ("vector_entry_point", "sync"))
    for arguments in ({"seed": 5}, {"seed": [7, None]}, {}):
        arguments["options"] = {"variation": variation}
        assert_same(ours.reset(**arguments), theirs.reset(**arguments))
        assert_same(ours.step([1, 4]), theirs.step([1, 4]))
    for mask in ([True, False], [False, True]):
        results = [
            envs.reset(options={"reset_mask": np.array(mask), "variation": variation}) for envs in (ours, theirs)
        ]
        assert_same(*results)
    drawn = [env.variation for env in ours.envs]
    assert_same(drawn, list(theirs.get_attr("variation")))
    assert ours.call("get_state") == theirs.call("get_state")
    with pytest.raises(SettingsError, match="one of the options scene, state, variation, not scene and variation"):
        ours.reset(options={"variation": variation, "scene": ours.envs[0].scene})
    for envs in (ours, theirs):
        envs.close()


WRAPPERS: list[Callable[..., Any]] = [
    wrappers.RecordEpisodeStatistics,
    wrappers.DictInfoToList,
    wrappers.NormalizeReward,
    wrappers.NormalizeObservation,
    wrappers.FlattenObservation,
    lambda envs: wrappers.TransformReward(envs, lambda rewards: 10 * rewards),
    lambda envs: wrappers.TransformAction(envs, lambda actions: 17 - actions, envs.action_space),
]


@pytest.mark.parametrize("wrap", WRAPPERS)
def test_gymnasiums_wrappers_see_no_difference(wrap: Callable[..., Any]) -> None:
    settings: dict[str, Any] = {"reward": "score", "max_episode_steps": 3}
    traces = []
    for kind in ("vector_entry_point", "sync"):
        envs = wrap(made(kind, "magical_mj/ClusterShape-Demo-State-v0", **settings))
        trace: list[Any] = [envs.reset(seed=[4, 1]), *(envs.step(row) for row in actions()[:, :2].repeat(3, axis=0))]
        for step in trace:
            if isinstance(step[-1], dict):
                step[-1].get("episode", {}).pop("t", None)  # seconds
        traces.append(trace)
        envs.close()
    assert_same(*traces)


class Ends(magical_mj.MagicalEnv):
    """Rewards each step, and ends its episodes with an info of its own."""

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        observation, _, _, truncated, info = super().step(action)
        ended = self.engine.steps == 2 + self.engine.seed % 2
        return observation, 1.0, ended, truncated, info | ({"ends": {"at": self.engine.steps}} if ended else {})


class Dims(magical_mj.MagicalEnv):
    """Changes the first observation, and says another sentence."""

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        observation, info = super().reset(**arguments)
        changed = {name: part if isinstance(part, str) else part // 2 for name, part in observation.items()}
        return changed | {"instruction": "look closely"}, info


class Hurries(magical_mj.MagicalEnv):
    """Has five actions."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.action_space = gymnasium.spaces.Discrete(5)

    def to_action(self, action: Any) -> Any:
        return 4 * action


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("kind", [Ends, Dims, Hurries])
def test_methods_of_a_subclass_are_called_as_in_gymnasiums_vector(kind: type, mode: AutoresetMode) -> None:
    limit = 40 if kind is Ends else 4
    settings: dict[str, Any] = {"task": "MoveToRegion", "variant": "Layout", "limit": limit, "renderer": "software"}
    if kind is Dims:
        settings |= {"preset": "LoResFingers", "instruction": True, "image_size": 16}
    ours = VectorEnv([kind(**settings) for _ in range(3)], 2, mode)
    theirs = gymnasium.vector.SyncVectorEnv([lambda: kind(**settings)] * 3, autoreset_mode=mode)
    assert_same(ours.reset(seed=4), theirs.reset(seed=4))
    for row in np.random.default_rng(0).integers(5, size=(9, 3)):
        step = ours.step(row)
        assert_same(step, theirs.step(row))
        if mode == AutoresetMode.DISABLED and (ended := step[2] | step[3]).any():
            options = {"reset_mask": ended}
            assert_same(ours.reset(options=options), theirs.reset(options={"reset_mask": ended.copy()}))
    for envs in (ours, theirs):
        envs.close()


def test_environments_that_cannot_be_stepped_together_are_refused() -> None:
    env = magical_mj.MagicalEnv("MoveToRegion", preset="State")
    for wrong, why in (
        ([], "at least one"),
        ([env, env], "occurs twice"),
        ([env, magical_mj.MagicalEnv("MoveToRegion")], "differ in the observation_space"),
        ([env, magical_mj.MagicalEnv("MoveToRegion", preset="State", action="continuous")], "the action_space"),
        ([gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0")], "SyncVectorEnv takes any, also with wrappers"),
    ):
        with pytest.raises(SettingsError, match=why):
            VectorEnv(wrong)
    with pytest.raises(SettingsError, match=r"call gymnasium\.make_vec\(id"):
        magical_mj.make_vec("MoveToRegion", 2, vectorization_mode="sync")


def test_each_environment_converts_its_own_form_of_action() -> None:
    forms = [magical_mj.MagicalEnv("FindDupe", preset="State", action=form) for form in ("continuous", "speeds")]
    envs = VectorEnv([env.clone() for env in forms])
    envs.reset(seed=1)
    slow = np.array([[0.3, 0.0, -1.0]] * 2, np.float32)  # too slow to count as a number, but a speed
    for index, env in enumerate(forms):
        env.reset(seed=1 + index)
        env.step(slow[index])
    envs.step(slow)
    assert [env.scene for env in envs.envs] == [env.scene for env in forms]
    assert forms[0].scene.robot.pose == pytest.approx(forms[0].initial_scene.robot.pose)


def test_its_attributes_are_those_of_gymnasiums_vector() -> None:
    ours, theirs = (made(kind, render_mode="rgb_array", render_size=16) for kind in ("vector_entry_point", "sync"))
    for envs in (ours, theirs):
        envs.reset(seed=[3, 2**70])
        envs.set_attr("reward", ["none", "score"])
        envs.set_attr("limit", 2)
    assert ours.get_attr("reward") == theirs.get_attr("reward") == ("none", "score")
    for name in ("num_envs", "autoreset_mode", "metadata", "render_mode", "np_random_seed", "closed"):
        assert getattr(ours, name) == getattr(theirs, name), name
    for name in ("single_observation_space", "observation_space", "single_action_space", "action_space"):
        assert getattr(ours, name) == getattr(theirs, name), name
    assert {name for name in dir(theirs) if name[0] != "_"} - {"env_fns", "copy", "observation_mode"} <= set(dir(ours))
    assert [g.integers(99) for g in ours.np_random] == [g.integers(99) for g in theirs.np_random]
    assert_same(ours.render(), theirs.render())
    for _ in range(3):
        assert_same(ours.step([1, 1]), theirs.step([1, 1]))
    for envs in (ours, theirs):
        with pytest.raises(AttributeError, match="nothing"):
            envs.get_attr("nothing")
        with pytest.raises(ValueError, match="1"):
            envs.set_attr("reward", ["none"])
        envs.close()


def test_each_environment_has_its_own_sentence() -> None:
    """Sentences of different lengths are not truncated, with a mask or without one."""
    settings: dict[str, Any] = {"shifts": "words:5", "max_episode_steps": 1, "autoreset_mode": "SameStep"}
    envs = gymnasium.make_vec(REGION, 8, "vector_entry_point", **settings)
    masks = np.arange(8) < 3, np.arange(8) >= 3
    sentences: set[str] = set()
    for options in ({}, *({"reset_mask": mask} for mask in masks)):
        _, infos = envs.reset(options=options)
        said = [env.engine.instruction for env in envs.envs]
        assert [s for s, is_new in zip(infos["instruction"], infos["_instruction"], strict=True) if is_new] == [
            s for s, is_new in zip(said, infos["_instruction"], strict=True) if is_new
        ]
        infos = envs.step([0] * 8)[-1]
        assert infos["final_info"]["instruction"].tolist() == said
        sentences.update(said)
    assert len({len(sentence) for sentence in sentences}) > 3
    envs.close()


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda envs: pickle.loads(pickle.dumps(envs))])
def test_copies_continue_alike_in_environments_of_their_own(copied: Callable[[Any], Any]) -> None:
    envs = made("vector_entry_point", STACKS, renderer="software", max_episode_steps=3, threads=2)
    for env in (envs, magical_mj.MagicalEnv("FindDupe", "All", "State")):
        env.reset(seed=4)
        action = [1, 4] if env is envs else 1
        env.step(action)
        twin = copied(env)
        assert_same([env.step(action) for _ in range(2)], [twin.step(action) for _ in range(2)])
        assert_same(env.reset(), twin.reset())
        env.close()
        twin.step(action)
        twin.close()
        with pytest.raises(ClosedError):
            copied(env)
