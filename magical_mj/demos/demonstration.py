"""The type of a demonstration: a complete episode as numbers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from magical_mj._version import __version__
from magical_mj.assets.robot import JOINTS
from magical_mj.assets.world import World
from magical_mj.scene import Scene
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import environment_axes, score, task_spec
from magical_mj.utils.errors import DemonstrationError, short_repr

Demonstrator = Literal["expert", "human"]
DEMONSTRATORS: Final[tuple[Demonstrator, ...]] = get_args(Demonstrator)


@dataclass(frozen=True, eq=False)
class Demonstration:
    """An episode: its initial scene, the actions, and the states before the first action and after each action."""

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


def check(demo: Demonstration) -> None:
    """Checks what somebody may have altered: the parts of a demonstration from or for a file.

    Raises:
        DemonstrationError: if they are of wrong types, out of range, or do not fit each other.
        UnknownNameError: if there is no such environment.
    """
    environment_axes(demo.task, demo.variant)
    for fits, problem in _claims(demo):
        if not fits:
            raise DemonstrationError(problem)


def _claims(demo: Demonstration) -> Iterator[tuple[bool, str]]:
    """What must be true, and what is said if it is not. Each may rely on those before it."""
    for seed in (demo.scene_seed, demo.seed):
        is_seed = isinstance(seed, int) and not isinstance(seed, bool) and seed >= 0
        yield is_seed, f"seeds must be integers of at least 0, not {short_repr(seed)}"
    is_score = isinstance(demo.score, int | float) and not isinstance(demo.score, bool) and 0 <= demo.score <= 1
    yield is_score, f"the score must be a number in [0, 1], not {short_repr(demo.score)}"
    are_texts = isinstance(demo.package, str) and isinstance(demo.mujoco, str)
    yield are_texts, "the versions of package and mujoco must be texts"
    yield demo.demonstrator in DEMONSTRATORS, f"demonstrator must be one of {DEMONSTRATORS}"
    for array, kind, dimensions in (
        (demo.actions, np.uint8, 1),
        (demo.qpos, np.float64, 2),
        (demo.qvel, np.float64, 2),
    ):
        yield (
            (array.dtype, array.ndim) == (kind, dimensions),
            "actions must be an array (steps,) of uint8, qpos and qvel (steps + 1, n) of float64",
        )
    steps, states = len(demo.actions), (len(demo.qpos), len(demo.qvel))
    yield 0 < steps == states[0] - 1 == states[1] - 1, f"{steps} actions do not fit {states[0]} and {states[1]} states"
    yield bool((demo.actions < len(ACTIONS)).all()), f"actions must be below {len(ACTIONS)}"
    yield bool(np.isfinite(demo.qpos).all() and np.isfinite(demo.qvel).all()), "states must be finite"
    sizes, needed = (demo.qpos.shape[1], demo.qvel.shape[1]), len(JOINTS) + 3 * len(demo.scene.blocks)
    yield sizes == (needed, needed), f"states of this scene have {needed} positions and velocities, not {sizes}"


def only_environment(demos: Sequence[Demonstration]) -> str:
    """The name of the environment of all these demonstrations, such as ``"FindDupe-Demo"``.

    Raises:
        DemonstrationError: if they are of several environments, or there are none.
    """
    names = sorted({demo.name for demo in demos})
    if len(names) != 1:
        these = f"these are of {', '.join(names)}" if names else "there are none"
        raise DemonstrationError(f"a data set holds demonstrations of one environment, and {these}")
    return names[0]


def check_seeds(demos: Sequence[Demonstration]) -> None:
    """For files that hold seeds as 64-bit integers; a scene's may have any size.

    Raises:
        DemonstrationError: if a scene's seed has more.
    """
    for demo in demos:
        if demo.scene_seed >= 2**63:
            raise DemonstrationError(
                f"the scene's seed {short_repr(demo.scene_seed)} does not fit the 64-bit integers of this format: "
                "choose demonstrations whose seeds are below 2**63"
            )


def demonstrators(demos: Sequence[Demonstration]) -> list[str]:
    """The kinds of demonstrators of these demonstrations, each once, sorted."""
    return sorted({demo.demonstrator for demo in demos})
