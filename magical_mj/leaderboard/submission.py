"""Entries from evaluations: `magical-mj submit`."""

from __future__ import annotations

import math
import shlex
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.scores import EpisodeResult, folders_of, read
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.leaderboard.claims import claim_of
from magical_mj.leaderboard.entry import (
    SUFFIX,
    UNREADABLE,
    Entry,
    check_unique,
    is_readable,
    packed,
    unpacked,
    violation,
)
from magical_mj.leaderboard.record import digests, protocol_of
from magical_mj.tasks.registry import ENVIRONMENTS, check_rules
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, check_name, shown
from magical_mj.utils.extras import check_extra

CARD: Final[dict[str, Any]] = {
    "method": None,
    "description": None,
    "authors": None,
    "links": None,
    "demonstrations": {"set": None, "per_task": None, "other": None},
    "training": {"hours": None, "device": None, "steps": None},
    "hardware": None,
}
"""The fields of a card; fields that are not given are null."""


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
        card: a TOML file with fields of `CARD`; missing fields are null, and the method then has its name in the
            evaluations.
        policy: the name of the method in the folders, if they hold several, or if the earlier entry calls it otherwise.
        extend: an earlier entry of the same method, whose episodes are taken over, and its card if none is given.

    Raises:
        SettingsError, UnknownNameError: if the card has unknown fields or values of the wrong kind, or the choice of a
            method is ambiguous.
        EvaluationError: if a folder is not an evaluation, or they cannot be combined.
        OSError: if the file exists or cannot be written, or the earlier entry cannot be read.
    """
    out = Path(out)
    if not out.name.endswith(SUFFIX):
        raise SettingsError(f"{out} must end in {SUFFIX}")
    folders = folders_of(folders)
    if not folders:
        raise SettingsError("give at least one folder of an evaluation")
    said = _card({} if card is None else files.read_toml(Path(card)), card)
    found = [(score, folder) for folder in folders for score in read(folder)]
    names = list(dict.fromkeys(score.policy for score, _ in found))
    if policy is not None:
        check_name("policy", policy, names)
    if policy is None and len(names) > 1:
        raise SettingsError(
            f"the folders hold {', '.join(names)}: say which one is meant (--policy NAME); if they are runs of one "
            "method, evaluate them again under its name, as in evaluate --policy BC=runs/a,BC=runs/b"
        )
    found = [(score, folder) for score, folder in found if score.policy == (policy or names[0])]
    _check_trainings(folders, policy or names[0])
    described = {**said, "method": said["method"] or policy or names[0]}
    _check_card(described, card)
    entry = _entry(described, found, _protocol(folders))
    if extend is not None:
        earlier = unpacked(Path(extend).read_bytes(), extend)
        if earlier.method != entry.method and said["method"] is None and policy is None:
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


def _entry(card: dict[str, Any], found: Sequence[tuple[EpisodeResult, Path]], protocol: int | None) -> Entry:
    """The entry of one method's scores, which must be of one kind and in the benchmark's environments."""
    batched = next((folder for score, folder in found if score.worlds != "single"), None)
    if batched is not None:
        raise EvaluationError(f"{batched} was played in batched worlds, and cannot be an entry: {UNOFFICIAL}")
    for what in ("rules", "preset"):
        _check_same(found, what)
    seen = {score.preset is None: folder for score, folder in found}
    if len(seen) > 1:
        raise EvaluationError(
            f"the policy in {seen[True]} saw the simulation instead of pictures or states, unlike that in "
            f"{seen[False]}; an entry is of one kind"
        )
    others = {f"{score.task}-{score.variant}" for score, _ in found if (score.task, score.variant) not in ENVIRONMENTS}
    if others:
        raise EvaluationError(
            f"an entry has results in the benchmark's environments, not in {', '.join(sorted(others))}"
        )
    return Entry(
        card=card,
        observations=next((score.preset for score, _ in found if score.preset is not None), None),
        rules=check_rules(found[0][0].rules),
        protocol=protocol,
        versions={what: sorted({getattr(score, what) for score, _ in found}) for what in ("version", "mujoco", "gl")},
        episodes=[claim_of(score) for score, _ in found],
    )


def _check_same(found: Sequence[tuple[EpisodeResult, Path]], what: str) -> None:
    """Raises an `EvaluationError` unless this attribute is the same in all scores; None matches anything."""
    where: dict[str, Path] = {}
    for score, folder in found:
        if getattr(score, what) is not None:
            where.setdefault(getattr(score, what), folder)
    if len(where) > 1:
        kinds = ", ".join(f"{name} in {folder}" for name, folder in where.items())
        raise EvaluationError(f"different {what}: {kinds}; an entry is of one kind")


def _extended(earlier: Entry, added: Entry, name: object, *, keep_card: bool) -> Entry:
    """The episodes of both."""
    for what in ("observations", "rules", "protocol"):
        before, now = getattr(earlier, what), getattr(added, what)
        if before != now:
            raise EvaluationError(f"{name} cannot be extended by these folders: {what} is {before} there, {now} here")
    return Entry(
        card=earlier.card if keep_card else added.card,
        observations=added.observations,
        rules=added.rules,
        protocol=added.protocol,
        versions={what: sorted({*earlier.versions[what], *found}) for what, found in added.versions.items()},
        episodes=[*earlier.episodes, *added.episodes],
    )


def _check_trainings(folders: Sequence[Path | str], method: str) -> None:
    """Raise an `EvaluationError` if two runs played with equal policies: a run is a training of its own."""
    runs: dict[str, set[int]] = defaultdict(set)
    for folder in folders:
        for run, digest in digests(Path(folder), method):
            runs[digest].add(run)
    for digest, same in runs.items():
        if len(same) > 1:
            raise EvaluationError(
                f"the runs {', '.join(map(str, sorted(same)))} of {method} played with equal policies (sha256 "
                f"{digest[:12]}...), which count as one run: leave the others out"
            )


def _protocol(folders: Sequence[Path | str]) -> int | None:
    """The protocol's number that the evaluations recorded.

    Raises:
        EvaluationError: if they recorded different ones, or something else.
    """
    numbers = {protocol_of(Path(folder)) for folder in folders}
    if len(numbers) > 1:
        raise EvaluationError(f"the evaluations follow different protocols: {', '.join(map(str, numbers))}")
    return numbers.pop()


def _card(said: dict[str, Any], where: object, known: dict[str, Any] = CARD) -> dict[str, Any]:
    """All fields of a card, with the values that are given."""
    for name in said:
        check_name(f"entry of {where}", name, known)
    whole = dict(known)
    for name, value in said.items():
        if isinstance(known[name], dict) and not isinstance(value, dict):
            raise SettingsError(f"{name} in {where} must be a table with {', '.join(known[name])}, not {shown(value)}")
        whole[name] = _card(value, where, known[name]) if isinstance(known[name], dict) else value
    return whole


def _check_card(card: dict[str, Any], where: object) -> None:
    """Raise a `SettingsError` unless the card is as the schema of entries says, which checks the leaderboard, too."""
    check_extra("entries", "eval")
    if wrong := violation(card, "card"):
        raise SettingsError(f"the card is not valid{f' in {where}' if where else ''}: {wrong}")
    if not is_readable(card["method"]):
        raise SettingsError(f"the card's method {card['method']!r} {UNREADABLE}{f' in {where}' if where else ''}")
    hours = card["training"]["hours"]
    if isinstance(hours, float) and not math.isfinite(hours):
        raise SettingsError(f"the card's training.hours must be a finite number, and is {hours} in {where}")
