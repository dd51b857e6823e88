"""What learners get of demonstrations: the observations of the Gymnasium environments, and the actions."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.demos import Demonstration
from magical_mj.envs.presets import PRESETS
from magical_mj.utils.errors import DemonstrationError, UnknownNameError


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    """The first steps of a short one."""
    demo = demos.load("FixColour")[0]
    return dataclasses.replace(demo, actions=demo.actions[:6], qpos=demo.qpos[:7], qvel=demo.qvel[:7])


@pytest.mark.parametrize("preset", PRESETS)
def test_observations_are_those_of_the_gymnasium_environment(demo: Demonstration, preset: str) -> None:
    env = gymnasium.make(magical_mj.env_id("FixColour", "Demo", preset))
    first, _ = env.reset(seed=demo.scene_seed)
    expected = [first, *(env.step(action)[0] for action in demo.actions.tolist())]
    rows = demos.observations(demo, preset)
    for number, observation in enumerate(expected):
        if isinstance(rows, dict):
            assert all(np.array_equal(rows[view][number], observation[view]) for view in rows)
        else:
            assert np.array_equal(rows[number], observation)
    env.close()


def test_transitions_leave_out_no_ops_but_stack_their_frames(demo: Demonstration) -> None:
    actions = demo.actions.copy()
    actions[[1, 3]] = 0
    idle = dataclasses.replace(demo, actions=actions)
    every = demos.transitions([idle, idle], "LoRes4E", drop_noop=False)
    busy = demos.transitions([idle, idle], "LoRes4E")
    assert np.array_equal(every.actions, np.concatenate([actions, actions]))
    kept = every.actions != 0
    assert np.array_equal(busy.actions, every.actions[kept])
    assert np.array_equal(busy.observations, every.observations[kept])
    start = every.observations[0]
    assert all(np.array_equal(start[..., :3], start[..., k : k + 3]) for k in (3, 6, 9))
    with pytest.raises(DemonstrationError):
        demos.transitions([])


def test_transitions_of_a_task_are_those_of_its_demonstrations() -> None:
    wanted = demos.transitions(demos.load("MoveToRegion"), "State")
    for got, want in zip(demos.transitions("MoveToRegion", "State"), wanted, strict=True):
        np.testing.assert_array_equal(got, want)
    with pytest.raises(UnknownNameError, match="Did you mean 'MoveToRegion'"):
        demos.transitions("MoveToRegoin")


def test_streams_draw_nothing_before_it_is_asked_for(demo: Demonstration) -> None:
    def endless() -> Iterator[Demonstration]:
        while True:
            yield demo

    stream = demos.stream(endless(), "LoRes4A")
    assert len(next(stream).actions) == len(next(stream).actions)


def test_no_result_depends_on_the_settings_of_the_caller() -> None:
    """Velocities of 1e-44 do not fit into numbers of 32 bits, which is what numpy would tell."""
    demo = demos.load("FindDupe")[0]
    tiny = dataclasses.replace(demo, qvel=demo.qvel * 1e-42)
    expected, fingers = demos.observations(tiny, "State"), demos.observations(tiny, "LoResFingers")["fingers"]
    assert (np.abs(expected[np.nonzero(expected)]) < np.finfo(np.float32).tiny).any()
    with np.errstate(all="raise"):
        assert np.array_equal(demos.observations(tiny, "State"), expected)
        assert np.array_equal(demos.observations(tiny, "LoResFingers")["fingers"], fingers)
