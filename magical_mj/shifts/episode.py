"""The shifts of one episode: what was drawn, and what has been commanded so far."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from magical_mj.scene import Scene
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.registry import shift_class
from magical_mj.shifts.shift import HISTORY, Frame, Picture, Shift, Values, draw
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import MagicalError, ShiftError, as_integer, short_repr
from magical_mj.utils.imports import with_place

Draws = Mapping[str, Values]
"""Shift -> the values that were drawn for it."""


def draw_shifts(shifts: Mapping[str, int], seed: int) -> dict[str, dict[str, float]]:
    """What the episode of a seed draws for shifts of these strengths."""
    return {name: draw(shift_class(name), seed, strength) for name, strength in shifts.items()}


class EpisodeShifts:
    """The shifts of one episode, applied in order.

    Args:
        draws: what was drawn.

    Attributes:
        draws: likewise.
        steps: the number of actions so far.
        commands: the last commands that each shift which changes actions was given.
        changes_model: whether one of them changes the model.
    """

    def __init__(self, draws: Draws) -> None:
        self.draws = {name: dict(values) for name, values in draws.items()}
        self._shifts = {name: shift_class(name)(values) for name, values in self.draws.items()}
        self._acting, self._drawing = self._with("action"), self._with("picture")
        self.changes_model = bool(self._with("model"))
        self.steps = 0
        self.commands: dict[str, list[int]] = {name: [] for name in self._acting}

    def _with(self, method: str) -> dict[str, Shift]:
        """Those that have a method of their own."""
        own = getattr(Shift, method)
        return {name: shift for name, shift in self._shifts.items() if getattr(type(shift), method) is not own}

    @property
    def changes_pictures(self) -> bool:
        """Whether one of them changes pictures after they were drawn."""
        return bool(self._drawing)

    def scene(self, scene: Scene, task: str) -> Scene:
        """The scene in which the episode starts.

        Raises:
            ShiftError: if a shift of one's own returns anything but a legal scene of the task.
        """
        for name, shift in self._with("scene").items():
            with _errors_of(name, "scene"):
                scene = shift.scene(scene, task_spec(task))
                if not isinstance(scene, Scene):
                    raise ShiftError(f"{name}.scene must return a magical_mj.Scene, not {short_repr(scene)}")
                check_scene(scene)
                task_spec(task).check(scene)
        return scene

    def model(self, model: Any) -> None:
        """Changes a fresh model."""
        for name, shift in self._with("model").items():
            with _errors_of(name, "model"):
                shift.model(model)

    def action(self, action: int) -> int:
        """The action that is taken when `action` is commanded."""
        for name, shift in self._acting.items():
            commands = self.commands[name]
            commands.append(action)
            del commands[:-HISTORY]
            with _errors_of(name, "action"):
                taken = as_integer(shift.action(tuple(commands), self.steps), 0, len(ACTIONS) - 1)
            if taken is None:
                raise ShiftError(f"{name}.action must return an action, 0 to {len(ACTIONS) - 1}")
            action = taken
        self.steps += 1
        return action

    def picture(self, picture: Picture, frame: Frame) -> Picture:
        """The picture that is seen. Shape (size, size, 3)."""
        shape = picture.shape
        for name, shift in self._drawing.items():
            with _errors_of(name, "picture"):
                picture = shift.picture(picture, frame)
            if not isinstance(picture, np.ndarray) or picture.shape != shape or picture.dtype != np.uint8:
                got = getattr(picture, "shape", short_repr(picture)), getattr(picture, "dtype", "")
                raise ShiftError(f"{name}.picture must return an array of shape {shape}, uint8, not {got}")
        return picture

    def instruction(self, instruction: str, task: str) -> str:
        """The sentence that is read."""
        for name, shift in self._with("instruction").items():
            with _errors_of(name, "instruction"):
                instruction = shift.instruction(instruction, task)
            if not isinstance(instruction, str):
                raise ShiftError(f"{name}.instruction must return text, not {short_repr(instruction)}")
        return instruction

    def resume(self, steps: int, commands: Mapping[str, tuple[int, ...]]) -> None:
        """Goes back to a step, with the commands before it."""
        self.steps = steps
        self.commands = {name: list(commands.get(name, ())) for name in self._acting}


@contextmanager
def _errors_of(name: str, method: str) -> Iterator[None]:
    """Makes any error of a shift's code a `ShiftError` that names it; this package's own pass through."""
    try:
        yield
    except MagicalError:
        raise
    except Exception as error:
        raise ShiftError(f"{name}.{method} failed: {with_place(error)}") from error
