"""The argument names of the original and of x-magical. Our environments accept them, with a warning that names ours."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any, Final, TypeVar

import numpy as np

from magical_mj.utils.errors import SettingsError, closest, short_repr, unknown_argument

_Made = TypeVar("_Made", bound=Callable[..., Any])


def _dense(wanted: Any) -> str | None:
    if not isinstance(wanted, bool | np.bool_):
        raise SettingsError(f'give reward="dense", or True or False, not {short_repr(wanted)}')
    return "dense" if wanted else None


def _size(sides: Any) -> Any:
    if not isinstance(sides, tuple | list) or len(sides) != 2 or sides[0] != sides[1]:
        raise SettingsError(f"res_hw is (height, width), and pictures here are square, not {short_repr(sides)}")
    return sides[0]


OLD_NAMES: Final[Mapping[str, tuple[str, Callable[[Any], Any]]]] = {
    "debug_reward": ("reward", _dense),  # the original's
    "use_dense_reward": ("reward", _dense),  # x-magical's
    "res_hw": ("image_size", _size),  # both packages'
}
"""Argument of another package -> ours, and the function from its value to ours; None leaves ours out."""


def with_old_names(make: _Made) -> _Made:
    """An environment's `__init__`, or a function that makes one, that also accepts the `OLD_NAMES`, with a warning.

    Raises:
        UnknownArgumentError: for any other unknown argument.
        SettingsError: if an argument is given by both names.
    """
    known = [name for name in inspect.signature(make).parameters if name != "self"]

    @wraps(make)
    def accepting(*arguments: Any, **settings: Any) -> Any:
        for name in settings.keys() - known:
            if name in OLD_NAMES:
                ours, converted = OLD_NAMES[name]
                value = converted(settings.pop(name))
                if value is not None and ours in settings:
                    raise SettingsError(f"{name} is the old name of {ours}: give only {ours}")
                if value is not None:
                    settings[ours] = value
                    warnings.warn(f"{name} is deprecated: give {ours}={value!r}", FutureWarning, stacklevel=3)
            elif "settings" not in known:  # `settings` are passed on to another `__init__`, which checks them
                meant = closest(name, (*known, *OLD_NAMES))
                meant = OLD_NAMES[meant][0] if meant in OLD_NAMES else meant
                raise unknown_argument(name, known, meant)
        return make(*arguments, **settings)

    return accepting  # type: ignore[return-value]
