"""Entries from evaluations: `magical-mj submit`."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from operator import index
from pathlib import Path
from typing import Any

import msgspec

from magical_mj.evaluation.scores import SETTINGS, EpisodeResult, folders_of, read
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.leaderboard.check import recorded_settings
from magical_mj.leaderboard.entry import (
    SUFFIX,
    Card,
    Demonstrations,
    Entry,
    Training,
    Versions,
    check_method,
    check_unique,
    packed,
    read_entry,
)
from magical_mj.tasks.registry import ENVIRONMENTS, check_rules
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, check_name, short_repr

Source = tuple[EpisodeResult, Path]
"""An episode and the folder that holds it."""


def submit(
    folders: Iterable[Path | str],
    out: Path | str,
    *,
    card: Path | str | None = None,
    policy: str | None = None,
    extend: Path | str | None = None,
) -> Entry:
    """Makes an entry from the evaluations in some folders, and writes it.

    Args:
        folders: evaluations of one method, such as one for each run.
        out: the file, whose name must end in .json.xz; an existing file is not replaced.
        card: a TOML file with fields of `Card`, all optional; the method has its name in the evaluations otherwise.
        policy: the name of the method in the folders, if they hold several, or if the earlier entry calls it otherwise.
        extend: an earlier entry of the same method, whose episodes are taken over, and its card if none is given.

    Raises:
        SettingsError, UnknownNameError: if the card has unknown fields or values of the wrong kind, or the choice of a
            method is ambiguous.
        EvaluationError: if a folder is not an evaluation, the earlier entry not one, or they cannot be combined.
        OSError: if the file exists or cannot be written.
    """
    out = Path(out)
    if not out.name.endswith(SUFFIX):
        raise SettingsError(f"{out} must end in {SUFFIX}")
    folders = folders_of(folders)
    if not folders:
        raise SettingsError("give at least one folder of an evaluation")
    said = {} if card is None else files.read_toml(Path(card))
    sources = [(episode, folder) for folder in folders for episode in read(folder)]
    names = list(dict.fromkeys(episode.policy for episode, _ in sources))
    if policy is not None:
        check_name("policy", policy, names)
    elif len(names) > 1:
        raise SettingsError(
            f"the folders hold {', '.join(names)}: say which one is meant (--policy NAME); if they are runs of one "
            "method, evaluate them again under its name, as in evaluate --policy BC=runs/a,BC=runs/b"
        )
    name = policy or names[0]
    _check_trainings(folders, name)
    entry = _entry(
        _card({"method": name, **said}, card), [source for source in sources if source[0].policy == name], folders
    )
    if extend is not None:
        earlier = read_entry(extend)
        if earlier.method != entry.method and "method" not in said and policy is None:
            raise SettingsError(
                f"{extend} is of {earlier.method!r}, and the folders hold {entry.method!r}: if these are the same "
                f"method, say so (--policy {shlex.quote(entry.method)}, or a card with its name)"
            )
        entry = _extended(earlier, entry, extend, keep_card=card is None)
    where = "the choice of folders" if extend is None else f"{extend} with these folders"
    check_unique(entry.episodes, where, "; if these are two runs, evaluate one of them again with another --run")
    out.parent.mkdir(parents=True, exist_ok=True)
    files.write(out, packed(entry))
    return entry


def _card(said: Mapping[str, Any], where: object) -> Card:
    """The card that a TOML file describes; raises a `SettingsError` or an `UnknownNameError` if it is not valid."""
    for fields, kind in ((said, Card), (said.get("demonstrations"), Demonstrations), (said.get("training"), Training)):
        for name in fields if isinstance(fields, Mapping) else ():
            check_name(f"entry of {where}", name, kind.__struct_fields__)
    try:
        card = msgspec.convert(said, Card)
        check_method(card, where)
    except (msgspec.ValidationError, EvaluationError) as error:
        raise SettingsError(f"the card is not valid{f' in {where}' if where else ''}: {error}") from None
    return card


def _entry(card: Card, sources: Sequence[Source], folders: Sequence[Path]) -> Entry:
    """The entry of one method's episodes, which must be of one kind and in the benchmark's environments."""
    for episode, folder in sources:
        if episode.worlds != "single":
            raise EvaluationError(f"{folder} was played in batched worlds, and cannot be an entry: {UNOFFICIAL}")
        if (episode.task, episode.variant) not in ENVIRONMENTS:
            raise EvaluationError(
                f"an entry has results in the benchmark's environments, not in {short_repr(episode.task)} "
                f"{short_repr(episode.variant)}, as {folder} has"
            )
    rules = _common("rules", {episode.rules: folder for episode, folder in sources})
    preset = _common("preset", {episode.preset: folder for episode, folder in sources})
    protocol = _common("protocol", {_protocol(folder): folder for folder in folders})
    versions = {what: sorted({getattr(episode, what) for episode, _ in sources}) for what in Versions.__struct_fields__}
    episodes = [episode for episode, _ in sources]
    return Entry(card, preset, check_rules(rules), protocol, Versions(**versions), episodes)


def _common(what: str, folders: Mapping[Any, Path]) -> Any:
    """The one value that a setting has in all folders.

    Args:
        what: the setting.
        folders: value -> a folder with it.
    """
    if len(folders) > 1:
        values = ", ".join(f"{value or 'none'} in {folder}" for value, folder in folders.items())
        raise EvaluationError(f"different {what}: {values}; an entry is of one kind")
    (value,) = folders
    return value


def _protocol(folder: Path) -> int | None:
    """The protocol's number that an evaluation recorded; None if there is none."""
    number = recorded_settings(folder).get("protocol")
    if number is not None and (type(number) is not int or number < 1):
        raise EvaluationError(
            f"the protocol in {folder / SETTINGS} must be a number such as 1, and is {short_repr(number)}: "
            "evaluate again"
        )
    return number


def _extended(earlier: Entry, added: Entry, name: object, *, keep_card: bool) -> Entry:
    """The episodes of both."""
    for what in ("observations", "rules", "protocol"):
        before, now = getattr(earlier, what), getattr(added, what)
        if before != now:
            raise EvaluationError(f"{name} cannot be extended by these folders: {what} is {before} there, {now} here")
    versions = {
        what: sorted({*getattr(earlier.versions, what), *getattr(added.versions, what)})
        for what in Versions.__struct_fields__
    }
    return msgspec.structs.replace(
        added,
        card=earlier.card if keep_card else added.card,
        versions=Versions(**versions),
        episodes=[*earlier.episodes, *added.episodes],
    )


def _check_trainings(folders: Sequence[Path], method: str) -> None:
    """Raise an `EvaluationError` if two runs played with equal policies: a run is a training of its own."""
    runs: dict[str, set[int]] = defaultdict(set)
    for folder in folders:
        try:
            for policy in recorded_settings(folder)["policies"]:
                if policy["name"] == method and "sha256" in policy:
                    runs[str(policy["sha256"])].add(index(policy["run"]))
        except (KeyError, TypeError):
            continue
    for digest, same in runs.items():
        if len(same) > 1:
            raise EvaluationError(
                f"the runs {', '.join(map(str, sorted(same)))} of {method} played with equal policies (sha256 "
                f"{digest[:12]}...), which count as one run: leave the others out"
            )
