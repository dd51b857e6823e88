"""Variations: all factors of a task's scenes and shifts as a Gymnasium space. They can be set, drawn and read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from magical_mj.engine import Engine
from magical_mj.observations import MAX_BLOCKS, MAX_REGIONS
from magical_mj.scene import Block, Dynamics, GoalRegion, Pebble, Scene
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.scene.geometry import OVERHANG
from magical_mj.shifts import SHIFTS, shift_class
from magical_mj.shifts.episode import Draws, EpisodeShifts, draw_shifts
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidSceneError, SettingsError, check_name, short_repr

MAX_PEBBLES: Final = 8
MAX_SEED: Final = 2**63 - 1
DYNAMICS: Final = tuple(Dynamics.__dataclass_fields__)
Variation = dict[str, Any]
"""A value of a `VariationSpace`: "seed", "scene" with its factors, and each shift with its factors."""


class VariationSpace(spaces.Dict):
    """The factors that can vary in a task's episodes.

    Arrays have fixed sizes: entries of absent blocks, regions and pebbles are 0. All factors of an absent shift are 0.
    "seed" determines the random numbers that shifts draw in addition to their factors.

    Args:
        engine: an engine of the task.
    """

    def __init__(self, engine: Engine) -> None:
        self._setup = engine.setup
        self._shifts = [name for name in SHIFTS if not SHIFTS[name].supports(str(engine.task))]
        self._shifts += [name for name in (*engine.shifts, *engine.draws) if name not in self._shifts]
        axes = {
            name: spaces.Dict({factor.name: _space(factor) for factor in shift_class(name).factors})
            for name in dict.fromkeys(self._shifts)
        }
        half = engine.initial_scene.half_width
        poses = np.array([half, half, 200.0])
        scene = {
            "robot": spaces.Box(-poses, poses, dtype=np.float64),
            "block_count": spaces.Discrete(MAX_BLOCKS + 1),
            "blocks": spaces.Box(np.tile(-poses, (MAX_BLOCKS, 1)), np.tile(poses, (MAX_BLOCKS, 1)), dtype=np.float64),
            "shapes": spaces.MultiDiscrete([len(SHAPES)] * MAX_BLOCKS),
            "colours": spaces.MultiDiscrete([len(COLOURS)] * MAX_BLOCKS),
            "region_count": spaces.Discrete(MAX_REGIONS + 1),
            "regions": spaces.Box(-half - OVERHANG, half + OVERHANG, (MAX_REGIONS, 4), np.float64),
            "region_colours": spaces.MultiDiscrete([len(COLOURS)] * MAX_REGIONS),
            "dynamics": spaces.Box(np.array([0.01] * 5 + [-2.0]), np.array([20.0] * 5 + [2.0]), dtype=np.float64),
            "pebble_count": spaces.Discrete(MAX_PEBBLES + 1),
            "pebbles": spaces.Box(-half, half, (MAX_PEBBLES, 2), np.float64),
        }
        super().__init__({"seed": spaces.Discrete(MAX_SEED), "scene": spaces.Dict(scene), **axes})
        demo = task_spec(str(engine.task)).demo
        self._demo = replace(demo, robot=replace(demo.robot, body=engine.initial_scene.robot.body))
        self.values_of(self._demo, {}, 0)  # fail early

    @property
    def default(self) -> Variation:
        """The variation of the task's demo scene without shifts, as a new dict."""
        return self.values_of(self._demo, {}, 0)

    def values_of(self, scene: Scene, draws: Draws, seed: int) -> Variation:
        """The variation of an episode. Raises an `InvalidSceneError` if its scene has more objects than the space."""
        values: Variation = {"seed": seed, "scene": _scene_values(scene)}
        for name in self.spaces.keys() - values.keys():
            drawn = draws.get(name, {})
            values[name] = {factor.name: drawn.get(factor.name, 0) for factor in shift_class(name).factors}
        return {name: _cast(space, values[name]) for name, space in self.spaces.items()}

    def sample(self, mask: Any = None, probability: Any = None) -> Variation:
        """A random variation that `reset` accepts: a scene of the variant All, with all shifts at their full strength.

        Masks are refused: to draw some factors only, pass their names to `reset`.
        """
        if mask is not None or probability is not None:
            raise SettingsError(
                "a VariationSpace does not support masks: to draw some factors only, use "
                'reset(options={"variation": ["camera"]})'
            )
        return self.draw(["all"], int(self.np_random.integers(MAX_SEED)))

    def draw(self, names: Sequence[Any], seed: int) -> Variation:
        """The default variation with these factors drawn: shifts at their full strength, scenes as in the variant All.

        Args:
            names: names of shifts; names of single factors, such as "camera.zoom"; "scene"; or "all".
            seed: draws the values.

        Raises:
            UnknownNameError: for any other name.
            SettingsError: if the names are not a list.
        """
        if not isinstance(names, list | tuple) or not all(isinstance(name, str) for name in names):
            raise SettingsError(
                f'a variation must be a dict, or a list of names like ["camera"], not {short_repr(names)}'
            )
        shifts = [name for name in self.spaces if name not in ("seed", "scene")]
        factors = [f"{name}.{factor.name}" for name in shifts for factor in shift_class(name).factors]
        for name in names:
            check_name("factor", name, ("all", "scene", *shifts, *factors))
        everything = "all" in names
        wanted = [name for name in shifts if everything or any(given.partition(".")[0] == name for given in names)]
        draws: dict[str, dict[str, float]] = draw_shifts(dict.fromkeys(wanted, STRENGTHS), seed)
        for name, values in draws.items():
            if not everything and name not in names:
                values.update({factor: 0 for factor in values if factor != "seed" and f"{name}.{factor}" not in names})
        setup = replace(self._setup, variant="All") if everything or "scene" in names else self._setup
        scene, _ = setup.scene_and_shifts({}, seed)
        return self.values_of(EpisodeShifts(draws).scene(scene, str(setup.task)), draws, seed)

    def episode(self, values: Mapping[str, Any], scene: Scene) -> tuple[Scene, Draws]:
        """The scene and the shifts' values of a variation.

        Args:
            values: the variation.
            scene: gives the properties that a variation lacks, such as fingers and masses.

        Raises:
            UnknownNameError: for an unknown factor.
            SettingsError: if the variation is not in this space.
        """
        for name, part in values.items():
            if isinstance(part, Mapping) and isinstance(space := self.spaces.get(name), spaces.Dict):
                for factor in part:
                    check_name(f"factor of {name}", factor, space.spaces)
        values = {name: _cast(self.spaces.get(name), value) for name, value in values.items()}
        if not self.contains(values):
            wrong = [name for name, value in values.items() if name not in self.spaces or value not in self[name]]
            raise SettingsError(
                f"these values of the variation are not in env.unwrapped.variation_space: {', '.join(wrong)}"
            )
        draws: dict[str, dict[str, float]] = {}
        for name in self.spaces.keys() - {"seed", "scene"}:
            factors = {factor.name: factor for factor in shift_class(name).factors}
            drawn = {key: int(value) if factors[key].whole else float(value) for key, value in values[name].items()}
            if any(drawn.values()):
                draws[name] = {**{key: drawn[key] for key in factors}, "seed": int(values["seed"])}
        ordered = {name: draws[name] for name in (*SHIFTS, *sorted(draws.keys() - SHIFTS)) if name in draws}
        return _scene_of(values["scene"], scene), ordered


def _space(factor: Any) -> spaces.Space[Any]:
    least, most = factor.bounds
    if factor.whole and least == 0:
        return spaces.Discrete(int(most) + 1)
    return spaces.Box(float(least), float(most), (), np.float64)


def _cast(space: Any, value: Any) -> Any:
    """Converts a value to the type that Gymnasium requires for the space, if possible."""
    if isinstance(space, spaces.Dict) and isinstance(value, Mapping):
        return {name: _cast(space.spaces.get(name), part) for name, part in value.items()}
    if isinstance(space, spaces.Box | spaces.MultiDiscrete) and isinstance(value, float | int | list | np.ndarray):
        try:
            return np.asarray(value, space.dtype)
        except (TypeError, ValueError, OverflowError):
            return np.empty(0)  # in none of the spaces, so the value is refused
    return value


def _scene_values(scene: Scene) -> Variation:
    for kind, most in (("blocks", MAX_BLOCKS), ("regions", MAX_REGIONS), ("pebbles", MAX_PEBBLES)):
        count = len(getattr(scene, kind))
        if count > most:
            raise InvalidSceneError(f"a variation has entries for {most} {kind}, and the scene has {count}")

    def padded(rows: Sequence[Any], shape: tuple[int, ...], kind: Any = np.float64) -> NDArray[Any]:
        table = np.zeros(shape, kind)
        table[: len(rows)] = np.array(rows, kind).reshape(-1, *shape[1:])
        return table

    blocks, regions = scene.blocks, scene.regions
    boxes = [region.box for region in regions]
    return {
        "robot": np.array(scene.robot.pose),
        "block_count": len(blocks),
        "blocks": padded([block.pose for block in blocks], (MAX_BLOCKS, 3)),
        "shapes": padded([SHAPES.index(block.shape) for block in blocks], (MAX_BLOCKS,), np.int64),
        "colours": padded([COLOURS.index(block.colour) for block in blocks], (MAX_BLOCKS,), np.int64),
        "region_count": len(regions),
        "regions": padded(boxes, (MAX_REGIONS, 4)),
        "region_colours": padded([COLOURS.index(region.colour) for region in regions], (MAX_REGIONS,), np.int64),
        "dynamics": np.array([getattr(scene.dynamics, name) for name in DYNAMICS]),
        "pebble_count": len(scene.pebbles),
        "pebbles": padded([(pebble.x, pebble.y) for pebble in scene.pebbles], (MAX_PEBBLES, 2)),
    }


def _scene_of(values: Mapping[str, Any], scene: Scene) -> Scene:
    """The scene with these values. Fingers, masses and borders are those of `scene`."""
    count = int(values["block_count"])
    kinds = zip(values["shapes"][:count], values["colours"][:count], values["blocks"][:count].tolist(), strict=True)
    blocks = [Block(SHAPES[shape], COLOURS[colour], *pose) for shape, colour, pose in kinds]
    for index, old in enumerate(scene.blocks[:count]):
        blocks[index] = replace(blocks[index], mass=old.mass)
    count = int(values["region_count"])
    boxes = zip(values["region_colours"][:count], values["regions"][:count].tolist(), strict=True)
    regions = [GoalRegion(COLOURS[colour], *box) for colour, box in boxes]
    for index, before in enumerate(scene.regions[:count]):
        regions[index] = replace(regions[index], border=before.border)
    x, y, angle = values["robot"].tolist()
    return replace(
        scene,
        robot=replace(scene.robot, x=x, y=y, angle=angle),
        blocks=tuple(blocks),
        regions=tuple(regions),
        dynamics=Dynamics(*values["dynamics"].tolist()),
        pebbles=tuple(Pebble(*position) for position in values["pebbles"][: int(values["pebble_count"])].tolist()),
    )
