"""Settings as plain TOML."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from magical_mj.baselines.settings import TrainingSettings, changed
from magical_mj.errors import SettingsError


def to_toml(settings: TrainingSettings) -> str:
    """All settings; `from_toml` reads them back."""
    plain, tables = [], []
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value):
            lines = [f"{inner.name} = {_value(getattr(value, inner.name))}" for inner in fields(value)]
            tables.append("\n".join([f"[{item.name}]", *lines]))
        else:
            plain.append(f"{item.name} = {_value(value)}")
    return "\n\n".join(["\n".join(plain), *tables]) + "\n"


def from_toml(path: Path) -> TrainingSettings:
    """The settings in a file.

    Raises:
        SettingsError, UnknownNameError: if it is not TOML, or holds what cannot be.
    """
    table = read_toml(path)
    if "method" not in table or "tasks" not in table:
        raise SettingsError(f"{path} must give a method and tasks")
    return changed(TrainingSettings(table.pop("method"), tuple(table.pop("tasks"))), flattened(table))


def read_toml(path: Path) -> dict[str, Any]:
    """What is in a TOML file; a `SettingsError` if it is none."""
    try:
        return tomllib.loads(path.read_text())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise SettingsError(f"{path} cannot be read as TOML: {error}") from error


def flattened(table: dict[str, Any]) -> dict[str, Any]:
    """By name, those of sub-tables with dots."""
    flat = {}
    for name, value in table.items():
        flat |= {f"{name}.{inner}": kept for inner, kept in value.items()} if isinstance(value, dict) else {name: value}
    return flat


def _value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    return json.dumps(value) if isinstance(value, str) else repr(value)
