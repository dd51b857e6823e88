"""Plug-ins: what installed packages announce by entry points, or a user names as ``"package.module:NAME"``."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import MappingProxyType
from typing import Any

from magical_mj.utils.errors import MagicalError, MissingExtraError, UnknownNameError, short_repr
from magical_mj.utils.imports import is_reference, resolve, resolve_installed, with_location


def announced(
    noun: str, group: str, taken: Collection[str], is_name: Callable[[str], object], example: str
) -> Mapping[str, EntryPoint]:
    """The entry points of a group by name, except names that are `taken`. Their modules are imported at the first use.

    An invalid entry point is ignored with a warning, so that this package can still be imported.
    """
    plugins: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group)):
        if point.name in taken or plugins.get(point.name, point) != point:
            problem = f"another {noun} has this name"
        elif not is_name(point.name):
            problem = f"the name of a {noun} must consist of letters and digits"
        elif not is_reference(reference_of(point)):
            problem = f"it must refer to an object in a module, as in {example}"
        else:
            plugins[point.name] = point
            continue
        warnings.warn(f"the {noun} {point.name!r} ({point.value}) is ignored: {problem}", stacklevel=3)
    return MappingProxyType(plugins)


def imported(noun: str, name: str, point: EntryPoint | None, failed: type[MagicalError]) -> Any:
    """The object of an entry point, or without one, of the user's reference `name`.

    Raises:
        UnknownNameError: if its module or the object in it does not exist.
        MissingExtraError: if its module needs an extra that is not installed.
        MagicalError: of the type `failed`, if its module raises another error.
    """
    try:
        return resolve(name) if point is None else resolve_installed(reference_of(point))
    except MissingExtraError:
        raise
    except (Exception, SystemExit) as error:
        why, kind = (error, UnknownNameError) if isinstance(error, ImportError) else (with_location(error), failed)
        raise kind(f"the {noun} {short_repr(name)} cannot be imported: {why}") from error


def reference_of(point: EntryPoint) -> str:
    """An entry point's reference, without the spaces that Python allows in it."""
    return "".join(point.value.split())
