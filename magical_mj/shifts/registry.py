"""All shifts by name: the built-in ones, those of installed packages, and references ``"package.module:NAME"``."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from functools import cache
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import Any, Final, Literal

from magical_mj.scene.bodies import BODIES, check_body_name
from magical_mj.shifts.drawn import Camera, Light, Palette, Sensor, Texture
from magical_mj.shifts.physical import Clutter, Friction, Latency, Pose, Slip
from magical_mj.shifts.shift import STRENGTHS, Factor, Shift, overrides
from magical_mj.shifts.words import Words
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError, ShiftError, as_integer, short_repr, unknown_name
from magical_mj.utils.imports import (
    announced,
    imported,
    is_reference,
    reference_in_folder,
    reference_of,
    resolve,
    source_digest,
)

SHIFT_PROTOCOL: Final = 1
"""The version of the built-in shifts. A change of their names, ranges or random draws requires the next number."""

AXES: Final = (Pose, Camera, Light, Texture, Palette, Clutter, Sensor, Latency, Slip, Friction, Words)
SHIFTS: Final[Mapping[str, type[Shift]]] = MappingProxyType({kind.name: kind for kind in AXES})
"""The built-in shifts by name, in the order of tables and of their application. "all" means these."""

Effect = Literal["simulation", "pictures", "instruction"]
"""What a shift can change."""


def effects(kind: type[Shift]) -> frozenset[Effect]:
    """What a shift can change, according to the methods that it overrides.

    A user's `model` may change both the simulation and the pictures. That of built-in shifts changes only pictures.
    """
    changed: dict[Effect, bool] = {
        "simulation": overrides(kind, "scene", "action") or (kind not in AXES and overrides(kind, "model")),
        "pictures": overrides(kind, "model", "ground", "picture"),
        "instruction": overrides(kind, "instruction"),
    }
    return frozenset(effect for effect, is_changed in changed.items() if is_changed)


PHYSICAL: Final = tuple(kind.name for kind in AXES if "simulation" in effects(kind))
"""The built-in shifts that change the scene, its dynamics or the actions."""
DRAWN: Final = tuple(kind.name for kind in AXES if effects(kind) == {"pictures"})
"""The built-in shifts that change only pictures."""

METHODS: Final = ("scene", "model", "action", "picture", "ground", "instruction")
"""The methods of a shift that change an episode."""

_CLASS: Final = re.compile(r"^class (\w+)\((?:\w+\.)*Shift\):", re.MULTILINE)
"""Matches the definition of a shift in the source of a module. Group 1 is the name of the class."""
SHIFT_GROUP: Final = "magical_mj.shifts"
"""The entry-point group of shifts in installed packages, such as ``fog = "fog:Fog"``."""

BODY: Final = "body"
"""The axis whose levels are names instead of strengths: the bodies that a task offers. "all" does not include it."""

Shifts = Mapping[str, int | str] | str | None
"""Shifts with strengths, such as ``{"camera": 3, "latency": 1}`` or ``"camera:3,latency:1"``. None: no shifts."""


@cache
def shift_plugins() -> Mapping[str, EntryPoint]:
    """The entry points of shifts in installed packages, by name."""
    return announced("shift", SHIFT_GROUP, SHIFTS, str.isidentifier, 'fog = "fog:Fog"')


def shift_class(name: str) -> type[Shift]:
    """The class of one of `SHIFTS`, of an installed package's shift, or of ``"package.module:NAME"``.

    Raises:
        UnknownNameError: for unknown names.
        ShiftError: if the shift of another package is invalid.
    """
    if isinstance(name, str) and name in SHIFTS:
        return SHIFTS[name]
    point = shift_plugins().get(name) if isinstance(name, str) else None
    if point is None and not is_reference(name):
        meant = reference_in_folder(name, _CLASS)
        raise unknown_name("shift", name, (*SHIFTS, *shift_plugins(), "package.module:NAME"), meant)
    kind: Any = imported("shift", name, point, ShiftError)
    if not (isinstance(kind, type) and issubclass(kind, Shift)):
        raise ShiftError(f"{name} is not a class derived from magical_mj.shifts.Shift but {short_repr(kind)}")
    own = getattr(kind, "name", None)
    if not (isinstance(own, str) and own.isidentifier()) or own in SHIFTS:
        raise ShiftError(
            f"{name}.name must consist of letters, digits and _, and must not be the name of a built-in shift, but is "
            f"{short_repr(own)}"
        )
    factors: Any = kind.factors
    if not isinstance(factors, tuple) or not factors or not all(isinstance(factor, Factor) for factor in factors):
        raise ShiftError(
            f"{name}.factors must be a tuple of one or more magical_mj.shifts.Factor, not {short_repr(factors)}; "
            "by default, the strength is the only factor"
        )
    if not overrides(kind, *METHODS):
        raise ShiftError(f"{name} changes nothing: override at least one of the methods {', '.join(METHODS)}")
    return kind


def _canonical(name: object) -> str:
    """The name of a shift in results. For a reference that an installed package announces, it is the announced name."""
    shift_class(name)  # type: ignore[arg-type] - it raises for other types
    return next((known for known, point in shift_plugins().items() if reference_of(point) == name), str(name))


def parse_shifts(shifts: Shifts, task: str | None = None) -> dict[str, int | str]:
    """The level of each shift: first the name of the body, then the strengths of built-in and of other shifts.

    Strength 0 is left out.

    Args:
        shifts: a dict of names and strengths, text such as ``"camera:3,latency:1"``, or a label. None: no shifts.
        task: the task that gets them. None: any task.

    Raises:
        UnknownNameError: for unknown shifts.
        ShiftError: if a user's shift is invalid.
        SettingsError: if a strength is not an integer from 0 to 5, a shift is given twice, or the task does not support
            it.
        InvalidSceneError: for an unknown body.
    """
    if isinstance(shifts, str):
        pairs = [_pair(part.strip()) for part in shifts.replace("+", ",").split(",") if part.strip()]
    elif isinstance(shifts, Mapping):
        pairs = list(shifts.items())
    elif shifts is None:
        pairs = []
    else:
        raise SettingsError(
            f'shifts must be a dict such as {{"camera": 3}} or text such as "camera:3", not {short_repr(shifts)}'
        )
    strengths: dict[str, int | str] = {}
    for name, value in pairs:
        if name != BODY:
            name = _canonical(name)
        if name in strengths:
            raise SettingsError(f"the shift {name} is given twice: give each shift once")
        strengths[name] = check_body_name(value) if name == BODY else _strength(name, value)
    names = (BODY, *SHIFTS, *sorted(strengths.keys() - SHIFTS - {BODY}))
    ordered = {name: strengths[name] for name in names if strengths.get(name)}
    if task is not None:
        for name in ordered:
            if name != BODY and (problem := shift_class(name).supports(task)):
                raise SettingsError(f"{task_spec(task).title} cannot have the shift {name!r}: {problem}")
    return ordered


def split_body(shifts: Shifts, task: str, body: str) -> tuple[dict[str, int], str]:
    """The strengths of shifts, and the robot's body: the one in `shifts`, otherwise `body`. See `parse_shifts`."""
    levels = parse_shifts(shifts, task)
    body = str(levels.pop(BODY, body))
    return {name: int(strength) for name, strength in levels.items()}, body


def arms(shifts: Shifts, *, control: bool) -> dict[str, Shifts]:
    """Suffix of an arm's name -> its shifts. The arms are the evaluation (""), and the control ("-unshifted")."""
    if control and not shifts:
        raise SettingsError("a control is played without the shifts: give shifts, or leave out control")
    return {"": shifts, "-unshifted": None} if control else {"": shifts}


def axis_and_level(text: str) -> tuple[str, str]:
    """Name and level in text such as "camera:3". The level is empty if there is none, as in "camera" and "fog:Fog"."""
    axis, _, level = text.partition(":")
    if axis == BODY:
        return axis, level
    name, _, level = text.rpartition(":")
    return (name, level) if name in SHIFTS or (name and not is_reference(text)) else (text, "")


def _pair(text: str) -> tuple[str, int | str]:
    """Name and level in text such as "camera:3"."""
    name, level = axis_and_level(text)
    if name == BODY:
        return name, level
    if name == text:
        shift_class(name)  # raises for an unknown name
        raise SettingsError(f"the shift {name!r} has no strength: add one from 0 to {STRENGTHS}, such as {name}:3")
    return name, _number(level)


def _number(text: str) -> int | str:
    """The text as an integer if it consists of at most 8 digits, otherwise the text."""
    return int(text) if text.isdecimal() and len(text) < 9 else text


def _strength(name: str, value: object) -> int:
    strength = as_integer(value, 0, STRENGTHS)
    if strength is None:
        raise SettingsError(
            f"the strength of {name} must be an integer from 0 (no shift) to {STRENGTHS}, not {short_repr(value)}"
        )
    return strength


def expand_shifts(
    shifts: str | Iterable[Mapping[str, int | str]], task: str | None = None, unnoticed: Collection[Effect] = ()
) -> list[dict[str, int | str]]:
    """The shift settings of an evaluation, one dict for each, without repetitions.

    Args:
        shifts: dicts, or text such as ``"camera:1-5,light,camera:2+latency:1"``. Each item is a shift with a strength,
            with a range of strengths, or alone for the strengths 1 to 5. "+" combines shifts with one strength each.
            "all" means all built-in shifts at strengths 1 to 5, and "body" all bodies that the expert can use.
        task: the task that gets them. "all" leaves out shifts that it does not support. None: any task.
        unnoticed: effects that a policy cannot notice. "all" leaves out shifts that have no other effect.

    Raises:
        UnknownNameError, ShiftError, SettingsError, InvalidSceneError: see `parse_shifts`.
    """
    if not isinstance(shifts, str):
        each: Any = [shifts] if isinstance(shifts, Mapping) else shifts
        return _unique([parse_shifts(setting, task) for setting in each])
    settings: list[dict[str, int | str]] = []
    for part in filter(None, map(str.strip, shifts.split(","))):
        if part == "all":
            noticed = [kind for kind in AXES if not effects(kind) <= set(unnoticed)]
            supported = [kind.name for kind in noticed if task is None or not kind.supports(task)]
            settings += [parse_shifts({name: strength}) for name in supported for strength in range(1, STRENGTHS + 1)]
        elif part == BODY:
            settings += [parse_shifts({BODY: name}) for name in (BODIES if task is None else task_spec(task).bodies)]
        elif "+" in part or part.startswith(f"{BODY}:"):
            settings.append(parse_shifts(part, task))
        else:
            name, least, most = _range(part)
            settings += [parse_shifts({name: strength}, task) for strength in range(least, most + 1)]
    return _unique(settings)


UNNOTICED: Final[Mapping[Effect, str]] = MappingProxyType(
    {
        "pictures": "it changes pictures, and the observations have none: leave it out, or choose another preset",
        "instruction": "it changes the sentence that describes the task, and only policies with the attribute "
        "uses_instruction = True read it (docs/policies.md): leave it out",
    }
)
"""Why a policy does not notice a shift, and what to do."""


def check_noticed(shifts: Iterable[str], policy: str, unnoticed: frozenset[Effect]) -> None:
    """Raises a `SettingsError` if the policy cannot notice any effect of one of the shifts."""
    for name in shifts:
        changed = frozenset() if name == BODY else effects(shift_class(name))
        if changed and changed <= unnoticed:
            why = UNNOTICED["pictures" if "pictures" in changed else "instruction"]
            raise SettingsError(f"{policy} does not notice the shift {name}: {why}")


def axis_and_strength(label: str) -> tuple[str, int] | None:
    """Name and strength in the label of one shift. None for bodies, and for shifts that are combined."""
    name, level = axis_and_level(label)
    return (name, int(level)) if "+" not in label and level.isdigit() and name != BODY else None


def names_in(label: str) -> list[str]:
    """The names of the body and the shifts in a label, such as "camera:3+latency:1"."""
    parts = map(axis_and_level, filter(None, label.split("+")))
    return [level if name == BODY else name for name, level in parts]


def code_digests(label: str) -> dict[str, str]:
    """Name -> hash of its module, for the shifts and bodies in a label that do not belong to the benchmark."""
    digests: dict[str, str] = {}
    for name in names_in(label):
        if is_reference(name):
            resolve(name)  # imports its module
            digests[name] = source_digest(name)
        elif name not in SHIFTS and name not in BODIES:
            digests[name] = source_digest(shift_class(name).__module__)
    return digests


def _range(part: str) -> tuple[str, int, int]:
    """The name of a shift, and its lowest and highest strength."""
    name, strengths = axis_and_level(part)
    if name == part:
        return name, 1, STRENGTHS
    low, dash, high = strengths.partition("-")
    ends = _number(low), _number(high if dash else low)
    if not all(isinstance(end, int) for end in ends):
        _strength(_canonical(name), strengths)  # raises an error
    least, most = (_strength(name, end) for end in ends)
    if least > most:
        raise SettingsError(f"{part!r} contains no strengths: give the lowest one first, as in {name}:{most}-{least}")
    return name, least, most


def _unique(settings: Iterable[dict[str, int | str]]) -> list[dict[str, int | str]]:
    return list({_label(setting): setting for setting in settings}.values())


def shift_label(shifts: Mapping[str, int | str]) -> str:
    """The label of shifts in results, such as ``"camera:3+latency:1"``. Empty for no shifts."""
    return _label(parse_shifts(shifts))


def _label(levels: Mapping[str, int | str]) -> str:
    return "+".join(f"{name}:{level}" for name, level in levels.items())
