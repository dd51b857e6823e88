"""Entries: the results of one method in one file, with a card that describes it and a hash of everything."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, Final

from magical_mj import files
from magical_mj.errors import EvaluationError, SettingsError, shown, unknown_name
from magical_mj.evaluation.results import check_same
from magical_mj.evaluation.scores import SETTINGS, Score, read
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.extras import check_extra
from magical_mj.leaderboard.claims import Claim
from magical_mj.protocol import PROTOCOL
from magical_mj.registry import ENVIRONMENTS, check_rules
from magical_mj.tasks.spec import Rules

FORMAT: Final = 1
SUFFIX: Final = ".json.gz"
MOST_BYTES: Final = 500_000_000
"""The largest size of an unpacked entry in bytes: a small file may expand to a huge one."""
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


@dataclass(frozen=True)
class Entry:
    """The results of one method.

    Attributes:
        card: the description of the method; see `CARD`.
        observations: the preset of the observations; None if it used none.
        rules: the rules by which it was scored.
        protocol: the protocol's number; None if it was not recorded.
        versions: the versions of the packages with which it was played.
        episodes: all episodes.
    """

    card: dict[str, Any]
    observations: str | None
    rules: Rules
    protocol: int | None
    versions: dict[str, list[str]]
    episodes: list[Claim]

    @property
    def method(self) -> str:
        """The method's name."""
        return self.card["method"]

    @property
    def runs(self) -> list[int]:
        """The numbers of its runs."""
        return sorted({episode.run for episode in self.episodes})


def submit(
    folders: Sequence[Path | str], out: Path | str, *, card: Path | str | None = None, policy: str | None = None
) -> Entry:
    """Makes an entry from the evaluations in some folders, and writes it.

    Args:
        folders: evaluations of one method, such as one for each run.
        out: the file, whose name must end in .json.gz; an existing file is not replaced.
        card: a TOML file with fields of `CARD`; missing fields are null, and the method then has its name in the
            evaluations.
        policy: the name of the method, if the folders hold several.

    Raises:
        SettingsError, UnknownNameError: if the card has unknown fields or values of the wrong kind, or the choice of a
            method is ambiguous.
        EvaluationError: if a folder is not an evaluation, or they cannot be combined.
        OSError: if the file exists or cannot be written.
    """
    out = Path(out)
    if not out.name.endswith(SUFFIX):
        raise SettingsError(f"{out} must end in {SUFFIX}")
    said = _card({} if card is None else files.read_toml(Path(card)), card)
    found = [(score, folder) for folder in map(Path, folders) for score in read(folder)]
    names = list(dict.fromkeys(score.policy for score, _ in found))
    if policy is not None and policy not in names:
        raise unknown_name("policy", policy, names)
    if policy is None and len(names) > 1:
        raise SettingsError(f"the folders hold {', '.join(names)}: say which is meant (--policy NAME)")
    found = [(score, folder) for score, folder in found if score.policy == (policy or names[0])]
    batched = next((folder for score, folder in found if score.worlds != "single"), None)
    if batched is not None:
        raise EvaluationError(f"{batched} was played in batched worlds, and cannot be an entry: {UNOFFICIAL}")
    for what in ("rules", "preset"):
        check_same(found, what, "an entry is of one kind")
    others = {f"{score.task}-{score.variant}" for score, _ in found if (score.task, score.variant) not in ENVIRONMENTS}
    if others:
        raise EvaluationError(
            f"an entry has results in the benchmark's environments, not in {', '.join(sorted(others))}"
        )
    described = {**said, "method": said["method"] or policy or names[0]}
    _check_card(described, card)
    entry = Entry(
        card=described,
        observations=next((score.preset for score, _ in found if score.preset is not None), None),
        rules=check_rules(found[0][0].rules),
        protocol=_protocol(folders),
        versions={what: sorted({getattr(score, what) for score, _ in found}) for what in ("version", "mujoco", "gl")},
        episodes=[claim_of(score) for score, _ in found],
    )
    _check_unique(entry.episodes, "the choice of folders")
    files.write(out, packed(entry))
    return entry


def claim_of(score: Score) -> Claim:
    """The claim of an evaluated episode."""
    return Claim(
        *(score.run, score.task, score.variant, score.seed, score.scene, score.score, score.actions, score.failure)
    )


def _protocol(folders: Sequence[Path | str]) -> int | None:
    """The protocol's number that the evaluations recorded.

    Raises:
        EvaluationError: if they recorded different ones.
    """
    numbers = {recorded(Path(folder)).get("protocol") for folder in folders}
    if len(numbers) > 1:
        raise EvaluationError(f"the evaluations follow different protocols: {', '.join(map(str, numbers))}")
    return numbers.pop()


def recorded(folder: Path) -> dict[str, Any]:
    """The settings that an evaluation recorded; empty if there are none."""
    try:
        return dict(json.loads((folder / SETTINGS).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


def _card(said: dict[str, Any], where: object, known: dict[str, Any] = CARD) -> dict[str, Any]:
    """All fields of a card, with the values that are given."""
    for name in said:
        if name not in known:
            raise unknown_name(f"entry of {where}", name, known)
    whole = dict(known)
    for name, value in said.items():
        if isinstance(known[name], dict) and not isinstance(value, dict):
            raise SettingsError(f"{name} in {where} must be a table with {', '.join(known[name])}, not {shown(value)}")
        whole[name] = _card(value, where, known[name]) if isinstance(known[name], dict) else value
    return whole


def _check_card(card: dict[str, Any], where: object) -> None:
    """Raise a `SettingsError` unless the card is as the schema of entries says, which checks the leaderboard, too."""
    check_extra("entries", "eval")
    import jsonschema
    from jsonschema.exceptions import best_match

    wrong = best_match(jsonschema.Draft202012Validator(schema()["properties"]["card"]).iter_errors(card))
    if wrong is not None:
        field = ".".join(map(str, wrong.path))
        raise SettingsError(f"the card's {field} is not valid{f' in {where}' if where else ''}: {wrong.message[:200]}")
    if math.isnan(card["training"]["hours"] or 0):
        raise SettingsError(f"the card's training.hours must be a number, and is nan in {where}")


def packed(entry: Entry) -> bytes:
    """The bytes of the entry's file; equal entries have equal bytes."""
    content = {
        "format": FORMAT,
        "card": entry.card,
        "observations": entry.observations,
        "rules": entry.rules,
        "protocol": entry.protocol,
        "versions": entry.versions,
        "runs": entry.runs,
        "environments": _environments(entry.episodes),
    }
    return gzip.compress(_text({**content, "sha256": _hash(content)}).encode(), compresslevel=9, mtime=0)


def _text(content: dict[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def _hash(content: dict[str, Any]) -> str:
    return hashlib.sha256(_text(content).encode()).hexdigest()


def _environments(episodes: Sequence[Claim]) -> dict[str, list[Any]]:
    """Environment -> a row for each episode: run, seed, scene, score, actions, failure."""
    rows: dict[str, list[Any]] = {}
    for run, task, variant, seed, *rest in sorted(episodes, key=lambda episode: episode[:4]):
        rows.setdefault(f"{task}-{variant}", []).append([run, seed, *rest])
    return rows


def unpacked(data: bytes, name: object = "the entry") -> Entry:
    """The entry in a file's bytes.

    Args:
        data: the file's content.
        name: the name of the entry in errors.

    Raises:
        EvaluationError: if it is not an entry, is damaged or was altered, or has another format or protocol.
    """
    content = _content(data, name)
    _check_schema(content, name)
    if content.pop("sha256") != _hash(content):
        raise EvaluationError(f"{name} was altered after it was made: its hash is not that of its content")
    if content["protocol"] not in (None, PROTOCOL):
        raise EvaluationError(f"{name} follows protocol {content['protocol']}, and this version plays {PROTOCOL}")
    episodes = [
        Claim(run, *environment.split("-", 1), *rest)
        for environment, rows in content["environments"].items()
        for run, *rest in rows
    ]
    _check_unique(episodes, name)
    if content["runs"] != sorted({episode.run for episode in episodes}):
        raise EvaluationError(f"{name} names the runs {content['runs']}, and its episodes are of others")
    kept = {what: content[what] for what in ("card", "observations", "rules", "protocol", "versions")}
    return Entry(**kept, episodes=episodes)


def _content(data: bytes, name: object) -> dict[str, Any]:
    try:
        with gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
            text = file.read(MOST_BYTES + 1)
        if len(text) > MOST_BYTES:
            raise ValueError("it is too large")
        return json.loads(text, parse_constant=_no_number)
    except (OSError, EOFError, ValueError, RecursionError, zlib.error) as error:
        raise EvaluationError(f"{name} cannot be read: {error}") from error


def _no_number(name: str) -> None:
    """For NaN and infinities, which JSON does not have, but Python's parser reads."""
    raise ValueError(f"{name} is not JSON")


def schema() -> dict[str, Any]:
    """The JSON schema of entries."""
    return json.loads((resources("magical_mj.leaderboard") / "entry.schema.json").read_text(encoding="utf-8"))


def _check_schema(content: Any, name: object) -> None:
    import jsonschema
    from jsonschema.exceptions import best_match

    wrong = best_match(jsonschema.Draft202012Validator(schema()).iter_errors(content))
    if wrong is not None:
        raise EvaluationError(f"{name} does not follow the schema at {wrong.json_path}: {wrong.message[:200]}")
    for environment in content["environments"]:
        if tuple(environment.split("-", 1)) not in ENVIRONMENTS:
            raise EvaluationError(f"{name} has results in {environment}, which is no environment")


def _check_unique(episodes: Sequence[Claim], name: object) -> None:
    seen: set[tuple[Any, ...]] = set()
    for episode in episodes:
        if episode[:4] in seen:
            raise EvaluationError(f"{name} holds an episode twice: {episode}")
        seen.add(episode[:4])
