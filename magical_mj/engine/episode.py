"""Episodes as plain data: the setup that determines how they start, end and are scored, and their saved states.

Restoring a `State` continues its episode: for search, for an expert's corrections, for resets.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Robot, Scene, check_scene_type
from magical_mj.scene.bodies import GRIPPER, check_body_name
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.episode import Draws, EpisodeShifts, draw_shifts
from magical_mj.tasks.registry import check_rules, drawn_scene, task_spec, variant_name
from magical_mj.tasks.spec import Rules, TaskSpec
from magical_mj.utils.errors import InvalidSceneError, SettingsError, StateError, as_integer, short_repr
from magical_mj.utils.frozen import FrozenDict, frozen
from magical_mj.variants.rules import varied_axes


@dataclass(frozen=True, eq=False)
class State:
    """Everything that determines how an episode continues. `get_state` returns it, `set_state` restores it exactly.

    It contains only numbers. So it can be copied, pickled, sent to another process, or saved in a file field by field
    (the scene as `scene.to_json()`). It can be restored in every environment with the same task, or with the same scene
    without a task. The environments may have different observations. The generator that draws the scenes of later
    episodes is not part of the state.

    Attributes:
        scene: the episode's initial scene.
        steps: the number of control steps so far.
        simulation: MuJoCo's state: positions, velocities, actuators, the solver's warm start, and which blocks sleep.
            A vector with the same length for all states of episodes with this scene.
        frames: the stacks of frames of the environment, by name; empty if it has none.
        draws: the values that the shifts of the episode have drawn; see `magical_mj.shifts`.
        commands: for each shift that changes actions, the last commands that it received.
        trajectory: the scenes of the episode so far, the current one last, if the task's score depends on all scenes;
            otherwise empty.
    """

    scene: Scene
    steps: int
    simulation: NDArray[np.float64]
    frames: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict[str, NDArray[np.uint8]])
    draws: Draws = field(default_factory=dict[str, dict[str, float]])
    commands: Mapping[str, tuple[int, ...]] = field(default_factory=dict[str, tuple[int, ...]])
    trajectory: tuple[Scene, ...] = ()

    def __post_init__(self) -> None:
        """Freezes the mappings, which a state would otherwise share with its maker."""
        for name in ("frames", "draws", "commands"):
            value = getattr(self, name)
            if isinstance(value, Mapping) and not isinstance(value, FrozenDict):
                object.__setattr__(self, name, frozen(value))

    def __eq__(self, other: object) -> bool:
        """Whether both episodes are in exactly the same state. Frames are not compared: they follow from the rest."""
        if not isinstance(other, State):
            return NotImplemented
        return self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def _identity(self) -> tuple[object, ...]:
        shifts = repr(self.draws), repr(self.commands)
        return self.scene, self.steps, self.simulation.tobytes(), *shifts, self.trajectory


def _no_score(*_: object) -> float:
    raise InvalidSceneError(
        "a plain scene has no task, and so no score: give a task, or use magical_mj.score(task, ...)"
    )


NO_TASK: Final = TaskSpec(
    name="plain",
    summary="",
    demo=Scene(Robot(0.0, 0.0, 0.0)),
    steps=1,
    check=lambda _: None,
    score=_no_score,
    distance=_no_score,
)
"""The definition of plain scenes, which have neither score nor horizon."""


@dataclass(frozen=True)
class Setup:
    """An environment's task, variant, rules and body, checked. They determine horizon, score and initial scenes."""

    task: str | None
    variant: str = "Demo"
    rules: Rules = "paper"
    body: str = GRIPPER
    speeds: bool = False
    """Whether vectors of x-magical's speeds are also actions. They always are in its own task."""

    spec: TaskSpec = field(init=False, repr=False, compare=False)
    """The task's definition."""
    horizon: int | None = field(init=False, repr=False, compare=False)
    """The number of actions of an episode; None if it never ends."""

    def __post_init__(self) -> None:
        """Checks the names, and sets what follows from them."""
        spec = NO_TASK if self.task is None else task_spec(self.task)
        variant = variant_name(self.variant)
        varied_axes(spec, variant)  # an error if the task does not have the variant
        check_body_name(self.body)
        horizon = None if self.task is None else spec.horizon(check_rules(self.rules), self.body)
        follows = {"spec": spec, "variant": variant, "speeds": self.speeds or spec.speeds, "horizon": horizon}
        for name, value in follows.items():
            object.__setattr__(self, name, value)

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickling, without the task's functions."""
        return Setup, (self.task, self.variant, self.rules, self.body, self.speeds)

    def check(self, scene: object) -> Scene:
        """The scene. Raises `InvalidSceneError` unless an episode can start in it."""
        scene = check_scene_type(scene)
        check_scene(scene)
        self.spec.check(scene)
        if self.task is not None and scene.robot.body != self.body:
            raise InvalidSceneError(
                f"the robot of this scene has the body {scene.robot.body!r}, and this environment was made for "
                f"{self.body!r}: make another environment with body={scene.robot.body!r}"
            )
        return scene

    def scene_and_shifts(
        self,
        shifts: Mapping[str, int],
        seed: int | None = None,
        scene: Scene | None = None,
        draws: Draws | None = None,
    ) -> tuple[Scene, EpisodeShifts]:
        """The initial scene of an episode, and its shifts with these strengths. Both are drawn from the seed.

        Shifts do not change a given scene, and draw their values from seed 0, unless their `draws` are given.

        Raises:
            InvalidSceneError: if an episode cannot start in the scene.
            SettingsError: if a seed is given without a task.
        """
        if draws is None and shifts:
            draws = draw_shifts(shifts, seed if scene is None and seed is not None else 0)
        episode = EpisodeShifts(draws or {})
        if scene is not None or seed is None:
            return self.check(scene), episode
        if self.task is None:
            raise SettingsError("a plain scene has no seeds: give a scene or a state")
        return episode.scene(drawn_scene(self.spec, self.variant, seed, self.body), self.task), episode

    def check_start(
        self, *, seed: object = None, scene: object = None, state: State | None = None, limit: int | None = None
    ) -> None:
        """Checks the arguments of a reset in an environment whose episodes end after `limit` steps.

        Raises:
            SettingsError: if more than one of seed, scene and state is given.
            StateError: if the state is invalid, or its episode has ended.
        """
        if (seed is not None) + (scene is not None) + (state is not None) > 1:
            starts = {"seed": seed, "scene": scene, "state": state}
            names = [name for name, value in starts.items() if value is not None]
            raise SettingsError(f"give only one of seed, scene and state, not {' and '.join(names)}")
        if state is not None:
            self.check_state(state)
            if limit is not None and state.steps >= limit:
                raise StateError(
                    f"the episode of this state has ended, after {state.steps} steps: give a state with fewer than "
                    f"{limit}"
                )

    def check_state(self, state: object) -> None:
        """Raises a `StateError` unless it is a `State` with fields of the right types, as episodes of the task save it.

        `Simulation.restore` checks the simulation's numbers.
        """
        if not (
            isinstance(state, State)
            and isinstance(state.scene, Scene)
            and as_integer(state.steps) is not None
            and isinstance(state.frames, Mapping)
            and isinstance(state.draws, Mapping)
            and isinstance(state.commands, Mapping)
            and isinstance(state.trajectory, tuple)
            and all(isinstance(scene, Scene) for scene in state.trajectory)
        ):
            raise StateError(
                "a state must be a result of get_state(): a scene, the number of steps (0 or more), the simulation's "
                f"numbers, and frames by name; not {short_repr(state)}"
            )
        first, number = state.trajectory[:1], len(state.trajectory)
        if self.spec.trajectory and (first != (state.scene,) or number != state.steps + 1):
            raise StateError(
                f"this state lacks the scenes of earlier steps, and the score of {self.task} depends on them: "
                f"give a state from get_state() of an environment of {self.task}"
            )


PLAIN: Final = Setup(None)
"""The setup of plain scenes, with any body of the robot."""
