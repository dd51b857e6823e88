"""Shifts of the scene and its dynamics: where things start, pebbles, friction, and a worn robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.scene import Pebble, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS, NOOP
from magical_mj.scene.geometry import inside_walls, pebble_solid, solids, touch
from magical_mj.shifts.shift import GROUND_REACH, Factor, Picture, Shift
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import PlacementError
from magical_mj.variants.placement import along, layout
from magical_mj.variants.rules import VariationRules, axis_generator, supported_axes

TRACK: Final = 2 * c.ROBOT_RADIUS
"""The distance of the wheels of which one is larger, in world units."""
MAX_TRIES: Final = 10_000


class Pose(Shift):
    """Everything starts somewhere on the way from its pose to that in the Layout scene of the same seed.

    Regions change their sizes likewise. Where things would touch they are moved aside, as little as some tries find.
    """

    name = "pose"
    summary = "start poses on the way to those of Layout"
    factors = (Factor("way", "part of the way to the poses of Layout", (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1), "exact"),)

    @classmethod
    def supports(cls, task: str) -> str | None:
        """Tasks whose layout can vary, but not by a rule of their own: what is on the way may not follow that rule."""
        if callable((spec := task_spec(task)).layout):
            return "its layouts follow a rule of its own"
        return None if "layout" in supported_axes(spec) else "it has no variant Layout"

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The scene between."""
        way = self.values["way"]
        if way == 0:
            return scene
        rng = axis_generator(rules.name, "layout", int(self.values["seed"]))
        other = layout(scene, rng, rules.region_size, rules.inner_margin)
        return along(scene, other, way, self.rng(0))


class Clutter(Shift):
    """Small grey pebbles lie about, loose, and stains are on the floor. Scores do not count them."""

    name = "clutter"
    summary = "loose pebbles and stains, which belong to no task"
    factors = (
        Factor("pebbles", "number of pebbles", (1, 2, 3, 5, 8), "exact"),
        Factor("stains", "number of stains on the floor", (1, 2, 3, 5, 8), "exact"),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The scene with pebbles, of which lower strengths have the first ones; they may lie in regions."""
        del rules
        rng, pebbles = self.rng(0), list(scene.pebbles)
        taken = [*solids(scene).values(), *map(pebble_solid, pebbles)]
        for _ in range(int(self.values["pebbles"])):
            for _ in range(MAX_TRIES):
                x, y = ((2 * rng.random(2) - 1) * scene.half_width).tolist()
                solid = pebble_solid(pebble := Pebble(x, y))
                if inside_walls(solid, half_width=scene.half_width) and not any(touch(solid, other) for other in taken):
                    break
            else:
                raise PlacementError("found no room for a pebble; use fewer blocks, or less clutter")
            pebbles.append(pebble)
            taken.append(solid)
        return replace(scene, pebbles=tuple(pebbles))

    def ground(self, ground: Picture) -> Picture:
        """With the stains."""
        stained = ground.copy()
        per_unit = len(ground) / (2 * GROUND_REACH)
        for x, y, size, darkness in self.stains():
            radius = size * per_unit
            column, row = (GROUND_REACH + x) * per_unit, (GROUND_REACH - y) * per_unit
            left, top = int(column - radius), int(row - radius)
            part = stained[top : int(row + radius) + 2, left : int(column + radius) + 2]
            down, across = np.ogrid[: part.shape[0], : part.shape[1]]
            gaps = np.hypot(down + 0.5 + top - row, across + 0.5 + left - column) / radius
            cover = darkness * np.clip(4 * (1 - gaps), 0, 1)[..., None]
            part[:] = part * (1 - cover * np.array([0.5, 0.7, 1.0]))  # brownish
        return stained

    def stains(self) -> Iterator[tuple[float, float, float, float]]:
        """Round spots, of which lower strengths have the first ones: x, y, radius (world units), darkness in [0, 1]."""
        rng = self.rng(1)
        for _ in range(int(self.values["stains"])):
            x, y, size, shade = rng.random(4).tolist()
            yield 2 * x - 1, 2 * y - 1, 0.06 + 0.12 * size, 0.25 + 0.35 * shade


class Friction(Shift):
    """Blocks resist more or less than in any demonstration, beyond the range of Dynamics."""

    name = "friction"
    summary = "friction of blocks with the ground, beyond the range of Dynamics"
    factors = (
        Factor("force", "friction force of blocks, in doublings", (0.15, 0.3, 0.45, 0.6, 0.75)),
        Factor("torque", "friction torque of blocks, in doublings", (0.2, 0.4, 0.7, 1, 1.5)),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The scene with other friction."""
        del rules
        dynamics = scene.dynamics
        force = dynamics.block_friction_force * 2 ** self.values["force"]
        torque = dynamics.block_friction_torque * 2 ** self.values["torque"]
        return replace(scene, dynamics=replace(dynamics, block_friction_force=force, block_friction_torque=torque))


class Slip(Shift):
    """A worn robot: one wheel is larger, motors are weaker, and some actions are replaced.

    Half of the replaced actions are the one before, the others are any of the 18.
    """

    name = "slip"
    summary = "replaced actions, unequal wheels, weak motors"
    factors = (
        Factor("replaced", "probability that an action is replaced", (0.02, 0.05, 0.1, 0.2, 0.3), "exact"),
        Factor("wheels", "difference of the wheels, relative", (0.03, 0.06, 0.12, 0.2, 0.3)),
        Factor(
            "motors", "lost part of the force of drive, turning and fingers", (0.03, 0.06, 0.12, 0.2, 0.3), "positive"
        ),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The scene with the dynamics of a worn robot."""
        del rules
        dynamics, left = scene.dynamics, 1 - self.values["motors"]
        weak = {name: left * getattr(dynamics, name) for name in ("drive_force", "turn_torque", "finger_torque")}
        return replace(scene, dynamics=replace(dynamics, veer=dynamics.veer + self.values["wheels"] / TRACK, **weak))

    def action(self, commands: Sequence[int], step: int) -> int:
        """The commanded action, the one before, or any."""
        which = self.uniform(step)
        if which >= self.values["replaced"]:
            return commands[-1]
        if which < self.values["replaced"] / 2:
            return commands[-2] if len(commands) > 1 else NOOP
        return int(self.uniform(step, 1) * len(ACTIONS))


class Latency(Shift):
    """Actions take effect some steps late; until the first one does, nothing is done."""

    name = "latency"
    summary = "actions take effect late"
    factors = (
        Factor("steps", "steps of delay", (1, 2, 3, 4, 4), "exact"),
        Factor("spread", "most steps by which each delay differs from that", (0, 0, 0, 0, 2), "exact"),
    )

    def delay(self, step: int) -> int:
        """The delay of the action that is taken at a step."""
        delay, spread = int(self.values["steps"]), int(self.values["spread"])
        return delay + int(self.uniform(step) * (2 * spread + 1)) - spread if spread else delay

    def action(self, commands: Sequence[int], step: int) -> int:
        """The action of some steps before."""
        delay = self.delay(step)
        return commands[-1 - delay] if delay < len(commands) else NOOP
