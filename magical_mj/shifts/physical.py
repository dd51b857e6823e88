"""Shifts of the scene and its dynamics: initial poses, pebbles, friction, latency, and a worn robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from magical_mj.actions import ACTIONS, NOOP
from magical_mj.scene import Pebble, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.geometry import inside_walls, pebble_solid, solids, touch
from magical_mj.shifts.shift import GROUND_REACH, Factor, Picture, Shift
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import PlacementError
from magical_mj.variants.placement import along, layout
from magical_mj.variants.rules import VariationRules, axis_generator

TRACK: Final = 2 * c.ROBOT_RADIUS
"""The distance between the robot's wheels in the shift `slip`, in world units."""
MAX_TRIES: Final = 10_000


class Pose(Shift):
    """Interpolates all poses and region sizes between the scene and the Layout scene of the same seed.

    Objects that would overlap are moved apart, by a small distance that is found by sampling.
    """

    name = "pose"
    summary = "initial poses, interpolated towards those of Layout"
    factors = (
        Factor("way", "share of the distance to the poses of Layout", (1 / 16, 1 / 8, 1 / 4, 1 / 2, 1), "exact"),
    )

    @classmethod
    def supports(cls, task: str) -> str | None:
        """Supports tasks with the variant Layout, unless they define a rule for it: interpolation could violate it."""
        spec = task_spec(task)
        if callable(spec.layout) or spec.accepts is not None:
            return "it defines its own rule for layouts"
        return None if "layout" in spec.supported_axes else "it has no variant Layout"

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """The interpolated scene."""
        share = self.values["way"]
        if share == 0:
            return scene
        rng = axis_generator(rules.name, "layout", int(self.values["seed"]))
        other = layout(scene, rng, rules.region_size, rules.inner_margin)
        return along(scene, other, share, self.rng(0))


class Clutter(Shift):
    """Small grey pebbles that the robot can push, and stains on the floor. Neither affects scores directly."""

    name = "clutter"
    summary = "loose pebbles, and stains on the floor"
    factors = (
        Factor("pebbles", "number of pebbles", (1, 2, 3, 5, 8), "exact"),
        Factor("stains", "number of stains on the floor", (1, 2, 3, 5, 8), "exact"),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """Adds pebbles, also in regions. A higher strength adds pebbles to those of the lower ones."""
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
                raise PlacementError("found no free position for a pebble; use fewer blocks, or less clutter")
            pebbles.append(pebble)
            taken.append(solid)
        return replace(scene, pebbles=tuple(pebbles))

    def ground(self, ground: Picture) -> Picture:
        """Adds the stains."""
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
        """Yields x, y, radius (world units) and darkness (in [0, 1]) of each stain.

        A higher strength adds stains to those of the lower ones.
        """
        rng = self.rng(1)
        for _ in range(int(self.values["stains"])):
            x, y, size, shade = rng.random(4).tolist()
            yield 2 * x - 1, 2 * y - 1, 0.06 + 0.12 * size, 0.25 + 0.35 * shade


class Friction(Shift):
    """Changes the friction between blocks and ground, beyond the range of the variant Dynamics."""

    name = "friction"
    summary = "friction of blocks with the ground, beyond the range of Dynamics"
    factors = (
        Factor("force", "friction force of blocks, in doublings", (0.15, 0.3, 0.45, 0.6, 0.75)),
        Factor("torque", "friction torque of blocks, in doublings", (0.2, 0.4, 0.7, 1, 1.5)),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """Changes the dynamics of the scene."""
        del rules
        dynamics = scene.dynamics
        force = dynamics.block_friction_force * 2 ** self.values["force"]
        torque = dynamics.block_friction_torque * 2 ** self.values["torque"]
        return replace(scene, dynamics=replace(dynamics, block_friction_force=force, block_friction_torque=torque))


class Slip(Shift):
    """A worn robot: one wheel is larger, motors are weaker, and some actions are replaced.

    Half of the replaced actions become the previous action, the others a random one of the 18.
    """

    name = "slip"
    summary = "replaced actions, unequal wheels, weak motors"
    factors = (
        Factor("replaced", "probability that an action is replaced", (0.02, 0.05, 0.1, 0.2, 0.3), "exact"),
        Factor("wheels", "difference of the wheels, relative", (0.03, 0.06, 0.12, 0.2, 0.3)),
        Factor(
            "motors", "lost share of the force of drive, turning and fingers", (0.03, 0.06, 0.12, 0.2, 0.3), "positive"
        ),
    )

    def scene(self, scene: Scene, rules: VariationRules) -> Scene:
        """Changes the dynamics of the scene."""
        del rules
        dynamics, power = scene.dynamics, 1 - self.values["motors"]
        weak = {name: power * getattr(dynamics, name) for name in ("drive_force", "turn_torque", "finger_torque")}
        return replace(scene, dynamics=replace(dynamics, veer=dynamics.veer + self.values["wheels"] / TRACK, **weak))

    def action(self, commands: Sequence[int], step: int) -> int:
        """The commanded action, the previous one, or a random one."""
        which = self.uniform(step)
        if which >= self.values["replaced"]:
            return commands[-1]
        if which < self.values["replaced"] / 2:
            return commands[-2] if len(commands) > 1 else NOOP
        return int(self.uniform(step, 1) * len(ACTIONS))


class Latency(Shift):
    """Delays actions by some steps. Until the first one takes effect, the robot does nothing."""

    name = "latency"
    summary = "delayed actions"
    factors = (
        Factor("steps", "delay, in steps", (1, 2, 3, 4, 4), "exact"),
        Factor("spread", "largest random difference from that delay, in steps", (0, 0, 0, 0, 2), "exact"),
    )

    def delay(self, step: int) -> int:
        """The delay of the action that is executed at a step, in steps."""
        delay, spread = int(self.values["steps"]), int(self.values["spread"])
        if spread:
            delay += int(self.uniform(step) * (2 * spread + 1)) - spread
        return delay

    def action(self, commands: Sequence[int], step: int) -> int:
        """The delayed action."""
        delay = self.delay(step)
        return commands[-1 - delay] if delay < len(commands) else NOOP
