"""Checks of what files say about the training of a policy. Files may come from an untrusted source."""

from __future__ import annotations

import re

from magical_mj.tasks.registry import EVERY_VARIANT
from magical_mj.utils.errors import SettingsError, as_integer, short_repr


def check_set(value: object, where: str) -> int:
    """The number of a set of the package's demonstrations. Raises a `SettingsError` if the value is not a number."""
    number = as_integer(value, 1)
    if number is None:
        raise SettingsError(f"{where} must be a number of a set, not {short_repr(value)}")
    return number


def check_variants(value: object, where: str) -> str:
    """Variants, separated by commas. Raises a `SettingsError` if the value contains anything else."""
    if not isinstance(value, str) or not set(value.split(",")) <= set(EVERY_VARIANT):
        raise SettingsError(f"{where} must be variants, separated by commas, not {short_repr(value)}")
    return value


def check_tasks(value: object, where: str) -> tuple[str, ...]:
    """Names of tasks, which need not exist here. Raises a `SettingsError` if the value contains anything else."""
    if not isinstance(value, list | tuple) or not all(isinstance(task, str) and task for task in value):
        raise SettingsError(f"{where} must be a list of tasks, not {short_repr(value)}")
    return tuple(value)


def check_stopped(value: str, where: str) -> str:
    """Where a training stopped. Raises a `SettingsError` unless it is such as "update 225 of 3000"."""
    if not re.fullmatch(r"\w+ \d{1,12} of \d{1,12}", value):
        raise SettingsError(f"{where} must be such as 'update 225 of 3000', not {short_repr(value)}")
    return value
