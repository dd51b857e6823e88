"""Whether a saved state fits the worlds that are to go back to it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from torch import Tensor

from magical_mj.utils.errors import StateError, shown


def check_state(state: Any, own: Mapping[str, Any]) -> None:
    """Raises a `StateError` unless a state is of the same kind of worlds, and laid out in the same way.

    Args:
        state: what a user gives.
        own: the present state of the worlds.
    """
    kind = state.get("kind") if isinstance(state, Mapping) else None
    if not isinstance(kind, Mapping) or state.keys() != own.keys() or kind.keys() != own["kind"].keys():
        raise StateError(f"set_state() takes what get_state() gave, not {shown(state)}")
    for name, value in own["kind"].items():
        if kind[name] != value:
            raise StateError(f"the state has {name} {shown(kind[name])}, and these worlds {shown(value)}")
    for name in own.keys() - {"kind"}:
        _check_part(name, state[name], own[name])


def _check_part(name: str, part: Any, own: Any) -> None:
    """Raises a `StateError` unless a part of a state has the same type as another one, and the same size."""
    if isinstance(own, Mapping) and isinstance(part, Mapping) and part.keys() == own.keys():
        for key in own:
            _check_part(f"{name}.{key}", part[key], own[key])
    elif _layout(part) != _layout(own):
        raise StateError(f"the state is damaged: its {name} is not what these worlds have; take what get_state() gave")


def _layout(part: Any) -> tuple[Any, ...]:
    if isinstance(part, Tensor | np.ndarray):
        return type(part), part.dtype, tuple(part.shape)
    return type(part), len(part) if isinstance(part, list | Mapping) else None
