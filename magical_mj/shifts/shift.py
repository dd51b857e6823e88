"""What a shift is: a class with the methods that it needs, and the factors that it draws once an episode."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import ShiftError
from magical_mj.variants.rules import VariationRules

Picture = NDArray[np.uint8]
"""Shape (height, width, 3), top row first."""
Values = Mapping[str, float]
"""Factor -> its value in an episode; ``"seed"`` -> the seed of the episode, for what a shift draws besides."""

STRENGTHS: Final = 5
"""The greatest strength; the least, 0, is no shift."""
Distribution = Literal["signed", "positive", "exact", "choice"]
DISTRIBUTIONS: Final[tuple[Distribution, ...]] = get_args(Distribution)


@dataclass(frozen=True)
class Factor:
    """A number that a shift draws at the start of an episode. It is 0 without the shift.

    Attributes:
        name: its name among the values.
        about: what it is, with its unit.
        sizes: how large it is at the strengths 1 to 5.
        draw: "signed", uniform from -size to size; "positive", uniform from 0 to size; "exact", the size itself; or
            "choice", a whole number below the size, which is the same for all strengths.
    """

    name: str
    about: str
    sizes: tuple[float, ...]
    draw: Distribution = "signed"

    def __post_init__(self) -> None:
        """Raises `ShiftError` unless there is a size for each strength, and it can be drawn so."""
        if len(self.sizes) != STRENGTHS or self.draw not in DISTRIBUTIONS:
            raise ShiftError(
                f"the factor {self.name!r} needs {STRENGTHS} sizes, one for each strength, and for draw one of "
                f"{', '.join(DISTRIBUTIONS)}"
            )

    def value(self, direction: float, strength: int) -> float:
        """The value at a strength from 1 to 5, for a direction in [0, 1) that all strengths of a seed share."""
        size = self.sizes[strength - 1]
        if self.draw == "choice":
            return int(direction * size)
        value = size * {"signed": 2 * direction - 1, "positive": direction, "exact": 1}[self.draw]
        return int(value) if self.whole else float(value)

    @property
    def whole(self) -> bool:
        """Whether its values are whole numbers."""
        return self.draw == "choice" or (self.draw == "exact" and all(size % 1 == 0 for size in self.sizes))

    @property
    def bounds(self) -> tuple[float, float]:
        """The least and the greatest value at any strength, and without the shift."""
        most = max(self.sizes)
        return -most if self.draw == "signed" else 0, most - 1 if self.draw == "choice" else most


@dataclass(frozen=True)
class Frame:
    """What a shift is told about the picture that it changes.

    Attributes:
        view: "ego" or "allo".
        step: the number of actions since the start of the episode.
        camera: x, y (world units) and angle (rad) of the camera, and the side of the square that it sees (world units).
    """

    view: str
    step: int
    camera: tuple[float, float, float, float]


class Shift:
    """A shift for one episode: the base class of ours and of your own, which override the methods that they need.

    The methods must depend on nothing but their arguments, `values` and `rng`. So an episode can be saved, continued
    and repeated, and a picture that is drawn twice is the same.

    Attributes:
        name: what it is called in labels, unless it is used by its reference.
        summary: one line of description.
        factors: what it draws. A class without factors has the strength as its only one.
        values: the values of the factors in this episode, and its seed.
    """

    name: ClassVar[str]
    summary: ClassVar[str] = ""
    factors: ClassVar[tuple[Factor, ...]] = (Factor("strength", "the strength", (1, 2, 3, 4, 5), "exact"),)

    def __init__(self, values: Values) -> None:
        self.values = values
        self._uniform: dict[tuple[int, ...], list[float]] = {}

    @classmethod
    def supports(cls, task: str) -> str | None:
        """Why a task of the benchmark or of your own cannot have this shift; None if it can."""
        if task_spec(task).speeds and cls.action is not Shift.action:
            return "it changes which of the 18 actions is taken, and the task's actions are speeds"
        return None

    def rng(self, *key: int) -> np.random.Generator:
        """A random generator that depends on the seed of the episode and on the numbers in `key`, such as a step."""
        return _generator(type(self), int(self.values["seed"]), 1, *key)

    def uniform(self, step: int, *key: int) -> float:
        """A random number in [0, 1) for a step, as often as it is asked for; another one for each `key`."""
        part = *key, step // BATCH
        if part not in self._uniform:
            self._uniform = {key: numbers for key, numbers in self._uniform.items() if key[-1] == part[-1]}
            self._uniform[part] = _generator(type(self), int(self.values["seed"]), 2, *part).random(BATCH).tolist()
        return self._uniform[part][step % BATCH]

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The scene in which the episode starts, instead of `scene`; `rules` are those of the task."""
        del rules
        return scene

    def model(self, model: Any) -> None:
        """Changes numbers of the episode's `mujoco.MjModel`, such as ``model.opt.gravity``: the next one is fresh.

        Names of bodies, geoms and cameras are those of docs/exported-model.md.
        """

    def action(self, commands: Sequence[int], step: int) -> int:
        """The action that is taken, 0 to 17.

        Args:
            commands: those that were commanded so far, the present one last; at most the last `HISTORY`.
            step: the number of steps before this one.
        """
        del step
        return commands[-1]

    def delay(self, step: int) -> int:
        """How many steps before `step` the command was given that takes effect in it. The scripted expert asks."""
        del step
        return 0

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """The picture that is seen instead of `picture`, which may be changed. Shape (size, size, 3), uint8."""
        del frame
        return picture

    def ground(self, ground: Picture) -> Picture:
        """A picture of the ground instead of `ground`, which must stay as it is: the square around the origin.

        Its half side is `GROUND_REACH` (world units), and its top row is the one of greatest y. Shape (n, n, 3), uint8.
        """
        return ground

    def instruction(self, instruction: str, task: str) -> str:
        """The sentence that says what is to be done, instead of `instruction`."""
        del task
        return instruction


GROUND_REACH: Final = 3.2
"""World units from the middle to the sides of what `Shift.ground` changes."""
GROUND_CELLS: Final = 256
"""Pixels per side of it; walls are at the edges of some."""

HISTORY: Final = 16
"""The number of commands that `Shift.action` is given."""


BATCH: Final = 256
"""The number of steps for which numbers are drawn together, which takes as long as for one."""


def draw(kind: type[Shift], seed: int, strength: int) -> dict[str, float]:
    """The values of a shift in the episode of a seed. All strengths of it have the same directions."""
    rng = _generator(kind, seed, 0)
    return {**{factor.name: factor.value(rng.random(), strength) for factor in kind.factors}, "seed": seed}


def _generator(kind: type[Shift], seed: int, *key: int) -> np.random.Generator:
    """The bit generator is named explicitly, since later versions of numpy may change that of `default_rng`."""
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(kind.name.encode()), *key))
    return np.random.Generator(np.random.PCG64(sequence))
