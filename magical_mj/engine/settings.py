"""The settings of an environment: the checked arguments of `load`, and what they determine for its episodes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import cast

from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.geometry import check_scene
from magical_mj.scene.state_vector import OBSERVATIONS, StateEncoder
from magical_mj.tasks.registry import check_rules, environment_axes, sample_scene, task_spec, variant_name
from magical_mj.tasks.spec import REWARDS, Reward, Rules
from magical_mj.utils.errors import InvalidSceneError, SettingsError, check_name, shown


@dataclass(frozen=True)
class EnvironmentSettings:
    """The checked arguments of `magical_mj.load`, which documents them and the errors that invalid ones raise.

    Attributes:
        task: None to run `scene` without a task, so without score and horizon.
        scene: the scene of every episode; None to sample scenes of the task's variant.
    """

    task: str | None
    variant: str
    scene: Scene | None
    observations: Sequence[str]
    image_size: int
    reward: Reward
    rules: Rules

    def __post_init__(self) -> None:
        """Checks every setting."""
        if self.task is not None:
            object.__setattr__(self, "variant", variant_name(self.variant))
            environment_axes(self.task, self.variant)
        check_rules(self.rules)
        check_name("reward", self.reward, REWARDS)
        check_size(self.image_size)
        object.__setattr__(self, "observations", check_observations(self.observations))
        if self.task is None or self.scene is not None:
            self.check(self.scene)

    def check(self, scene: object) -> None:
        """Raises `InvalidSceneError` unless it is a `Scene` in which an episode can start."""
        scene = check_scene_type(scene)
        check_scene(scene)
        if "state" in self.observations:
            StateEncoder(scene)
        if self.task is not None:
            task_spec(self.task).check(scene)

    def sample(self, seed: int) -> Scene:
        """The scene of the episode with this seed."""
        if self.task is None or self.scene is not None:
            return cast("Scene", self.scene)  # without a task there is one, as checked at the start
        scene = sample_scene(self.task, self.variant, seed)
        if "state" in self.observations:
            StateEncoder(scene)  # while the present episode can still go on
        return scene

    @property
    def horizon(self) -> int | None:
        """Number of control steps after which an episode ends; None: never."""
        return None if self.task is None else task_spec(self.task).horizon(self.rules)

    def score(self, initial: Scene, final: Scene) -> float:
        """The score of a final scene in [0, 1].

        Raises:
            InvalidSceneError: without a task.
        """
        if self.task is None:
            raise InvalidSceneError("a plain scene has no score; load a task, or use magical_mj.score(task, ...)")
        return task_spec(self.task).checked_score(initial, final, self.rules)


def check_observations(names: Sequence[str]) -> tuple[str, ...]:
    """The names of observations as a tuple.

    Raises:
        SettingsError: for anything but a list or tuple.
        UnknownNameError: if there is no such observation.
    """
    if not isinstance(names, list | tuple):
        example = names if isinstance(names, str) and names in OBSERVATIONS else "ego"
        raise SettingsError(
            f'observations must be a list or a tuple of names, such as ("{example}",), not {shown(names)}'
        )
    for name in names:
        check_name("observation", name, OBSERVATIONS)
    return tuple(names)
