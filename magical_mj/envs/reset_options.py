"""The options that `reset` of the Gymnasium environments takes."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from magical_mj.utils.errors import SettingsError, shown


class ResetOptions:
    """The options that an environment's `reset` knows. It warns of others, since libraries give options of their own.

    Args:
        known: their names.
    """

    def __init__(self, *known: str) -> None:
        self._known = known
        self._warned: set[str] = set()

    def checked(self, options: Mapping[str, Any] | None) -> Mapping[str, Any]:
        """The options given to `reset`. Of a name that is not known it warns once: resets are many.

        Raises:
            SettingsError: if they are neither a mapping nor None.
        """
        names = " and ".join(f'"{name}"' for name in self._known)
        if options is None:
            return {}
        if not isinstance(options, Mapping):
            raise SettingsError(f"options are a dict with {names} for keys, not {shown(options)}")
        if others := options.keys() - self._warned - set(self._known):
            self._warned |= others
            ignored = ", ".join(sorted(map(repr, others)))
            warnings.warn(f"reset ignores the options {ignored}; it knows {names}", stacklevel=3)
        return options
