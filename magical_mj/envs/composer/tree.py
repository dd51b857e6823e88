"""Detects users' changes of MJCF trees: of any attribute, and of attributes that the scene determines."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from dm_control import mjcf

from magical_mj.utils.errors import SettingsError

_SCENE: Final = "give another scene to reset(scene=...)"
_HOOK: Final = "or write {} in an initialize_episode hook"
OWNERS: Final[Mapping[str, str]] = {
    **dict.fromkeys(("pos", "quat", "axis", "ref"), f"the poses in the scene: {_SCENE}"),
    **dict.fromkeys(("vertex", "face"), f"the scene's goal regions: {_SCENE}"),
    "rgba": f"the colours in the scene: {_SCENE}, {_HOOK.format('physics.model.geom_rgba')}",
    "friction": f"Scene.dynamics: {_SCENE}, {_HOOK.format('physics.model.pair_friction')}",
    "frictionloss": f"Scene.dynamics: {_SCENE}, {_HOOK.format('the compiled model')}",
    "timestep": "the protocol: an action is ten substeps of 12.5 ms, for which motors and contacts are fitted",
}
"""Attribute -> the part of the scene that determines it, and what users can change instead."""


class Watch:
    """Detects changes of a tree and of all attached trees since the watch was created.

    dm_control counts assignments, additions and removals. It does not notice writes into arrays: `geom.size[0] = 1`.
    """

    def __init__(self, root: mjcf.RootElement) -> None:
        found = list(_walk(root))
        self._scopes = list({id(element.namescope): element.namescope for element in found}.values())
        values = (value for element in found for value in element.get_attributes().values())
        self._arrays: list[Any] = [
            value for value in values if isinstance(value, np.ndarray) and value.flags.c_contiguous
        ]
        self._before = self._now()

    def changed(self) -> bool:
        """Whether the tree was changed."""
        return self._now() != self._before

    def _now(self) -> tuple[list[int], bytes]:
        return [scope.revision for scope in self._scopes], b"".join(self._arrays)


def _walk(element: Any) -> Iterator[Any]:
    yield element
    for child in element.all_children():
        yield from _walk(child)


class Owned:
    """The attributes that the scene determines, with their last written values. Users must change the scene instead."""

    def __init__(self) -> None:
        self._written: list[tuple[Any, str, str, Any]] = []

    def write(self, element: Any, attributes: Mapping[str, Any]) -> None:
        """Sets attributes of an element and stores their values."""
        element.set_attributes(**attributes)
        described = _described(element)
        self._written += ((element, described, name, np.copy(getattr(element, name))) for name in attributes)

    def changed(self) -> list[tuple[str, str]]:
        """The elements and attributes that users have changed. Raises a `SettingsError` if an element was removed."""
        for element, described, *_ in self._written:
            if element.is_removed:
                raise SettingsError(f"the MJCF tree lacks {described}, which its scene needs: do not remove it")
        return [
            (described, name)
            for element, described, name, value in self._written
            if not np.array_equal(getattr(element, name), value)
        ]


def _described(element: Any) -> str:
    name = getattr(element, "full_identifier", None)
    return f"<{element.tag}>" if name is None else f'<{element.tag} name="{name}">'


def refuse(changed: list[tuple[str, str]]) -> None:
    """Raises a `SettingsError` if the list of changed elements and attributes is not empty."""
    if changed:
        element, name = changed[0]
        more = f" (and {len(changed) - 1} more)" if len(changed) > 1 else ""
        raise SettingsError(
            f"{name} of {element} was changed{more}, but it follows from {OWNERS[name]}. The value has been restored. "
            "docs/composer.md lists the attributes that the scene determines"
        )
