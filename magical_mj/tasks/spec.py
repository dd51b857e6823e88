"""The definition of a task as data, `TaskSpec`. Every task module defines one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np

from magical_mj.scene import Scene
from magical_mj.scene.bodies import BODIES, GRIPPER, check_body_name
from magical_mj.tasks.planning import Noise, Subgoal
from magical_mj.utils.errors import SettingsError, TaskError, as_integer, short_repr
from magical_mj.utils.imports import errors_of_user
from magical_mj.variants import VariationRules

Rules = Literal["paper", "released"]
"""The set of rules for scores and horizons: the paper's appendix, or the original's released code where it differs."""
RULES: Final[tuple[Rules, ...]] = get_args(Rules)

Reward = Literal["none", "score", "dense"]
"""The reward of each step. "none": 0, since the benchmark has no reward. "score": 0, and the score at the last step.
"dense": the score at the last step, and at every step also the decrease of the remaining distance
(`TaskSpec.distance`)."""
REWARDS: Final[tuple[Reward, ...]] = get_args(Reward)

_ROUNDING: Final = 1e-9
WORDINGS: Final = "five tuples of five sentences, or ()"


def as_sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}."


def _is_text(value: object) -> bool:
    return isinstance(value, str)


Measure = Callable[[Scene, Scene, Rules], float] | Callable[[tuple[Scene, ...], Rules], float]
"""(initial scene, current scene, rules) -> a number. The scenes have the same blocks and regions. For tasks with
`trajectory=True`: (scenes, rules), where the scenes are the initial one and those after each step."""
Plan = Callable[[Scene, Scene, Noise], Iterable[Subgoal]] | Callable[[tuple[Scene, ...], Noise], Iterable[Subgoal]]
"""(initial scene, current scene, noise) -> the remaining subgoals. For tasks with `trajectory=True`: (scenes, noise).
It is called only if the task is not solved. An expert calls it again whenever a block is not at its expected position.
The noise selects one of several good plans."""


@dataclass(frozen=True, kw_only=True)
class TaskSpec(VariationRules):
    """A task: its variation rules, its score and its plan."""

    summary: str
    """The goal in one line, for tables."""
    steps: int
    """The horizon under the paper's rules, in control steps."""
    released_steps: int | None = None
    """The horizon under the released code's rules, if it differs."""
    score: Measure
    """The score in [0, 1], of the final scene, or of the scenes of all steps."""
    trajectory: bool = False
    """Whether `score`, `distance` and `plan` receive the scenes of all steps, instead of the first and the current."""
    distance: Measure | None = None
    """The remaining distance in world units, for `reward="dense"`: the sum of the distances of all wrong objects to
    positions where they would be right. It is 0 if and only if the score is 1. None: the task has no dense rewards."""
    side_effects: Callable[[Scene, Scene], int] | None = None
    """(initial scene, final scene) -> the number of blocks that moved and that the goal does not name. None: not known.
    Evaluations record it."""

    bodies: tuple[str, ...] = (GRIPPER,)
    """The bodies in `magical_mj.scene.bodies.BODIES` that the scripted expert can use in this task. Environments accept
    every body."""
    steps_of: tuple[tuple[str, int], ...] = ()
    """Pairs of a body and its horizon, for bodies with other horizons."""
    speeds: bool = False
    """Whether actions are x-magical's speeds (`magical_mj.assets.robot.speed_signal`). The 18 then mean full speed."""

    plan: Plan | None = None
    """The plan of the scripted expert. Without one, everything except the expert works."""
    wordings: tuple[tuple[str, ...], ...] = ()
    """Other sentences with the meaning of `summary`, for the five strengths of the shift `words`: five for each. Empty:
    the task does not support this shift, unless it is one of the benchmark's."""
    label: str = ""
    """The task in messages, if not its name, such as the text of an intent."""
    like: str = ""
    """The benchmark's task that this task modifies. Policies for several tasks receive that task's name."""
    demonstrations: Path | str | None = None
    """The folder of demonstrations that another package ships for its task. Learners are trained on them."""

    def __post_init__(self) -> None:
        """Raises a `TaskError` if a field has a wrong type or is out of range."""
        super().__post_init__()
        for text in ("summary", "label"):
            self._require(text, _is_text(getattr(self, text)), "a str")
        sentences = [len(group) for group in self.wordings if isinstance(group, tuple) and all(map(_is_text, group))]
        self._require("wordings", sentences in ([], [5] * 5) and len(sentences) == len(self.wordings), WORDINGS)
        self._require("demonstrations", isinstance(self.demonstrations, Path | str | None), "a folder, or None")
        self._require("like", _is_text(self.like), "the name of a task")
        self._require("score", callable(self.score), "a function")
        self._require("trajectory", isinstance(self.trajectory, bool), "a bool")
        self._require_functions("distance", "side_effects", "plan")
        self._require("steps", as_integer(self.steps, 1) is not None, "an integer above 0")
        released = self.released_steps is None or as_integer(self.released_steps, 1) is not None
        self._require("released_steps", released, "an integer above 0, or None")

    @property
    def instruction(self) -> str:
        """The goal as policies and data sets receive it: a sentence with a capital and a full stop."""
        return as_sentence(self.summary)

    @property
    def title(self) -> str:
        """The task in messages: its name, or the label if it has one."""
        return self.label or self.name

    def horizon(self, rules: Rules = "paper", body: str = GRIPPER) -> int:
        """The number of control steps of an episode."""
        if body in dict(self.steps_of):
            return dict(self.steps_of)[body]
        if rules == "released" and self.released_steps is not None:
            return self.released_steps
        return self.steps

    def check_expert_body(self, body: str) -> None:
        """Raises a `SettingsError` unless the expert solves the task with this body. Users' bodies are not checked.

        Raises:
            InvalidSceneError: if the body does not exist.
        """
        if check_body_name(body) in BODIES and body not in self.bodies:
            raise SettingsError(
                f"the expert cannot solve {self.title} with the body {body!r}, so no demonstrations exist: use "
                f"{', '.join(self.bodies)} (docs/bodies.md). Environments accept every body, for policies that learn"
            )

    def checked_score(self, scenes: Sequence[Scene], rules: Rules) -> float:
        """The result of `score`, which must be a number in [0, 1] up to rounding, and is clipped to that range.

        Args:
            scenes: the initial and the current scene. If the task has `trajectory`, also all scenes between them.
            rules: "paper" or "released".

        Raises:
            TaskError: if the result is not such a number, or `score` raises an error that is not one of this package's.
        """
        with errors_of_user(f"{self.title}.score failed"):
            function: Callable[..., Any] = self.score
            score = function(*self._seen(scenes), rules)
        if not isinstance(score, int | float | np.number) or not -_ROUNDING <= score <= 1.0 + _ROUNDING:
            raise TaskError(f"{self.title}.score must return a number in [0, 1], but returned {short_repr(score)}")
        return min(max(float(score), 0.0), 1.0)

    def check_reward(self, reward: str) -> None:
        """Raises a `TaskError` if the reward is "dense" and the task does not define `distance`."""
        if reward == "dense" and self.distance is None:
            raise TaskError(
                f'{self.title} ({self.summary}) has no dense rewards: use reward="score". In a task of your own, add a '
                "function `distance` to its TaskSpec (docs/adding-a-task.md)"
            )

    def remaining(self, scenes: Sequence[Scene], rules: Rules) -> float:
        """The result of `distance`, which must be a finite number of at least 0. The scenes are those of `score`.

        Raises:
            TaskError: if the task does not define `distance`, if the result is not such a number, or if `distance`
                raises an error that is not one of this package's.
        """
        self.check_reward("dense")
        with errors_of_user(f"{self.title}.distance failed"):
            function: Any = self.distance
            left = function(*self._seen(scenes), rules)
        if not isinstance(left, int | float | np.number) or not 0.0 <= left < math.inf:
            raise TaskError(f"{self.title}.distance must return a finite number >= 0, but returned {short_repr(left)}")
        return float(left)

    def _seen(self, scenes: Sequence[Scene]) -> tuple[Any, ...]:
        """The scenes as arguments of the task's functions."""
        return (tuple(scenes),) if self.trajectory else (scenes[0], scenes[-1])

    def subgoals(self, scenes: Sequence[Scene], noise: Noise, rules: Rules = "paper") -> tuple[Subgoal, ...]:
        """The remaining subgoals. Empty if the task is solved by these rules. The scenes are those of `checked_score`.

        Raises:
            TaskError: if the task has no plan, or the plan returns other values, or raises an error that is not one of
                this package's.
        """
        plan, now = self.check_plan(), scenes[-1]
        if self.checked_score(scenes, rules) == 1.0:
            return ()
        with errors_of_user(f"{self.title}.plan failed"):
            returned: Any = plan(*self._seen(scenes), noise)
            todo = tuple(returned) if isinstance(returned, Iterable) else (returned,)  # a generator runs here
        for subgoal in todo:
            whose = (None, *range(len(now.blocks)))
            if not isinstance(subgoal, Subgoal) or subgoal.block not in whose or not _is_point(subgoal.target):
                raise TaskError(
                    f"{self.title}.plan must return Subgoals of the robot (None) or of blocks 0 to "
                    f"{len(now.blocks) - 1}, with points (x, y) as targets, but returned {short_repr(subgoal)}"
                )
        return todo

    def check_plan(self) -> Callable[..., Any]:
        """The plan. Raises a `TaskError` if there is none."""
        if self.speeds:
            raise TaskError(
                f"the expert of {self.title} acts by speeds, which evaluations and videos do not store; "
                f"magical-mj demos generate --tasks {self.title} plays its episodes"
            )
        if self.plan is None:
            raise TaskError(f"{self.title} has no plan, which an expert needs; add one to its TaskSpec")
        return self.plan


def _is_point(target: Any) -> bool:
    try:
        point = np.asarray(target, float)
    except (TypeError, ValueError):
        return False
    return point.shape == (2,) and bool(np.isfinite(point).all())
