"""Variations: values of scenes and shifts in a Gymnasium space; round trips give the same episode."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj.shifts import SHIFTS
from magical_mj.utils.errors import InvalidSeedError, SettingsError, UnknownNameError

EVERYTHING = {name: 1 + number % 5 for number, name in enumerate(SHIFTS)}


def environment(task: str = "FindDupe", variant: str = "TestAll", **options: Any) -> Any:
    name = f"magical_mj/{task}-{variant}-LoRes4E-v0"
    return gymnasium.make(name, renderer="software", disable_env_checker=True, image_size=32, **options)


def test_an_unknown_factor_is_named() -> None:
    env = magical_mj.MagicalEnv("MoveToRegion", preset="State")
    with pytest.raises(UnknownNameError, match=r"unknown factor of camera 'zom'\. Did you mean 'zoom'"):
        env.reset(seed=0, options={"variation": {"camera": {"zom": 0.3}}})


@pytest.mark.parametrize("task", ["FindDupe", "MatchRegions", "MoveToCorner"])
def test_a_round_trip_gives_the_same_episode(task: str) -> None:
    able = {name: strength for name, strength in EVERYTHING.items() if not SHIFTS[name].supports(task)}
    with closing(environment(task, shifts=able)) as env, closing(environment(task)) as other:
        first, _ = env.reset(seed=5)
        variation = env.unwrapped.variation
        assert env.unwrapped.variation_space.contains(variation)
        again, _ = other.reset(seed=99, options={"variation": variation})
        assert np.array_equal(first, again)
        for action in np.random.default_rng(0).integers(0, 18, 15):
            assert np.array_equal(env.step(action)[0], other.step(action)[0])
        assert env.unwrapped.engine.get_state() == other.unwrapped.engine.get_state()
        assert str(other.unwrapped.variation) == str(variation)


def test_the_default_is_the_demo_scene() -> None:
    with closing(environment(variant="TestAll")) as env:
        space = env.unwrapped.variation_space
        assert space.contains(space.default)
        env.reset(options={"variation": space.default})
        assert env.unwrapped.scene == magical_mj.sample_scene("FindDupe", "Demo", 0)
        assert not env.unwrapped.engine.draws


def test_a_part_changes_nothing_else() -> None:
    with closing(environment(shifts="latency:2")) as env:
        env.reset(seed=5)
        before = env.unwrapped.variation
        env.reset(
            seed=5, options={"variation": {"camera": {"zoom": 0.2}, "scene": {"dynamics": [3, 1, 4, 1.25, 0.1, 0]}}}
        )
        after = env.unwrapped.variation
        assert after["camera"]["zoom"] == 0.2
        assert env.unwrapped.scene.dynamics.block_friction_force == 1.25
        after["camera"], after["scene"]["dynamics"] = before["camera"], before["scene"]["dynamics"]
        assert str(after) == str(before)


def test_names_are_drawn_as_other_suites_do() -> None:
    """By the convention of stable-worldmodel: a list of names, with dots, or ["all"]."""
    with closing(environment(variant="Demo")) as env:
        plain = env.unwrapped.variation_space.default
        env.reset(seed=1, options={"variation": ["camera.zoom", "palette"]})
        drawn = env.unwrapped.variation
        assert drawn["camera"]["zoom"] != 0 == drawn["camera"]["x"]
        assert drawn["palette"]["hue"] != 0
        assert str(drawn["scene"]) == str(plain["scene"])
        env.reset(seed=1, options={"variation": ["all"]})
        drawn = env.unwrapped.variation
        assert all(any(drawn[name].values()) for name in SHIFTS)
        assert str(drawn["scene"]) != str(plain["scene"])


@pytest.mark.parametrize("task", ["FindDupe", "MatchRegions", "MoveToCorner"])
def test_samples_of_the_space_can_be_played(task: str) -> None:
    with closing(environment(task)) as env:
        space = env.unwrapped.variation_space
        space.seed(3)
        samples = [space.sample() for _ in range(10)]
        space.seed(3)
        assert str(samples) == str([space.sample() for _ in range(10)])
        assert len({str(sample) for sample in samples}) == 10
        for sample in samples:
            assert space.contains(sample)
            env.reset(options={"variation": sample})
            assert str(env.unwrapped.variation) == str(sample)


@pytest.mark.parametrize(
    ("variation", "error"),
    [
        (["camra"], UnknownNameError),
        ("camera", SettingsError),
        (5, SettingsError),
        ({"camra": {}}, UnknownNameError),
        ({"camera": {"zoom": 0.9}}, SettingsError),
        ({"camera": {"zom": 0.1}}, UnknownNameError),
        *(({"scene": part}, SettingsError) for part in ({"block_count": 11}, {"dynamics": [3, "a"]})),
        ({"seed": "x"}, InvalidSeedError),
    ],
)
def test_variations_outside_the_space_are_refused(variation: Any, error: type[Exception]) -> None:
    with closing(environment()) as env:
        env.reset(seed=5)
        state = env.unwrapped.get_state()
        with pytest.raises(error):
            env.reset(options={"variation": variation})
        assert env.unwrapped.get_state() == state
