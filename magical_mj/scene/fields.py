"""Checks of dataclass fields when an object is made: numbers, choices, sequences and types."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final

from magical_mj.utils.errors import InvalidSceneError, shown

MAX_NUMBER: Final = 1e10
"""The largest absolute value of a number in a scene; MuJoCo treats larger ones as a failed simulation."""


def as_number(owner: object, name: str, value: Any) -> float:
    """`value` as a float. Numbers of numpy and other libraries are accepted, booleans and strings are not.

    Args:
        owner: the object whose field it is, for the error.
        name: the field.
        value: what was given.

    Raises:
        InvalidSceneError: if it is not a finite number, or greater than `MAX_NUMBER`.
    """
    kind = getattr(getattr(value, "dtype", None), "kind", "f")  # the kind of numpy's scalars and arrays
    try:
        if isinstance(value, bool) or kind not in "fiu" or getattr(value, "ndim", 0) or not hasattr(value, "__float__"):
            raise TypeError
        found = float(value)
    except (TypeError, ValueError):
        raise InvalidSceneError(f"{_called(owner, name)} must be a number, not {shown(value)}") from None
    except OverflowError:
        found = math.inf
    if not abs(found) <= MAX_NUMBER:
        raise InvalidSceneError(f"{_called(owner, name)} must be finite and at most {MAX_NUMBER:g}, not {shown(value)}")
    return found + 0.0  # -0.0 becomes 0.0: equal scenes have equal digests


def as_tuple(value: Any, need: str, count: int | None = None) -> tuple[Any, ...]:
    """`value` as a tuple. It may be any sequence except a string; mappings and sets, which have no order, may not.

    Args:
        value: what was given.
        need: what is needed, for the error.
        count: how many there must be; None: any number.

    Raises:
        InvalidSceneError: if it is not a sequence, or has another length.
    """
    try:
        found = None if isinstance(value, str | bytes | Mapping | set | frozenset) else tuple(value)
    except TypeError:  # also raised by 0-d arrays, which look like sequences
        found = None
    if found is None or count not in (None, len(found)):
        raise InvalidSceneError(f"{need}, not {shown(value)}")
    return found


def set_numbers(owner: object, names: Iterable[str]) -> None:
    """Turn these fields of a frozen dataclass into floats.

    Raises:
        InvalidSceneError: if one is not a finite number, or greater than `MAX_NUMBER`.
    """
    for name in names:
        value = getattr(owner, name)
        if type(value) is not float or value == 0.0 or not abs(value) <= MAX_NUMBER:  # most need no change
            object.__setattr__(owner, name, as_number(owner, name, value))


def set_choice(owner: object, name: str, allowed: Sequence[str]) -> None:
    """Turn this field of a frozen dataclass into one of the allowed strings.

    Raises:
        InvalidSceneError: if it is none of them.
    """
    value = getattr(owner, name)
    if not isinstance(value, str) or value not in allowed:
        raise InvalidSceneError(f"{_called(owner, name)} is {shown(value)}; it must be one of {', '.join(allowed)}")
    if type(value) is not str:  # a numpy string or an enum member
        object.__setattr__(owner, name, allowed[allowed.index(value)])


def check_type(part: object, kind: type) -> None:
    """Raise `InvalidSceneError` unless a part of a scene is of this type."""
    if not isinstance(part, kind):
        raise InvalidSceneError(f"a scene needs a {kind.__name__} here, not {shown(part)}")


def _called(owner: object, name: str) -> str:
    return f"{type(owner).__name__}.{name}"
