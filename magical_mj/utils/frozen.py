"""Dictionaries that cannot be changed, for values that several objects share."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NoReturn, TypeVar

K = TypeVar("K")
V = TypeVar("V")


def _refuse(*_: object, **__: object) -> NoReturn:
    raise TypeError("this mapping cannot be changed: make a dict of it, and change that")


class FrozenDict(dict[K, V]):
    """A dict without methods that change it. Unlike `types.MappingProxyType`, it can be copied and pickled."""

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (dict(self),)

    __setitem__ = __delitem__ = __ior__ = clear = pop = popitem = setdefault = update = _refuse


def frozen(values: Mapping[K, Any]) -> FrozenDict[K, Any]:
    """A frozen copy of a mapping, with frozen copies of the mappings in it."""
    return FrozenDict({key: frozen(value) if isinstance(value, Mapping) else value for key, value in values.items()})
