"""What is played: a task, a variant and rules, or nothing of these, and what follows from them for scenes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.registry import check_rules, environment_axes, sample_scene, task_spec, variant_name
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import InvalidSceneError, SettingsError


@dataclass(frozen=True)
class Setup:
    """What is played.

    Attributes:
        task: one of `magical_mj.TASKS`, a task that a package announces, or ``"package.module:SPEC"``; None for plain
            scenes, which have no score and no horizon.
        variant: one of `magical_mj.VARIANTS` that the task has.
        rules: "paper", or "released" for the scores and horizons of the original's released code.

    Raises:
        UnknownNameError: for an unknown task, variant or rules, or an unsupported pair.
        TaskError: if the task of another package is invalid.
    """

    task: str | None
    variant: str = "Demo"
    rules: Rules = "paper"

    def __post_init__(self) -> None:
        """Checks the names."""
        if self.task is not None:
            object.__setattr__(self, "variant", variant_name(self.variant))
            environment_axes(self.task, self.variant)
        check_rules(self.rules)

    @property
    def horizon(self) -> int | None:
        """The number of actions after which an episode ends; None: never."""
        return None if self.task is None else task_spec(self.task).horizon(self.rules)

    def check(self, scene: object) -> None:
        """Raises `InvalidSceneError` unless it is a `Scene` in which an episode can start."""
        scene = check_scene_type(scene)
        check_scene(scene)
        if self.task is not None:
            task_spec(self.task).check(scene)

    def sample(self, seed: int) -> Scene:
        """The scene of this seed.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            SettingsError: without a task.
        """
        if self.task is None:
            raise SettingsError("a plain scene has no seeds: give a scene or a state")
        return sample_scene(self.task, self.variant, seed)

    @np.errstate(all="ignore")  # no result depends on the caller's settings
    def score(self, initial: Scene, final: Scene) -> float:
        """The score of a final scene in [0, 1].

        Raises:
            InvalidSceneError: without a task.
        """
        if self.task is None:
            raise InvalidSceneError("a plain scene has no score; name a task, or use magical_mj.score(task, ...)")
        return task_spec(self.task).checked_score(initial, final, self.rules)


def check_one_start(**starts: object) -> None:
    """Raises a `SettingsError` if more than one of the things from which an episode can start is given."""
    names = [name for name, value in starts.items() if value is not None]
    if len(names) > 1:
        raise SettingsError(f"an episode starts from one of seed, scene and state, not from {' and '.join(names)}")
