"""`EvaluationSettings`: the settings of the core, and those that installed additions declare.

A package announces its settings by an entry point, ``intents = "magical_mj.intents.given:GivenSettings"``, which
refers to a subclass of `magical_mj.evaluation.base.BaseSettings`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magical_mj.evaluation.base import BaseSettings
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.imports import announced, imported

SETTINGS_GROUP: Final = "magical_mj.evaluation_settings"
"""The entry-point group of settings."""


def _announced() -> tuple[type[BaseSettings], ...]:
    points = announced("set of settings", SETTINGS_GROUP, (), str.isidentifier, 'mine = "package.module:MySettings"')
    return tuple(imported("set of settings", name, point, SettingsError) for name, point in points.items())


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings(*_announced(), BaseSettings):
    """The settings of `evaluate`. `magical-mj evaluate` has an option for each setting, with the same default.

    Raises:
        UnknownNameError: if a name is unknown.
        SettingsError: if a value is out of range, or settings are incompatible.
    """
