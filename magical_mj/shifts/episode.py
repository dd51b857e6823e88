"""The shifts of one episode: what was drawn, and what has been commanded so far."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.scene import Scene
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.registry import SHIFTS, shift_class
from magical_mj.shifts.shift import GROUND_CELLS, GROUND_REACH, HISTORY, Frame, Picture, Shift, Values, draw
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import MagicalError, ShiftError, as_integer, short_repr
from magical_mj.utils.imports import errors_of_task, with_place

SURROUNDINGS: Final = (231, 231, 234)
"""The colour around the arena, as in `assets.style`."""

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
        filters: whether one of them changes pictures after they were drawn, ground and all.
        changes_ground: whether one of them changes the look of the ground.
        changes_pictures: either of these.
        changes_instruction: whether one of them changes the sentence that says what is to be done.
    """

    def __init__(self, draws: Draws) -> None:
        self.draws = {name: dict(values) for name, values in draws.items()}
        self._shifts = {name: shift_class(name)(values) for name, values in self.draws.items()}
        self._acting, self._drawing, self._laying = map(self._with, ("action", "picture", "ground"))
        self._ground: tuple[float, Picture] | None = None
        self.changes_ground = bool(self._laying)
        self.filters = bool(self._drawing)
        self.changes_pictures = self.changes_ground or self.filters
        self.changes_instruction = bool(self._with("instruction"))
        self.changes_model = self.changes_ground or bool(self._with("model"))
        self.steps = 0
        self.commands: dict[str, list[int]] = {name: [] for name in self._acting}

    def _with(self, method: str) -> list[str]:
        """The names of those that have a method of their own."""
        base = getattr(Shift, method)
        return [name for name, shift in self._shifts.items() if getattr(type(shift), method) is not base]

    def _call(self, name: str, method: str, *arguments: Any) -> Any:
        """What a method of a shift returns; any error of its code is a `ShiftError` that names it.

        This package's own errors pass through.
        """
        try:
            return getattr(self._shifts[name], method)(*arguments)
        except MagicalError:
            raise
        except Exception as error:
            raise ShiftError(f"{name}.{method} failed: {with_place(error)}") from error

    def scene(self, scene: Scene, task: str) -> Scene:
        """The scene in which the episode starts.

        Raises:
            ShiftError: if a shift of one's own returns anything but a legal scene of the task.
        """
        for name in self._with("scene"):
            scene = self._call(name, "scene", scene, task_spec(task))
            if name in SHIFTS:
                continue
            if not isinstance(scene, Scene):
                raise ShiftError(f"{name}.scene must return a magical_mj.Scene, not {short_repr(scene)}")
            check_scene(scene)
            with errors_of_task(f"{task}.check failed"):
                task_spec(task).check(scene)
        return scene

    def model(self, model: Any) -> None:
        """Changes a fresh model. Where the ground has another look, it is drawn as white, whatever is around it."""
        if self.changes_ground:
            model.geom_rgba[model.geom("surround").id, 3] = 0
        for name in self._with("model"):
            self._call(name, "model", model)

    @property
    def delay(self) -> int:
        """How many steps before the next one the command is given that takes effect in it, by the first of them."""
        if not self._acting:
            return 0
        first = next(iter(self._acting))
        delay = as_integer(self._call(first, "delay", self.steps), 0, HISTORY - 1)
        if delay is None:
            raise ShiftError(f"{first}.delay must return a number of steps, 0 to {HISTORY - 1}")
        return delay

    def revise(self, ago: int, action: int) -> None:
        """Makes `action` what was commanded so many steps before the next one: plans choose it when they need it."""
        next(iter(self.commands.values()))[-ago] = action

    def action(self, action: int) -> int:
        """The action that is taken when `action` is commanded."""
        for name in self._acting:
            commands = self.commands[name]
            commands.append(action)
            del commands[:-HISTORY]
            taken = as_integer(self._call(name, "action", tuple(commands), self.steps), 0, len(ACTIONS) - 1)
            if taken is None:
                raise ShiftError(f"{name}.action must return an action, 0 to {len(ACTIONS) - 1}")
            action = taken
        self.steps += 1
        return action

    def picture(self, picture: Picture, frame: Frame, bare: NDArray[np.uint8] | None, half_width: float) -> Picture:
        """The picture that is seen.

        Args:
            picture: as it was drawn. Shape (size, size, 3).
            frame: what picture it is.
            bare: how many of the four samples of a pixel show the ground, if it has another look. Shape (size, size).
            half_width: of the arena.
        """
        if bare is not None:
            from magical_mj.shifts.kernels import put_on_ground

            put_on_ground(picture, bare, self._ground_in(half_width), GROUND_REACH, frame.camera)
        for name in self._drawing:
            picture = _checked(f"{name}.picture", self._call(name, "picture", picture, frame), picture.shape)
        return picture

    def _ground_in(self, half_width: float) -> Picture:
        """The look of the ground in an arena of this half width, and around it."""
        if self._ground is None or self._ground[0] != half_width:
            ground = _plain_ground(half_width).copy()
            for name in self._laying:
                ground = _checked(f"{name}.ground", self._call(name, "ground", ground), ground.shape)
            self._ground = half_width, ground
        return self._ground[1]

    def instruction(self, instruction: str, task: str) -> str:
        """The sentence that is read."""
        for name in self._with("instruction"):
            instruction = self._call(name, "instruction", instruction, task)
            if not isinstance(instruction, str):
                raise ShiftError(f"{name}.instruction must return text, not {short_repr(instruction)}")
        return instruction

    def copy(self) -> EpisodeShifts:
        """Another one of the same episode, at the same step."""
        twin = copy(self)
        twin.commands = {name: list(commands) for name, commands in self.commands.items()}
        return twin

    def resume(self, steps: int, commands: Mapping[str, tuple[int, ...]]) -> None:
        """Goes back to a step, with the commands before it."""
        self.steps = steps
        self.commands = {name: list(commands.get(name, ())) for name in self._acting}


@lru_cache(4)
def _plain_ground(half_width: float) -> Picture:
    """The ground without another look; to be copied before it is changed."""
    ground = np.full((GROUND_CELLS, GROUND_CELLS, 3), SURROUNDINGS, np.uint8)
    wall = round(GROUND_CELLS * half_width / (2 * GROUND_REACH))
    inside = slice(GROUND_CELLS // 2 - wall, GROUND_CELLS // 2 + wall)
    ground[inside, inside] = 255
    return ground


def _checked(what: str, picture: Any, shape: tuple[int, ...]) -> Picture:
    """A picture that a shift has returned, without gaps in memory.

    Raises:
        ShiftError: if it is none of this shape.
    """
    if not isinstance(picture, np.ndarray) or picture.shape != shape or picture.dtype != np.uint8:
        got = f"of shape {picture.shape}, {picture.dtype}" if isinstance(picture, np.ndarray) else short_repr(picture)
        raise ShiftError(f"{what} must return an array of shape {shape}, uint8, not {got}")
    return np.ascontiguousarray(picture)
