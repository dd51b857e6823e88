"""What is known about the training of a policy. Files that say it may come from an untrusted source."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from msgspec import Struct
from msgspec.structs import asdict

from magical_mj.tasks.registry import EVERY_VARIANT
from magical_mj.utils.errors import SettingsError, as_integer, short_repr
from magical_mj.utils.files import read_toml
from magical_mj.utils.settings import LARGEST_SETTING

CONFIG: Final = "config.toml"
"""The file with the settings of a training in its folder."""
SETTINGS: Final = {
    ("demos", "set"): "demonstration_set",
    ("reward", "variant"): "played_in",
    ("made", "played_in"): "played_in",
    ("made", "other_tasks"): "other_tasks",
}
"""A setting of a run, as (table, name) -> its field of `Learnt`. If two are for one field, the later one counts."""


class Learnt(Struct, frozen=True, omit_defaults=True):
    """The data that a policy's training used, and whether it has ended, as far as it is known.

    Attributes:
        demonstration_set: the set of the package's demonstrations.
        played_in: the variants of the scenes that it was trained in, separated by commas.
        other_tasks: tasks that it cannot play, but that its encoder or its reward was trained on.
        unfinished: where its training stopped before its end, such as "update 225 of 3000"; otherwise empty.

    Raises:
        SettingsError: if a value is not as described.
    """

    demonstration_set: int = 1
    played_in: str = "Demo"
    other_tasks: list[str] = []
    unfinished: str = ""

    def __post_init__(self) -> None:
        number = self.demonstration_set
        if not isinstance(number, int) or as_integer(number, 1, LARGEST_SETTING) is None:
            raise SettingsError(f"demonstration_set must be a number of a set, not {short_repr(number)}")
        check_variants(self.played_in, "played_in")
        check_tasks(self.other_tasks, "other_tasks")
        if self.unfinished and not re.fullmatch(r"\w+ \d{1,12} of \d{1,12}", self.unfinished):
            raise SettingsError(f"unfinished must be such as 'update 225 of 3000', not {short_repr(self.unfinished)}")


def learnt_from(origin: object, policy: object = None) -> Learnt:
    """What a policy's training used.

    Args:
        origin: the policy's origin. If it is the folder of a training, its settings decide, as far as they say it.
        policy: the policy. Otherwise, the record is its attribute `learnt`, if it has one.

    Raises:
        SettingsError: if `learnt` is not a `Learnt`, or the settings are not as described there.
    """
    learnt = getattr(policy, "learnt", UNKNOWN)
    if not isinstance(learnt, Learnt):
        raise SettingsError(
            f"learnt of a policy must be a magical_mj.policies.facts.Learnt, such as Learnt(demonstration_set=2), not "
            f"{short_repr(learnt)}"
        )
    path = Path(origin) / CONFIG if isinstance(origin, str | os.PathLike) else Path()
    if not path.is_file():
        return learnt
    facts, settings = asdict(learnt), read_toml(path)
    for (table, name), fact in SETTINGS.items():
        known = settings.get(table)
        if isinstance(known, dict) and name in known:
            facts[fact] = known[name]
    try:
        return Learnt(**facts)
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def from_texts(texts: Mapping[str, str], path: Path) -> Learnt:
    """The record in the metadata of an ONNX file, where each fact is a text."""
    number = texts.get("demonstration_set", "")
    try:
        return Learnt(
            int(number) if number.isdecimal() else 1,
            texts.get("played_in", "Demo"),
            texts.get("other_tasks", "").splitlines(),
            texts.get("unfinished", ""),
        )
    except SettingsError as error:
        raise SettingsError(f"{path}: {error}") from None


def check_variants(value: object, where: str) -> None:
    """Raises a `SettingsError` unless the value has variants, separated by commas."""
    if not isinstance(value, str) or not set(value.split(",")) <= set(EVERY_VARIANT):
        raise SettingsError(f"{where} must be variants, separated by commas, not {short_repr(value)}")


def check_tasks(value: object, where: str) -> None:
    """Raises a `SettingsError` unless the value has names of tasks, which need not exist here."""
    if not isinstance(value, list | tuple) or not all(isinstance(task, str) and task for task in value):
        raise SettingsError(f"{where} must be a list of tasks, not {short_repr(value)}")


UNKNOWN: Final = Learnt()
"""Of policies that do not say what their training used."""
