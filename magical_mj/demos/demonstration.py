"""The type of a demonstration: a complete episode as numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from numbers import Integral, Real
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from magical_mj._version import __version__
from magical_mj.assets.robot import JOINTS
from magical_mj.assets.world import World
from magical_mj.scene import Scene
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import environment_axes, score, task_spec, variant_name
from magical_mj.utils.errors import DemonstrationError, shown

Demonstrator = Literal["expert", "human"]
DEMONSTRATORS: Final[tuple[Demonstrator, ...]] = get_args(Demonstrator)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """An episode: its initial scene, the actions, and the states before the first action and after each action.

    Raises:
        DemonstrationError: if the parts do not fit each other.
        UnknownNameError: if there is no such environment.
    """

    task: str
    variant: str
    scene_seed: int
    """`scene` is `sample_scene(task, variant, scene_seed)`."""
    demonstrator: Demonstrator
    seed: int
    """The expert's seed; of people, the scene's."""
    scene: Scene
    actions: NDArray[np.uint8]
    """Shape (steps,)."""
    qpos: NDArray[np.float64]
    """MuJoCo's positions, shape (steps + 1, nq)."""
    qvel: NDArray[np.float64]
    """MuJoCo's velocities, shape (steps + 1, nv)."""
    score: float
    """The score of the last state by the paper's rules."""
    package: str = __version__
    mujoco: str = version("mujoco")

    def __post_init__(self) -> None:
        object.__setattr__(self, "variant", variant_name(self.variant))
        environment_axes(self.task, self.variant)
        for name in ("scene_seed", "seed"):
            seed = getattr(self, name)
            if not isinstance(seed, Integral) or isinstance(seed, bool) or seed < 0:
                raise DemonstrationError(f"seeds must be integers of at least 0, not {shown(seed)}")
            object.__setattr__(self, name, int(seed))
        if not isinstance(self.score, Real) or isinstance(self.score, bool) or not 0 <= self.score <= 1:
            raise DemonstrationError(f"the score must be a number in [0, 1], not {shown(self.score)}")
        object.__setattr__(self, "score", float(self.score))
        if not isinstance(self.scene, Scene):
            raise DemonstrationError(f"the scene must be a magical_mj.Scene, not {shown(self.scene)}")
        if not isinstance(self.package, str) or not isinstance(self.mujoco, str):
            raise DemonstrationError("the versions of package and mujoco must be texts")
        if self.demonstrator not in DEMONSTRATORS:
            raise DemonstrationError(f"demonstrator is {self.demonstrator!r}; it must be one of {DEMONSTRATORS}")
        kinds = [(self.actions, np.uint8, 1), (self.qpos, np.float64, 2), (self.qvel, np.float64, 2)]
        for array, kind, dimensions in kinds:
            if not isinstance(array, np.ndarray) or array.dtype != kind or array.ndim != dimensions:
                raise DemonstrationError(
                    "actions must be an array (steps,) of uint8, qpos and qvel (steps + 1, n) of float64"
                )
        steps = len(self.actions)
        if steps == 0 or not len(self.qpos) == len(self.qvel) == steps + 1:
            raise DemonstrationError(f"{steps} actions do not fit {len(self.qpos)} and {len(self.qvel)} states")
        if (self.actions >= len(ACTIONS)).any():
            raise DemonstrationError(f"actions must be below {len(ACTIONS)}")
        if not (np.isfinite(self.qpos).all() and np.isfinite(self.qvel).all()):
            raise DemonstrationError("states must be finite")
        sizes = self.qpos.shape[1], self.qvel.shape[1]
        needed = len(JOINTS) + 3 * len(self.scene.blocks)
        if sizes != (needed, needed):
            raise DemonstrationError(f"states of this scene have {needed} positions and velocities, not {sizes}")

    @property
    def name(self) -> str:
        """Such as ``"FindDupe-Demo"``: the name of the task, also if that is given by reference, and the variant."""
        return f"{task_spec(self.task).name}-{self.variant}"

    def scenes(self) -> list[Scene]:
        """The scene before the first action and after each."""
        world = World(self.scene)
        return [world.read(qpos) for qpos in self.qpos]

    def rescored(self) -> float:
        """The score computed from the last state."""
        return score(self.task, self.scene, World(self.scene).read(self.qpos[-1]))


def only_environment(demos: Sequence[Demonstration]) -> str:
    """The name of the environment of all these demonstrations, such as ``"FindDupe-Demo"``.

    Raises:
        DemonstrationError: if they are of several environments, or there are none.
    """
    names = sorted({demo.name for demo in demos})
    if len(names) != 1:
        found = f"these are of {', '.join(names)}" if names else "there are none"
        raise DemonstrationError(f"a data set holds demonstrations of one environment, and {found}")
    return names[0]


def check_seeds(demos: Sequence[Demonstration]) -> None:
    """For files that hold seeds as 64-bit integers; a scene's may have any size.

    Raises:
        DemonstrationError: if a scene's seed has more.
    """
    for demo in demos:
        if demo.scene_seed >= 2**63:
            raise DemonstrationError(
                f"the scene's seed {shown(demo.scene_seed)} does not fit the 64-bit integers of this format: choose "
                "demonstrations whose seeds are below 2**63"
            )


def demonstrators(demos: Sequence[Demonstration]) -> list[str]:
    """The kinds of demonstrators of these demonstrations, each once, sorted."""
    return sorted({demo.demonstrator for demo in demos})
