"""Uses of an environment by other projects: wrappers, vectors, copies, threads, and states in any order."""

from __future__ import annotations

import copy
import dataclasses
import pickle
import random
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import wrappers
from values import FindError, value

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.engine import State
from magical_mj.envs.presets import PRESETS
from magical_mj.utils.errors import MagicalError
from magical_mj.wrappers import ContinuousActions, ScoreAtTheEnd

WRAPPERS: Final = (
    wrappers.RecordEpisodeStatistics,
    wrappers.FlattenObservation,
    wrappers.TransformReward,
    wrappers.Autoreset,
    wrappers.NormalizeObservation,
    wrappers.TimeAwareObservation,
    wrappers.FrameStackObservation,
    wrappers.DtypeObservation,
    wrappers.TimeLimit,
    wrappers.OrderEnforcing,
    wrappers.PassiveEnvChecker,
    wrappers.NormalizeReward,
    wrappers.DelayObservation,
    wrappers.RenderCollection,
    ContinuousActions,
)
ARGUMENTS: Final[dict[Any, tuple[Any, ...]]] = {
    wrappers.TransformReward: (lambda reward: 2 * reward,),
    wrappers.FrameStackObservation: (3,),
    wrappers.DtypeObservation: (np.float32,),
    wrappers.TimeLimit: (7,),
    wrappers.DelayObservation: (2,),
}


def states(rng: random.Random, _folder: Path) -> None:
    """A state with some odd numbers must be refused, or the episode must continue from it.

    Afterwards, a valid state must be restored exactly.
    """
    task, variant = rng.choice(magical_mj.ENVIRONMENTS)
    env = magical_mj.Engine(task, variant, seed=rng.randrange(100))
    for _ in range(rng.randrange(20)):
        env.step(rng.randrange(len(ACTIONS)))
    good = env.get_state()
    numbers = good.simulation.copy()
    for _ in range(rng.choice((1, 1, 3, 20))):
        index = rng.randrange(len(numbers))
        numbers[index] = rng.choice(
            (numbers[index] * 10.0 ** rng.randint(-3, 12), 1e308, -1e308, 1e11, 1e9, 5.0, -1.0, np.nan, rng.gauss(0, 3))
        )
    changes: dict[str, Any] = {"simulation": numbers}
    if rng.random() < 0.3:
        changes = {rng.choice(("scene", "steps", "frames")): value(rng)}
    try:
        env.set_state(dataclasses.replace(good, **changes))
        trees = env.model.ntree  # not compared: moving bodies may wake sleeping ones
        if "simulation" in changes and not np.array_equal(env.get_state().simulation[:-trees], numbers[:-trees]):
            raise FindError("a state was accepted, but the simulation has another one")
        for _ in range(3):
            if env.step(rng.randrange(len(ACTIONS))):
                env.reset()
        if not np.isfinite(env.data.qpos).all():
            raise FindError("a state led to numbers that are not finite, without an error")
    except MagicalError:
        pass
    env.set_state(good)
    if env.get_state() != good:
        raise FindError("after a bad state, a good one is not restored exactly")


def clients(rng: random.Random, folder: Path) -> None:
    """One of the uses of environments by other projects, chosen at random."""
    rng.choice((_wrapped, _wrapped, _operations, _operations, _operations, _vector, _baselines, _recorded))(rng, folder)


def _name(rng: random.Random) -> str:
    return magical_mj.env_id(*rng.choice(magical_mj.ENVIRONMENTS), rng.choice(list(PRESETS)))


def _wrapped(rng: random.Random, _folder: Path) -> None:
    """Gymnasium's wrappers in any order. Errors of the wrappers themselves are ignored."""
    env: Any = gymnasium.make(_name(rng), render_mode="rgb_array", render_size=32)
    for kind in rng.sample(WRAPPERS, k=rng.randrange(1, 5)):
        try:
            env = kind(env, *ARGUMENTS.get(kind, ()))
        except (AssertionError, gymnasium.error.Error, MagicalError, TypeError, ValueError):
            continue
    env = ScoreAtTheEnd(env)  # one of the wrappers ends episodes
    env.action_space.seed(0)
    for seed in (rng.randrange(100), None):
        try:
            env.reset(seed=seed)
        except (AttributeError, TypeError, ValueError, AssertionError):
            return  # a wrapper that does not take dicts
        for _ in range(rng.randrange(30)):
            *_, terminated, truncated, info = env.step(env.action_space.sample())
            if terminated or truncated:
                if not 0.0 <= info["eval_score"] == env.unwrapped.score() <= 1.0:
                    raise FindError("the last step does not report the score")
                break
    env.close()


def _operations(rng: random.Random, _folder: Path) -> None:
    """Steps, states, copies and pictures in any order. The final state must be that after the same actions alone."""
    task, variant = rng.choice(magical_mj.ENVIRONMENTS)
    env = magical_mj.Engine(task, variant)
    seed, done, kept = rng.randrange(100), [], {}
    env.reset(seed=seed)
    horizon = env.horizon or 0
    for _ in range(rng.randrange(5, 40)):
        how = rng.choice(
            ("step",) * 6 + ("keep", "back", "clone", "pickle", "copy", "draw", "score", "thread", "reset")
        )
        if how == "step" and len(done) < horizon - 1:
            done.append(rng.randrange(len(ACTIONS)))
            env.step(done[-1])
        elif how == "keep":
            kept[tuple(done)] = env.get_state()
        elif how == "back" and kept:
            done = list(rng.choice(list(kept)))
            env.set_state(kept[tuple(done)])
        elif how in ("clone", "pickle", "copy"):
            other = env.clone() if how == "clone" else copy.deepcopy(env) if how == "copy" else _pickled(env)
            env.close()
            env = other
        elif how == "draw":
            env.render(rng.choice(("ego", "allo", "scene")), rng.choice((16, 48)))
        elif how == "score":
            env.score()
        elif how == "thread":
            with ThreadPoolExecutor(1) as thread:
                thread.submit(env.render, "allo", 16).result()
        elif how == "reset":
            seed, done, kept = rng.randrange(100), [], {}
            env.reset(seed=seed)
    alone = magical_mj.Engine(task, variant)
    alone.reset(seed=seed)
    for action in done:
        alone.step(action)
    _check_same(env, alone, f"{task}-{variant}")


def _check_same(env: magical_mj.Engine, alone: magical_mj.Engine, name: str) -> None:
    if alone.get_state() != env.get_state():
        raise FindError(f"{name} has another state than after the same actions alone")
    if not np.array_equal(alone.render("allo", 32), env.render("allo", 32)):
        raise FindError(f"{name} has another picture than after the same actions alone")


def _pickled(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))  # noqa: S301  our own


def _vector(rng: random.Random, _folder: Path) -> None:
    """Vectors with each autoreset mode, compared with a single environment."""
    name, count = _name(rng), rng.randrange(1, 4)
    mode = rng.choice(list(gymnasium.vector.AutoresetMode))
    form = "async" if rng.random() < 0.05 else "sync"
    env = gymnasium.make_vec(name, count, form, vector_kwargs={"autoreset_mode": mode})
    seed = rng.randrange(100)
    first, _ = env.reset(seed=seed)
    alone = gymnasium.make(name)
    same, _ = alone.reset(seed=seed)
    for one, many in _parts(same, first):
        if not np.array_equal(one, many[0]):
            raise FindError("a vector's first observation is not that of the environment")
    env.action_space.seed(seed)
    for _ in range(rng.randrange(60)):
        *_, ended, _info = env.step(env.action_space.sample())
        if ended.any() and mode is gymnasium.vector.AutoresetMode.DISABLED:
            env.reset(options={"reset_mask": ended})
    env.close()
    alone.close()


def _parts(one: Any, two: Any) -> list[tuple[Any, Any]]:
    """The arrays of two observations, side by side."""
    return [(one[key], two[key]) for key in one] if isinstance(one, dict) else [(one, two)]


def _baselines(rng: random.Random, _folder: Path) -> None:
    """The checks and the vectors of stable-baselines3."""
    from stable_baselines3.common.env_checker import check_env
    from stable_baselines3.common.vec_env import DummyVecEnv, VecFrameStack, VecMonitor, VecTransposeImage

    name = _name(rng)
    if rng.random() < 0.3:
        check_env(gymnasium.make(name), warn=False)
        return
    env: Any = VecMonitor(DummyVecEnv([lambda: gymnasium.make(name)] * 2))
    if len(env.observation_space.shape or ()) == 3 and env.observation_space.shape[2] < 20:
        env = VecTransposeImage(VecFrameStack(env, 2))
    env.seed(rng.randrange(100))
    env.reset()
    for _ in range(rng.randrange(50)):
        env.step(np.array([env.action_space.sample() for _ in range(2)]))
    env.close()


def _recorded(rng: random.Random, _folder: Path) -> None:
    """Resets with options that other libraries pass, and states that are pickled and sent to another environment."""
    name = _name(rng)
    env: Any = gymnasium.make(name)
    env.reset(seed=rng.randrange(100), options=rng.choice((None, {}, {"render": True}, {1: 2}, {"scene": None})))
    for _ in range(rng.randrange(10)):
        env.step(env.action_space.sample())
    state: State = _pickled(env.unwrapped.get_state())
    other: Any = gymnasium.make(name)
    other.reset(options={"state": state})
    action = env.action_space.sample()
    one, two = env.step(action)[0], other.step(action)[0]
    if not all(np.array_equal(*pair) for pair in _parts(one, two)):
        raise FindError("after a state was sent to another environment, it continues differently")
    env.close()
    other.close()
