"""Checks of what vector environments are given for each of their worlds."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from magical_mj.scene.actions import ACTIONS
from magical_mj.utils.errors import InvalidActionError, SettingsError, shown


def masked(mask: Any, worlds: int) -> list[int]:
    """The worlds for which the mask is true; without a mask all of them.

    Raises:
        SettingsError: if it does not hold a bool for each world.
    """
    if mask is None:
        return list(range(worlds))
    try:
        given = torch.as_tensor(mask).cpu()
    except (TypeError, ValueError, RuntimeError):
        given = torch.empty(0)
    if given.dtype != torch.bool or given.shape != (worlds,):
        raise SettingsError(f"reset_mask must hold {worlds} bools, one for each world, not {shown(mask)}")
    return given.nonzero()[:, 0].tolist()


def check_actions(actions: Any, worlds: int, device: str) -> Tensor:
    """The numbers of the actions on a device.

    Raises:
        InvalidActionError: if there is not one in 0..17 for each world.
    """
    try:
        given = torch.as_tensor(actions, device=device)
    except (TypeError, ValueError, RuntimeError):
        given = torch.empty(0)
    whole = not given.is_floating_point() and not given.is_complex() and given.dtype != torch.bool
    numbers = given.long() if whole else given
    if given.shape != (worlds,) or not whole or bool(((numbers < 0) | (numbers >= len(ACTIONS))).any()):
        raise InvalidActionError(
            f"actions must be {worlds} integers in 0..{len(ACTIONS) - 1}, one for each world, not {shown(actions)}"
        )
    return numbers
