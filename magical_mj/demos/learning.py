"""Demonstrations as training data: observations and actions, and the environment that has the same observations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.scene_model import SceneModel
from magical_mj.demos.demonstration import Demonstration, checked
from magical_mj.demos.recording import posed
from magical_mj.demos.shipped import load
from magical_mj.envs.presets import frame_stacks, preset_named
from magical_mj.envs.registration import env_id
from magical_mj.observations import StateEncoder
from magical_mj.policies.interface import Observations, Transitions
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.suites import suite_of
from magical_mj.utils.errors import DemonstrationError


def transitions(
    demos: Iterable[Demonstration] | str,
    preset: str = "LoRes4E",
    *,
    drop_noop: bool = True,
    renderer: str | None = None,
) -> Transitions:
    """All transitions of all demonstrations in one pair of arrays. See `stream` for arguments and errors."""
    parts = list(stream(demos, preset, drop_noop=drop_noop, renderer=renderer))
    if not parts:
        raise DemonstrationError("no demonstrations were given: give at least one, or the name of a task")
    actions = np.concatenate([part.actions for part in parts])
    views = [part.observations for part in parts if isinstance(part.observations, dict)]
    if views:
        return Transitions({view: np.concatenate([part[view] for part in views]) for view in views[0]}, actions)
    rows = [part.observations for part in parts if isinstance(part.observations, np.ndarray)]
    return Transitions(np.concatenate(rows), actions)


def stream(
    demos: Iterable[Demonstration] | str,
    preset: str = "LoRes4E",
    *,
    drop_noop: bool = True,
    renderer: str | None = None,
) -> Iterator[Transitions]:
    """Yields the transitions of each demonstration. Pictures are only rendered when they are needed.

    Observations equal those of the preset's Gymnasium environment: the first picture of an episode fills its first
    stack. The state after the last action is left out, since no action follows it.

    Args:
        demos: demonstrations, or the name of a task for all of its demonstrations.
        preset: the name of a Gymnasium preset, "" for the pair of current views.
        drop_noop: leave out the transitions with the no-op action, as the original does. Stacks still contain the
            frames of all steps.
        renderer: the renderer, see `magical_mj.Engine`.

    Raises:
        DemonstrationError: if a task has no demonstrations, or `demos` contains other objects.
        UnknownNameError: for an unknown task or preset.
    """
    if isinstance(demos, str):
        demos = load(demos)
    for demo in checked(demos):
        rows = observations(demo, preset, renderer)
        steps = np.flatnonzero(demo.acts) if drop_noop else np.arange(len(demo.actions))
        before = {view: stacks[steps] for view, stacks in rows.items()} if isinstance(rows, dict) else rows[steps]
        yield Transitions(before, demo.actions[steps])


def observations(demo: Demonstration, preset: str = "LoRes4E", renderer: str | None = None) -> Observations:
    """The observations of the preset before the first and after each action: steps + 1 rows."""
    kind, model = preset_named(preset), SceneModel(demo.scene)
    with np.errstate(all="ignore"):  # underflow to 0 in float32 is expected, even if the caller makes it an error
        suite = suite_of(demo.task)
        if kind.layout == "state" and suite is not None and not kind.start:
            return np.array([suite.state(scene) for scene in demo.scenes()])
        if kind.layout == "state":
            encode = StateEncoder(demo.scene, start=kind.start)
            states = zip(demo.qpos, demo.qvel, strict=True)
            return np.array(
                [encode(model.poses(qpos), model.velocities(qvel), model.fingers(qpos)) for qpos, qvel in states]
            )
        stacks = frame_stacks(kind)
        rows: dict[str, NDArray[Any]] = {
            name: np.empty((len(demo.qpos), *stack.shape), np.uint8) for name, stack in stacks.items()
        }
        for number, simulation in enumerate(posed(demo, renderer)):
            for name, stack in stacks.items():
                (stack.push if number else stack.start)(simulation.draw)
                rows[name][number] = stack.latest
        if kind.layout != "dict":
            return next(iter(rows.values()))
        if kind.fingers:
            rows["fingers"] = np.array([model.fingers(qpos) for qpos in demo.qpos], np.float32)
        return rows


def rewards(demo: Demonstration) -> NDArray[np.float64]:
    """The reward of each step, shape (steps,): 0, and the score at the last step.

    In tasks with speeds it is the score after each step, as in x-magical.
    """
    steps = len(demo.actions)
    if task_spec(demo.task).speeds:
        return np.array([demo.rescored(step) for step in range(1, steps + 1)])
    return np.where(np.arange(steps) == steps - 1, demo.score, 0.0)


def environment_of(demo: Demonstration, preset: str, **settings: Any) -> tuple[str, dict[str, Any]]:
    """The id and the arguments with which `gymnasium.make` makes the environment of a demonstration.

    It has the demonstration's body and shifts. Its ``reset(seed=...)`` accepts the seeds of the scenes.

    Args:
        demo: the demonstration.
        preset: the preset of the data set's observations.
        settings: further arguments of `gymnasium.make`.

    Raises:
        DemonstrationError: if the task is one of a suite, and the preset is not State.
    """
    body, suite = demo.scene.robot.body, suite_of(demo.task)
    if suite is None:
        facts = {"body": body if body != GRIPPER else "", "shifts": demo.shifts}
        kwargs = {name: value for name, value in facts.items() if value}
        return env_id(demo.task, demo.variant, preset), {**kwargs, **settings}
    if preset != "State":
        raise DemonstrationError(f"data sets of {demo.task} must have the preset State, not {preset or 'views'}")
    return suite.state_id(demo.task, demo.variant, body), {}
