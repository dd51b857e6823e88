"""A record says what was played: the facts of rollouts, of recorders and of engines come from what ran."""

from __future__ import annotations

from functools import partial
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.envs.vector import VectorEnv
from magical_mj.evaluation import Episode, rollouts
from magical_mj.utils.errors import DemonstrationError, EvaluationError
from tests.helpers.agents import Counting

UNUSUAL: dict[str, Any] = {
    "preset": "State",
    "body": "longstick",
    "shifts": "slip:3",
    "rules": "released",
    "renderer": "software",
}
SINGLY = gymnasium.vector.AutoresetMode.DISABLED


class Patient(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Changes nothing."""


class Own(magical_mj.MagicalEnv):
    """Changes nothing."""


def unusual(kind: type = magical_mj.MagicalEnv, variant: str = "Layout") -> Any:
    return kind("MoveToRegion", variant, **UNUSUAL)


@pytest.mark.parametrize("vector", ["single", "ours", "sync", "async"])
def test_rollouts_record_the_environment_that_played(vector: str) -> None:
    make = {
        "single": unusual,
        "ours": lambda: VectorEnv([unusual(), unusual()]),
        "sync": lambda: gymnasium.vector.SyncVectorEnv([unusual] * 2, autoreset_mode=SINGLY),
        "async": lambda: gymnasium.vector.AsyncVectorEnv([unusual] * 2, context="spawn", autoreset_mode=SINGLY),
    }
    env = make[vector]()
    (result,) = rollouts(env, Counting(), [Episode("MoveToRegion", "Layout", 10_000_003)])
    recorded = (result.variant, result.body, result.shift, result.rules, result.preset, result.gl, result.split)
    assert recorded == ("Layout", "longstick", "slip:3", "released", "State", "software", "dev")
    with pytest.raises(EvaluationError, match="the environment is MoveToRegion Layout, but an episode has"):
        list(rollouts(env, Counting(), [Episode("MoveToRegion", "Demo", 0)]))
    env.close()


@pytest.mark.parametrize("together", [False, True])
def test_rollouts_record_wrappers_and_classes_in_a_vector(together: bool) -> None:
    wrapped = partial(gymnasium.vector.SyncVectorEnv, autoreset_mode=SINGLY)
    name = "magical_mj/MoveToRegion-Demo-State-v0"
    outside = wrapped([lambda: Patient(gymnasium.make(name))] * 2) if together else Patient(gymnasium.make(name))
    own = VectorEnv([unusual(Own), unusual(Own)]) if together else unusual(Own)
    for env, variant, expected in ((outside, "Demo", "Patient"), (own, "Layout", "Own")):
        (result,) = rollouts(env, Counting(), [Episode("MoveToRegion", variant, 0)])
        assert result.wrap == f"{__name__}:{expected}"
        env.close()


def test_a_vector_of_different_environments_plays_each_episode_in_its_own() -> None:
    env = VectorEnv([unusual(variant="Demo"), unusual(variant="Layout")])
    pairs = [("MoveToRegion", variant) for variant in ("Demo", "Layout", "Demo")]
    results = list(rollouts(env, Counting(), [Episode(*pair, seed) for seed, pair in enumerate(pairs)]))
    assert [(result.task, result.variant) for result in results] == pairs
    with pytest.raises(EvaluationError, match="is MoveToRegion Layout, but an episode has MoveToRegion Demo"):
        list(rollouts(env, Counting(), [Episode("MoveToRegion", "Demo", seed) for seed in (0, 1)]))
    mixed = VectorEnv([unusual(), magical_mj.MagicalEnv("MoveToRegion", "Layout", "State")])
    with pytest.raises(EvaluationError, match="differ in rules, body, shift, gl"):
        list(rollouts(mixed, Counting(), [Episode("MoveToRegion", "Layout", 0)]))


@pytest.mark.parametrize(
    "name", ["setup", "task", "variant", "rules", "seed", "horizon", "shifts", "steps", "model", "data"]
)
def test_what_an_engine_plays_cannot_be_renamed(name: str) -> None:
    engine = magical_mj.Engine("MoveToRegion", seed=0, shifts="clutter:3")
    with pytest.raises(AttributeError):
        setattr(engine, name, "released")
    with pytest.raises(TypeError, match="cannot be changed"):
        engine.shifts["clutter"] = 5  # pyright: ignore[reportIndexIssue]


def test_values_of_shifts_that_are_not_those_of_the_seed_are_no_demonstration() -> None:
    engine, other = (magical_mj.Engine("MoveToRegion", seed=seed, shifts="slip:3") for seed in (7, 8))
    engine.reset(seed=7, draws=other.draws)
    recorder = demos.Recorder(engine)
    recorder.step(1)
    with pytest.raises(DemonstrationError, match="values of its shifts are not those of its seed"):
        recorder.demonstration("human")
    engine.reset(seed=7)
    recorder = demos.Recorder(engine)
    recorder.step(1)
    assert recorder.demonstration("human").shifts == "slip:3"


def test_a_recorder_notices_another_state_with_as_many_steps() -> None:
    engine = magical_mj.Engine("MoveToRegion", seed=7)
    engine.step(1)
    other = engine.get_state()
    engine.reset(seed=7)
    recorder = demos.Recorder(engine)
    recorder.step(2)
    engine.set_state(other)
    with pytest.raises(DemonstrationError, match="changed without the recorder"):
        recorder.step(0)


def spoil(value: Any) -> None:
    """Changes everything in a value that can be changed."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value[...] = 1
    elif isinstance(value, dict):
        for key, part in list(value.items()):
            spoil(part)
            try:
                value[key] = 0.3
            except TypeError:
                continue


@pytest.mark.parametrize("kind", ["gymnasium", "engine", "composer"])
def test_nothing_that_is_handed_out_changes_the_environment(kind: str) -> None:
    made: dict[str, Any] = {
        "gymnasium": lambda: magical_mj.MagicalEnv("MoveToRegion", "Layout", shifts="camera:3,latency:1"),
        "engine": lambda: magical_mj.Engine("MoveToRegion", "Layout", seed=5, shifts="camera:3,latency:1"),
        "composer": lambda: magical_mj.load("MoveToRegion", "Layout", shifts="camera:3,latency:1"),
    }
    env, twin = made[kind](), made[kind]()
    for each in (env, twin):
        each.reset(seed=5)
        each.step(1)
    spoil(env.get_state())
    state = env.get_state()
    for name in ("frames", "draws", "commands"):
        spoil(getattr(state, name))
    spoil(state.simulation)
    for name in [name for name in dir(type(env)) if isinstance(getattr(type(env), name), property)]:
        spoil(getattr(env, name, None))
    if kind == "gymnasium":
        spoil(env.variation_space.default)
        assert env.variation_space.contains(env.variation_space.default)
    restored = twin.get_state()
    assert env.get_state() == restored
    for each in (env, twin):
        each.reset(seed=6)
        each.step(4)
    assert env.get_state() == twin.get_state()
    assert restored.draws != twin.get_state().draws
