"""Scenes: immutable descriptions of all objects and their poses. Models, pictures and scores are computed from them.

Frames: x to the right, y up, origin at the centre of the 2 x 2 workspace. Angles are in radians,
counter-clockwise. A robot with angle 0 faces +y. A block with angle 0 has its tip (or top side) at +y.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any, Final, TypeVar

from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, check_body_name
from magical_mj.scene.constants import BORDERS, COLOURS, SHAPES, Border, Colour, Shape
from magical_mj.utils.errors import InvalidSceneError, short_repr
from magical_mj.utils.imports import check_named

SCENE_FORMAT: Final = 1
"""The version of the JSON form, stored in it as ``"format"``."""

REGION_TOLERANCE: Final = 1e-6
"""The rounding tolerance (world units) for regions of a scene that is read from the simulation."""

SMALLEST_ARENA, LARGEST_ARENA = 0.5, 2.0
"""The bounds of the arena's half width, in world units."""

MAX_NUMBER: Final = 1e10
"""The largest absolute value of a number in a scene. MuJoCo treats larger values as a failed simulation."""

LONGEST_JSON: Final = 100_000
"""The largest length of a scene's JSON. Ten blocks take 1,500 characters."""

Pose = tuple[float, float, float]
"""x, y in world units and the angle in radians."""

_Part = TypeVar("_Part", bound="Scene | Robot | Block | GoalRegion | Dynamics | Pebble")


@dataclass(frozen=True, slots=True)
class Robot:
    """The robot's pose and the relative angles (rad) of its left and right finger.

    A finger's angle is 0 when closed and ``+pi/8`` (left) or ``-pi/8`` (right) when open, the default.
    The body is one of `magical_mj.scene.bodies.BODIES`, or ``"package.module:BODY"``. For bodies without fingers, their
    angles have no meaning and do not change.
    """

    x: float
    y: float
    angle: float
    fingers: tuple[float, float] = (c.FINGER_OPEN, -c.FINGER_OPEN)
    body: str = GRIPPER

    def __post_init__(self) -> None:
        _set_numbers(self, "x", "y", "angle")
        if self.body != GRIPPER:
            object.__setattr__(self, "body", check_body_name(self.body))
        fingers = _as_tuple(self.fingers, "Robot.fingers must be two angles (left, right)", 2)
        angles = _as_number("Robot.fingers", fingers[0]), _as_number("Robot.fingers", fingers[1])
        object.__setattr__(self, "fingers", angles)

    @property
    def pose(self) -> Pose:
        """x, y, angle."""
        return self.x, self.y, self.angle


@dataclass(frozen=True, slots=True)
class Block:
    """A movable block. Its centre of mass is at (x, y)."""

    shape: Shape
    colour: Colour
    x: float
    y: float
    angle: float
    mass: float = c.BLOCK_MASS

    def __post_init__(self) -> None:
        _set_choice(self, "shape", SHAPES)
        _set_choice(self, "colour", COLOURS)
        _set_numbers(self, "x", "y", "angle", "mass")
        if self.mass <= 0:
            raise InvalidSceneError(f"Block.mass must be positive, not {self.mass}")

    @property
    def pose(self) -> Pose:
        """x, y, angle."""
        return self.x, self.y, self.angle


@dataclass(frozen=True, slots=True)
class GoalRegion:
    """An axis-aligned box that is drawn, with this kind of border, but is not solid."""

    colour: Colour
    x_min: float
    y_min: float
    x_max: float
    y_max: float
    border: Border = "dashed"

    def __post_init__(self) -> None:
        _set_choice(self, "colour", COLOURS)
        _set_choice(self, "border", BORDERS)
        _set_numbers(self, "x_min", "y_min", "x_max", "y_max")
        if not (self.x_min < self.x_max and self.y_min < self.y_max):
            raise InvalidSceneError(f"{self} is empty: x_min < x_max and y_min < y_max are needed")

    @property
    def is_zone(self) -> bool:
        """Whether it is a zone along a wall, as in x-magical, with a solid border: it may reach beyond the wall."""
        return self.border == "solid"

    @property
    def box(self) -> tuple[float, float, float, float]:
        """x_min, y_min, x_max, y_max."""
        return self.x_min, self.y_min, self.x_max, self.y_max

    @property
    def width(self) -> float:
        """Extent along x."""
        return self.x_max - self.x_min

    @property
    def height(self) -> float:
        """Extent along y."""
        return self.y_max - self.y_min

    @property
    def centre(self) -> tuple[float, float]:
        """x, y of the centre."""
        return (self.x_min + self.x_max) / 2, (self.y_min + self.y_max) / 2

    def contains(self, body: Robot | Block) -> bool:
        """Whether the centre of `body` is in the region, borders included."""
        return self.x_min <= body.x <= self.x_max and self.y_min <= body.y <= self.y_max


@dataclass(frozen=True, slots=True)
class Pebble:
    """A small loose disc that no task uses. Only shifts add pebbles to scenes. Its centre is at (x, y)."""

    x: float
    y: float

    def __post_init__(self) -> None:
        _set_numbers(self, "x", "y")


@dataclass(frozen=True, slots=True)
class Dynamics:
    """The five force caps of the simulation, all positive. The Dynamics variant draws other values.

    `veer` is the angle (rad) that the robot turns for each world unit that it drives, as with unequal wheels. Only
    shifts change it. MuJoCo's lowest coefficient of friction limits the caps' effect: even with smaller caps,
    blocks resist with at least 0.1, and the robot drives with at least 0.2.
    """

    drive_force: float = c.DRIVE_FORCE
    turn_torque: float = c.TURN_TORQUE
    finger_torque: float = c.FINGER_TORQUE
    block_friction_force: float = c.BLOCK_FRICTION_FORCE
    block_friction_torque: float = c.BLOCK_FRICTION_TORQUE
    veer: float = 0.0

    def __post_init__(self) -> None:
        for entry in dataclasses.fields(self):
            _set_numbers(self, entry.name)
            if entry.name != "veer" and getattr(self, entry.name) <= 0:
                raise InvalidSceneError(f"Dynamics.{entry.name} must be positive, not {getattr(self, entry.name)}")


_LISTS: Final = {"blocks": Block, "regions": GoalRegion, "pebbles": Pebble}
"""The fields of a scene that contain any number of parts."""


@dataclass(frozen=True, slots=True)
class Scene:
    """The robot, the blocks, the goal regions and the dynamics, at rest. Immutable and hashable.

    The inner faces of the walls are at x, y = -half_width and half_width.
    """

    robot: Robot
    blocks: tuple[Block, ...] = ()
    regions: tuple[GoalRegion, ...] = ()
    dynamics: Dynamics = field(default_factory=Dynamics)
    half_width: float = c.ARENA_HALF_WIDTH
    pebbles: tuple[Pebble, ...] = ()

    def __post_init__(self) -> None:
        _set_numbers(self, "half_width")
        if not SMALLEST_ARENA <= self.half_width <= LARGEST_ARENA:
            raise InvalidSceneError(
                f"Scene.half_width must be in {SMALLEST_ARENA}..{LARGEST_ARENA}, not {self.half_width}"
            )
        for name, kind in (("robot", Robot), ("dynamics", Dynamics), *_LISTS.items()):
            parts = (getattr(self, name),)
            if name in _LISTS:
                parts = _as_tuple(*parts, f"Scene.{name} must be a sequence of {kind.__name__}")
                object.__setattr__(self, name, parts)
            for part in parts:
                if not isinstance(part, kind):
                    raise InvalidSceneError(f"a scene needs a {kind.__name__} here, not {short_repr(part)}")

    def moved(self, robot: Sequence[float] | None = None, blocks: Sequence[Sequence[float]] | None = None) -> Scene:
        """The same scene with other poses (x, y, angle). None keeps the poses. The fingers never change.

        Raises:
            InvalidSceneError: if the number of poses is not the number of blocks.
        """
        moved = self.robot if robot is None else _at(self.robot, robot)
        if blocks is None:
            return dataclasses.replace(self, robot=moved)
        poses = _as_tuple(blocks, f"{len(self.blocks)} blocks need {len(self.blocks)} poses", len(self.blocks))
        return dataclasses.replace(self, robot=moved, blocks=tuple(map(_at, self.blocks, poses)))

    def to_json(self) -> str:
        """The scene as one line of JSON. Floats are exact, so that `from_json` returns an equal scene."""
        return json.dumps({"format": SCENE_FORMAT, **_plain(self, UNWRITTEN)}, separators=(",", ":"))

    @classmethod
    def from_json(cls, text: str | bytes, *, trusted: Collection[str] = ()) -> Scene:
        """The scene in a text written by `to_json`.

        Args:
            text: the JSON.
            trusted: references such as "mine:BODY" that it may name; see docs/trust.md.

        Raises:
            InvalidSceneError: if the text is not JSON, lacks a field, has an unknown one, or has an invalid value.
            UntrustedNameError: if its body is a reference that is not trusted.
        """
        if isinstance(text, str | bytes | bytearray) and len(text) > LONGEST_JSON:
            raise InvalidSceneError(
                f"a scene's JSON has at most {LONGEST_JSON:,} characters, and this text has {len(text):,}"
            )
        try:
            data = json.loads(text, object_pairs_hook=_without_repeats)
        except (ValueError, TypeError, RecursionError) as error:
            raise InvalidSceneError(f"a scene must be JSON as written by Scene.to_json: {error}") from None
        version = data.pop("format", None) if isinstance(data, dict) else SCENE_FORMAT
        if type(version) is not int or version != SCENE_FORMAT:
            raise InvalidSceneError(f'a scene must have "format": {SCENE_FORMAT}; write it with Scene.to_json')
        scene = _part(cls, data)
        check_named(scene.robot.body, "a scene", trusted)
        return scene

    def digest(self) -> str:
        """A short hash of the scene. Equal scenes have equal digests, different ones different digests.

        Fields with their default value are left out, so that new fields in later versions do not change digests.
        """
        text = json.dumps(_plain(self), sort_keys=True, separators=(",", ":"))
        return hashlib.sha256(text.encode()).hexdigest()[:16]


UNWRITTEN: Final = ("body", "mass", "border", "half_width", "veer", "pebbles")
"""Fields that JSON contains only if they differ from their default, since earlier versions did not write them."""


def _plain(value: Any, left_out: Collection[str] | None = None) -> Any:
    """A part of a scene as lists and dicts. Fields in `left_out` (None: all) are omitted if they have their default."""
    if isinstance(value, tuple):
        return [_plain(item, left_out) for item in value]
    if not dataclasses.is_dataclass(value):
        return value
    plain = {}
    for name, default in _defaults(type(value)).items():
        own = getattr(value, name)
        if own != default or (left_out is not None and name not in left_out):
            plain[name] = _plain(own, left_out)
    return plain


@cache
def _defaults(kind: type) -> dict[str, Any]:
    """The fields of a part of scenes, with their default values; MISSING for those without."""
    return {
        entry.name: entry.default if entry.default_factory is dataclasses.MISSING else entry.default_factory()
        for entry in dataclasses.fields(kind)
    }


def check_scene_type(scene: object) -> Scene:
    """The scene. Raises an `InvalidSceneError` for other types."""
    if not isinstance(scene, Scene):
        raise InvalidSceneError(f"{short_repr(scene)} is not a magical_mj.Scene; Scene.from_json creates one from JSON")
    return scene


def check_same_objects(initial: object, final: object) -> None:
    """Raises an `InvalidSceneError` unless both are scenes with the same blocks, in any poses, and goal regions."""
    initial, final = check_scene_type(initial), check_scene_type(final)
    before, after = ([f"{block.colour} {block.shape}" for block in scene.blocks] for scene in (initial, final))
    if before != after:
        raise InvalidSceneError(
            "the final scene must have the initial scene's blocks in the same order, "
            f"{', '.join(before) or 'none'}, not {', '.join(after) or 'none'}"
        )
    if initial.regions == final.regions:
        return
    pairs = list(zip(initial.regions, final.regions, strict=False))
    gaps = [abs(side - other) for one, two in pairs for side, other in zip(one.box, two.box, strict=True)]
    alike = len(initial.regions) == len(final.regions) and all(one.colour == two.colour for one, two in pairs)
    if not alike or max(gaps, default=0.0) > REGION_TOLERANCE:
        raise InvalidSceneError(
            f"the final scene must have the initial scene's goal regions, {initial.regions}, not {final.regions}"
        )


_Body = TypeVar("_Body", Robot, Block)


def _at(body: _Body, pose: Sequence[float]) -> _Body:
    """The same robot or block at another pose."""
    x, y, angle = _as_tuple(pose, "a pose is (x, y, angle)", 3)
    return dataclasses.replace(body, x=x, y=y, angle=angle)


def _without_repeats(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """A JSON object's fields. Raises a ValueError if a name occurs twice."""
    fields: dict[str, Any] = {}
    for name, value in pairs:
        if name in fields:
            raise ValueError(f"{short_repr(name)} occurs twice in one object")
        fields[name] = value
    return fields


def _part(kind: type[_Part], data: Any) -> _Part:
    """A scene, or a part of one, from its JSON."""
    if not isinstance(data, dict):
        raise InvalidSceneError(f"{kind.__name__} must be a JSON object, not {short_repr(data)}")
    known = _defaults(kind)
    required = [name for name, default in known.items() if default is dataclasses.MISSING]
    for name in sorted(data.keys() - known.keys()):
        raise InvalidSceneError(f"{kind.__name__} has no field {short_repr(name)}; it has {', '.join(known)}")
    for name in sorted(set(required) - data.keys()):
        raise InvalidSceneError(f"{kind.__name__} lacks the field {name!r}; it needs {', '.join(required)}")
    for name, value in data.items() if kind is Scene else ():
        if name in _LISTS and not isinstance(value, list):
            raise InvalidSceneError(f"Scene.{name} must be a list, not {short_repr(value)}")
        if name in _LISTS:
            data[name] = tuple(_part(_LISTS[name], item) for item in value)
        elif name != "half_width":
            data[name] = _part(Robot if name == "robot" else Dynamics, value)
    return kind(**data)


def _set_numbers(owner: object, *names: str) -> None:
    """Converts these fields of a frozen dataclass to floats, or raises an `InvalidSceneError`."""
    for name in names:
        value = getattr(owner, name)
        if type(value) is not float or value == 0.0 or not abs(value) <= MAX_NUMBER:  # most values need no change
            object.__setattr__(owner, name, _as_number(f"{type(owner).__name__}.{name}", value))


def _as_number(name: str, value: Any) -> float:
    """`value` as a float. Numbers of numpy and other libraries are accepted, booleans and strings are not."""
    kind = getattr(getattr(value, "dtype", None), "kind", "f")  # the kind of numpy's scalars and arrays
    single = not isinstance(value, bool) and kind in "fiu" and not getattr(value, "ndim", 0)
    try:
        number = float(value) if single and hasattr(value, "__float__") else math.nan
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not abs(number) <= MAX_NUMBER:
        raise InvalidSceneError(f"{name} must be a finite number, at most {MAX_NUMBER:g}, not {short_repr(value)}")
    return number + 0.0  # converts -0.0 to 0.0, so that equal scenes have equal digests


def _set_choice(owner: object, name: str, allowed: Sequence[str]) -> None:
    """Converts this field of a frozen dataclass to one of the allowed strings, or raises an `InvalidSceneError`."""
    value = getattr(owner, name)
    if not isinstance(value, str) or value not in allowed:
        raise InvalidSceneError(
            f"{type(owner).__name__}.{name} is {short_repr(value)}; it must be one of {', '.join(allowed)}"
        )
    if type(value) is not str:  # a numpy string or an enum member
        object.__setattr__(owner, name, allowed[allowed.index(value)])


def _as_tuple(value: Any, need: str, count: int | None = None) -> tuple[Any, ...]:
    """`value` as a tuple of `count` items (None: any number). Raises an `InvalidSceneError` that begins with `need`.

    Accepts all sequences except strings, but no mappings and sets, which have no order.
    """
    try:
        items = None if isinstance(value, str | bytes | Mapping | set | frozenset) else tuple(value)
    except TypeError:  # also raised for 0-d arrays, which appear to be sequences
        items = None
    if items is None or count not in (None, len(items)):
        raise InvalidSceneError(f"{need}, not {short_repr(value)}")
    return items
