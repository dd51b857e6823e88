"""The base class of shifts, and the factors that a shift draws once per episode."""

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
"""Factor -> its value in an episode. ``"seed"`` -> the seed of the episode, for other random numbers of the shift."""

STRENGTHS: Final = 5
"""The greatest strength. Strength 0 is the environment without the shift."""
Distribution = Literal["signed", "positive", "exact", "choice"]
DISTRIBUTIONS: Final[tuple[Distribution, ...]] = get_args(Distribution)


@dataclass(frozen=True)
class Factor:
    """A number that a shift draws at the start of an episode. It is 0 without the shift.

    Attributes:
        name: the key of its value in `Shift.values`.
        about: a description with the unit.
        sizes: its size at each strength from 1 to 5.
        draw: "signed": U(-size, size). "positive": U(0, size). "exact": the size itself. "choice": a random integer
            from 0 to size - 1; then all strengths must have the same size.
    """

    name: str
    about: str
    sizes: tuple[float, ...]
    draw: Distribution = "signed"

    def __post_init__(self) -> None:
        """Raises a `ShiftError` unless there is a size for each strength, and `draw` is valid."""
        if len(self.sizes) != STRENGTHS or self.draw not in DISTRIBUTIONS:
            raise ShiftError(
                f"the factor {self.name!r} needs {STRENGTHS} sizes, one for each strength, and draw must be one of "
                f"{', '.join(DISTRIBUTIONS)}"
            )

    def value(self, direction: float, strength: int) -> float:
        """The value at a strength from 1 to 5. `direction` in [0, 1) is the same for all strengths of a seed."""
        size = self.sizes[strength - 1]
        if self.draw == "choice":
            return int(direction * size)
        value = size * {"signed": 2 * direction - 1, "positive": direction, "exact": 1}[self.draw]
        return int(value) if self.whole else float(value)

    @property
    def whole(self) -> bool:
        """Whether its values are integers."""
        return self.draw == "choice" or (self.draw == "exact" and all(size % 1 == 0 for size in self.sizes))

    @property
    def bounds(self) -> tuple[float, float]:
        """The lowest and the highest value at any strength, including 0."""
        most = max(self.sizes)
        return -most if self.draw == "signed" else 0, most - 1 if self.draw == "choice" else most


@dataclass(frozen=True)
class Frame:
    """The view, step and camera of a picture that a shift changes.

    Attributes:
        view: "ego" or "allo".
        step: the number of actions since the start of the episode.
        camera: x, y (world units) and angle (rad) of the camera, and the side of its square view (world units).
    """

    view: str
    step: int
    camera: tuple[float, float, float, float]


class Shift:
    """The base class of all shifts. An instance belongs to one episode. Override the methods that your shift needs.

    The methods must depend only on their arguments, `values`, `rng` and `uniform`. Then episodes can be saved,
    continued and repeated, and rendering twice gives the same picture.

    Attributes:
        name: its name in labels, unless it is used by its reference.
        summary: a description of one line.
        factors: the numbers that it draws. The default is one factor, the strength.
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
        """None if the shift can be applied to this task, otherwise the reason, for an error message."""
        if task_spec(task).speeds and overrides(cls, "action"):
            return "it replaces discrete actions, and the task's actions are speeds"
        return None

    def rng(self, *key: int) -> np.random.Generator:
        """A random generator, determined by the seed of the episode and the integers in `key`, such as a step."""
        return _generator(type(self), int(self.values["seed"]), 1, *key)

    def uniform(self, step: int, *key: int) -> float:
        """A random number in [0, 1), determined by the seed of the episode, the step and `key`."""
        part = *key, step // BATCH
        if part not in self._uniform:
            self._uniform = {key: numbers for key, numbers in self._uniform.items() if key[-1] == part[-1]}
            self._uniform[part] = _generator(type(self), int(self.values["seed"]), 2, *part).random(BATCH).tolist()
        return self._uniform[part][step % BATCH]

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """Returns the initial scene to use instead of `scene`. `rules` are the task's rules of variation."""
        del rules
        return scene

    def model(self, model: Any) -> None:
        """Changes numbers of the episode's `mujoco.MjModel` in place, such as ``model.opt.gravity``.

        The next episode gets a new model. docs/exported-model.md lists the names of bodies, geoms and cameras.
        """

    def action(self, commands: Sequence[int], step: int) -> int:
        """Returns the action to execute, 0 to 17.

        Args:
            commands: the last commanded actions, at most `HISTORY`. The current one is the last.
            step: the number of steps before this one.
        """
        del step
        return commands[-1]

    def delay(self, step: int) -> int:
        """The delay (steps) of the action that takes effect at `step`. The scripted expert uses it."""
        del step
        return 0

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """Returns the picture to use instead of `picture`, which it may modify. Shape (size, size, 3), uint8."""
        del frame
        return picture

    def ground(self, ground: Picture) -> Picture:
        """Returns a picture of the ground to use instead of `ground`, which it must not modify.

        Shape (n, n, 3), uint8. The picture shows the square around the origin with half side `GROUND_REACH` (world
        units). The top row has the largest y.
        """
        return ground

    def instruction(self, instruction: str, task: str) -> str:
        """Returns the sentence that describes the task, to use instead of `instruction`."""
        del task
        return instruction


GROUND_REACH: Final = 3.2
"""Half the side of the picture for `Shift.ground` (world units)."""
GROUND_CELLS: Final = 256
"""The number of pixels per side of that picture. The arena's walls coincide with edges of pixels."""

HISTORY: Final = 16
"""The maximum number of commands that `Shift.action` receives."""


BATCH: Final = 256
"""The number of steps that `Shift.uniform` draws at once, since creating a generator takes most of the time."""


def overrides(kind: type[Shift], *methods: str) -> bool:
    """Whether a class of shifts overrides any of these methods."""
    return any(getattr(kind, method) is not getattr(Shift, method) for method in methods)


def draw(kind: type[Shift], seed: int, strength: int) -> dict[str, float]:
    """The values of a shift in the episode of a seed. For all strengths, signs and relative sizes are the same."""
    rng = _generator(kind, seed, 0)
    return {**{factor.name: factor.value(rng.random(), strength) for factor in kind.factors}, "seed": seed}


def _generator(kind: type[Shift], seed: int, *key: int) -> np.random.Generator:
    """A generator with an explicit algorithm, since later versions of numpy may change that of `default_rng`."""
    sequence = np.random.SeedSequence(seed, spawn_key=(zlib.crc32(kind.name.encode()), *key))
    return np.random.Generator(np.random.PCG64(sequence))
