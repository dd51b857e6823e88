"""The settings of a training as TOML, as in a run's config.toml."""

from __future__ import annotations

import json
import tomllib
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Final

from magical_mj.learners.method_settings import changed, parts_of
from magical_mj.learners.settings import TrainingSettings
from magical_mj.tasks.registry import TASKS, listed
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import check_named

MADE: Final = "made"
"""The table of a config.toml that says when and with what a run was started; no setting."""


def to_toml(settings: TrainingSettings) -> str:
    """The settings that the method uses, as TOML; `from_toml` reads them."""
    plain, tables, parts = [], [], parts_of(settings.method)
    for item in fields(settings):
        value = getattr(settings, item.name)
        if is_dataclass(value) and item.name in parts:
            lines = [f"{inner.name} = {toml_value(getattr(value, inner.name))}" for inner in fields(value)]
            tables.append("\n".join([f"[{item.name}]", *lines]))
        elif not is_dataclass(value):
            plain.append(f"{item.name} = {toml_value(value)}")
    return "\n\n".join(["\n".join(plain), *tables]) + "\n"


def recorded(settings: TrainingSettings) -> dict[str, Any]:
    """Name -> value for everything that `to_toml` writes; names of nested parts contain dots."""
    return flattened(tomllib.loads(to_toml(settings)))


def from_toml(path: Path) -> TrainingSettings:
    """The settings in a file.

    Raises:
        SettingsError, UnknownNameError: if it is not TOML, or holds invalid settings.
        UntrustedNameError: if it names the code of a task that the user has not named.
    """
    table = read_toml(path)
    if not isinstance(table.pop(MADE, {}), dict):
        raise SettingsError(f"{MADE} in {path} must be a table, as a training writes it; remove it")
    if "method" not in table or "tasks" not in table:
        raise SettingsError(f"{path} must give a method and tasks")
    method, tasks = table.pop("method"), tuple(listed(table.pop("tasks"), TASKS))
    for task in tasks:
        check_named(task, path)
    return changed(TrainingSettings(method, tasks), flattened(table))


def flattened(table: dict[str, Any]) -> dict[str, Any]:
    """Name -> value; names in sub-tables contain dots."""
    flat = {}
    for name, value in table.items():
        flat |= {f"{name}.{inner}": kept for inner, kept in value.items()} if isinstance(value, dict) else {name: value}
    return flat


def toml_value(value: Any) -> str:
    """A value as TOML."""
    if isinstance(value, tuple):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return _quoted(value) if isinstance(value, str) else json.dumps(value) if isinstance(value, bool) else repr(value)


def _quoted(text: str) -> str:
    """A text as TOML. What cannot be encoded, such as bytes of a file's name that are no UTF-8, is escaped twice."""
    plain = text.encode(errors="backslashreplace").decode()
    return json.dumps(plain, ensure_ascii=False).replace("\x7f", "\\u007f")
