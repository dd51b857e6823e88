"""The shifts of one episode: their drawn values, and the actions commanded so far."""

from __future__ import annotations

from collections.abc import Mapping
from copy import copy
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS
from magical_mj.scene import Scene
from magical_mj.scene.geometry import check_scene
from magical_mj.shifts.registry import METHODS, SHIFTS, shift_class
from magical_mj.shifts.shift import GROUND_CELLS, GROUND_REACH, HISTORY, Frame, Picture, Shift, Values, draw, overrides
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import ShiftError, as_integer, short_repr
from magical_mj.utils.frozen import FrozenDict
from magical_mj.utils.imports import errors_of_user

SURROUNDINGS: Final = (231, 231, 234)
"""The colour around the arena, the same as in `assets.style`."""

Draws = Mapping[str, Values]
"""Shift -> its drawn values."""


def draw_shifts(shifts: Mapping[str, int], seed: int) -> dict[str, dict[str, float]]:
    """Draws the values of shifts with these strengths, for the episode of a seed."""
    return {name: draw(shift_class(name), seed, strength) for name, strength in shifts.items()}


class EpisodeShifts:
    """The shifts of one episode, applied in order. There may be none.

    Attributes:
        draws: their drawn values.
        steps: the number of actions so far.
        commands: for each shift that changes actions, the last actions that were passed to it.
        changes_model: whether a shift changes the model.
        filters: whether a shift changes rendered pictures.
        changes_ground: whether a shift changes the appearance of the ground.
        changes_pictures: `filters` or `changes_ground`.
        changes_instruction: whether a shift changes the instruction.
    """

    def __init__(self, draws: Draws = MappingProxyType({})) -> None:
        frozen, self._shifts = dict[str, Values](), dict[str, Shift]()
        for name, values in draws.items():
            frozen[name] = FrozenDict(values)
            self._shifts[name] = shift_class(name)(frozen[name])
        self.draws: Draws = FrozenDict(frozen)
        self._with = _overriding(tuple(self._shifts), tuple(map(type, self._shifts.values())))
        self._ground: tuple[float, Picture] | None = None
        self.changes_ground = bool(self._with["ground"])
        self.filters = bool(self._with["picture"])
        self.changes_pictures = self.changes_ground or self.filters
        self.changes_instruction = bool(self._with["instruction"])
        self.changes_model = self.changes_ground or bool(self._with["model"])
        self.steps = 0
        self.commands: dict[str, list[int]] = {name: [] for name in self._with["action"]}

    def _call(self, name: str, method: str, *arguments: Any) -> Any:
        """Calls a method of a shift. This package's errors pass through, all others become a `ShiftError`."""
        with errors_of_user(f"{name}.{method} failed", ShiftError):
            return getattr(self._shifts[name], method)(*arguments)

    def scene(self, scene: Scene, task: str) -> Scene:
        """The shifted initial scene.

        Raises:
            ShiftError, InvalidSceneError, TaskError: if a user's shift does not return a legal scene of the task.
        """
        for name in self._with["scene"]:
            scene = self._call(name, "scene", scene, task_spec(task))
            if name in SHIFTS:
                continue
            if not isinstance(scene, Scene):
                raise ShiftError(f"{name}.scene must return a magical_mj.Scene, not {short_repr(scene)}")
            check_scene(scene)
            with errors_of_user(f"{task}.check failed"):
                task_spec(task).check(scene)
        return scene

    def model(self, model: Any) -> None:
        """Changes a new model. If a shift changes the ground, the surroundings are drawn white and replaced later."""
        if self.changes_ground:
            model.geom_rgba[model.geom("surround").id, 3] = 0
        for name in self._with["model"]:
            self._call(name, "model", model)

    @property
    def delay(self) -> int:
        """The delay (steps) of the action that takes effect in the next step, according to the first shift."""
        if not self._with["action"]:
            return 0
        first = next(iter(self._with["action"]))
        delay = as_integer(self._call(first, "delay", self.steps), 0, HISTORY - 1)
        if delay is None:
            raise ShiftError(f"{first}.delay must return a number of steps, 0 to {HISTORY - 1}")
        return delay

    def revise(self, ago: int, action: int) -> None:
        """Replaces the command that was given `ago` steps before the next one. For planners: they choose it later."""
        next(iter(self.commands.values()))[-ago] = action

    def action(self, action: int) -> int:
        """The action that is executed if `action` is commanded."""
        for name in self._with["action"]:
            commands = self.commands[name]
            commands.append(action)
            del commands[:-HISTORY]
            taken = as_integer(self._call(name, "action", tuple(commands), self.steps), 0, len(ACTIONS) - 1)
            if taken is None:
                raise ShiftError(f"{name}.action must return an action, 0 to {len(ACTIONS) - 1}")
            action = taken
        self.steps += 1
        return action

    def picture(
        self, picture: Picture, frame: Frame, uncovered: NDArray[np.uint8] | None, half_width: float
    ) -> Picture:
        """The shifted picture.

        Args:
            picture: the rendered picture, shape (size, size, 3).
            frame: its view, step and camera.
            uncovered: the number of each pixel's four samples that show the ground, shape (size, size). None if no
                shift changes the ground.
            half_width: half the width of the arena (world units).
        """
        if uncovered is not None:
            from magical_mj.shifts.kernels import put_on_ground

            put_on_ground(picture, uncovered, self.ground(half_width), GROUND_REACH, frame.camera)
        for name in self._with["picture"]:
            picture = _checked(f"{name}.picture", self._call(name, "picture", picture, frame), picture.shape)
        return picture

    def ground(self, half_width: float) -> Picture:
        """The shifted picture of the ground in and around an arena of this half width."""
        if self._ground is None or self._ground[0] != half_width:
            ground = _plain_ground(half_width).copy()
            for name in self._with["ground"]:
                ground = _checked(f"{name}.ground", self._call(name, "ground", ground), ground.shape)
            self._ground = half_width, ground
        return self._ground[1]

    def named(self, name: str) -> Shift | None:
        """The shift with this name; None if it is not among these."""
        return self._shifts.get(name)

    def instruction(self, instruction: str, task: str) -> str:
        """The shifted instruction."""
        for name in self._with["instruction"]:
            instruction = self._call(name, "instruction", instruction, task)
            if not isinstance(instruction, str):
                raise ShiftError(f"{name}.instruction must return text, not {short_repr(instruction)}")
        return instruction

    def copy(self) -> EpisodeShifts:
        """A copy at the same step."""
        twin = copy(self)
        twin.commands = {name: list(commands) for name, commands in self.commands.items()}
        return twin

    def resume(self, steps: int, commands: Mapping[str, tuple[int, ...]]) -> None:
        """Restores the number of steps and the commands so far."""
        self.steps = steps
        self.commands = {name: list(commands.get(name, ())) for name in self._with["action"]}


@lru_cache(64)
def _overriding(names: tuple[str, ...], kinds: tuple[type[Shift], ...]) -> Mapping[str, list[str]]:
    """Method of shifts -> the names of those that override it."""
    shifts = list(zip(names, kinds, strict=True))
    return {method: [name for name, kind in shifts if overrides(kind, method)] for method in METHODS}


@lru_cache(4)
def _plain_ground(half_width: float) -> Picture:
    """The unshifted picture of the ground. Cached: copy it before changing it."""
    ground = np.full((GROUND_CELLS, GROUND_CELLS, 3), SURROUNDINGS, np.uint8)
    wall = round(GROUND_CELLS * half_width / (2 * GROUND_REACH))
    inside = slice(GROUND_CELLS // 2 - wall, GROUND_CELLS // 2 + wall)
    ground[inside, inside] = 255
    return ground


def _checked(what: str, picture: Any, shape: tuple[int, ...]) -> Picture:
    """A picture returned by a shift, as a contiguous array. Raises a `ShiftError` unless it is uint8 of this shape."""
    if not isinstance(picture, np.ndarray) or picture.shape != shape or picture.dtype != np.uint8:
        got = f"of shape {picture.shape}, {picture.dtype}" if isinstance(picture, np.ndarray) else short_repr(picture)
        raise ShiftError(f"{what} must return an array of shape {shape}, uint8, not {got}")
    return np.ascontiguousarray(picture)
