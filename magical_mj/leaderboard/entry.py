"""Entries: the results of one method in one file, with a card that describes it and a hash of everything."""

from __future__ import annotations

import hashlib
import json
import lzma
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files as resources
from pathlib import Path
from typing import Any, Final, Literal, NoReturn

from magical_mj.leaderboard.claims import SEEDS, Claim
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import EvaluationError

FORMAT: Final = 2
FIELDS: Final = tuple(field for field in Claim._fields if field not in ("task", "variant"))
"""The fields of an episode in a file, which holds one list of each for an environment: values of one kind compress best
side by side."""
SUFFIX: Final = ".json.xz"
MOST_BYTES: Final = 60_000_000
"""The largest size of an unpacked entry in bytes: a small file may expand to a huge one."""
_MEMORY: Final = 100_000_000
"""How much memory in bytes unpacking may take: a file says how much it wants. Ours need 66 MB."""


def entries(folder: Path | str) -> list[Path]:
    """The files of entries in a folder, sorted by name; or the one file that is given instead.

    Raises:
        EvaluationError: if there are none.
    """
    found = [Path(folder)] if Path(folder).is_file() else sorted(Path(folder).glob(f"*{SUFFIX}"))
    if not found:
        raise EvaluationError(f"{folder} holds no entries (*{SUFFIX}); magical-mj submit makes them")
    return found


@dataclass(frozen=True)
class Entry:
    """The results of one method.

    Attributes:
        card: the description of the method; see `magical_mj.leaderboard.submission.CARD`.
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

    @property
    def counted(self) -> list[Claim]:
        """The episodes that count: those in the scenes that the protocol requires."""
        return [episode for episode in self.episodes if episode.seed < SEEDS]


def packed(entry: Entry) -> bytes:
    """The bytes of the entry's file; equal entries have equal bytes.

    Raises:
        EvaluationError: if they are so many that nobody would read them again.
    """
    content = {
        "format": FORMAT,
        "card": entry.card,
        "observations": entry.observations,
        "rules": entry.rules,
        "protocol": entry.protocol,
        "versions": entry.versions,
        "runs": entry.runs,
        "episodes": _columns(entry.episodes),
    }
    text = _text({**content, "sha256": _hash(content)}).encode()
    if len(text) > MOST_BYTES:
        raise EvaluationError(
            f"an entry has {MOST_BYTES / 1e6:.0f} MB at most, and this {len(text) / 1e6:.0f}: take fewer runs"
        )
    return lzma.compress(text, preset=9 | lzma.PRESET_EXTREME)  # a sixth smaller than with gzip


def _text(content: dict[str, Any]) -> str:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False)


def _hash(content: dict[str, Any]) -> str:
    return hashlib.sha256(_text(content).encode()).hexdigest()


def _columns(episodes: Sequence[Claim]) -> dict[str, dict[str, list[Any]]]:
    """Field -> environment -> that field of its episodes."""
    columns: dict[str, dict[str, list[Any]]] = {field: {} for field in FIELDS}
    for episode in sorted(episodes, key=lambda episode: episode[:4]):
        for field, column in columns.items():
            column.setdefault(f"{episode.task}-{episode.variant}", []).append(getattr(episode, field))
    return columns


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
    columns = content["episodes"]
    episodes = [
        Claim(run, *environment.split("-", 1), *rest)
        for environment in columns["run"]
        for run, *rest in zip(*(columns[field][environment] for field in FIELDS), strict=True)
    ]
    check_unique(episodes, name)
    if content["runs"] != sorted({episode.run for episode in episodes}):
        raise EvaluationError(f"{name} names the runs {content['runs']}, and its episodes are of others")
    kept = {what: content[what] for what in ("card", "observations", "rules", "protocol", "versions")}
    return Entry(**kept, episodes=episodes)


def _content(data: bytes, name: object) -> dict[str, Any]:
    try:
        file = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
        text = file.decompress(data, MOST_BYTES + 1)
        if len(text) > MOST_BYTES:
            raise ValueError("it is too large")
        if not file.eof or file.unused_data:
            raise ValueError("it is cut short" if not file.eof else "something follows its end")
        content = json.loads(text, parse_constant=_no_number, parse_float=_finite)
        _text(content).encode()  # raises an error for half a character, which JSON can name and UTF-8 cannot hold
    except (ValueError, RecursionError, lzma.LZMAError) as error:
        raise EvaluationError(f"{name} cannot be read: {error}") from error
    return content


def _no_number(name: str) -> NoReturn:
    """For NaN and infinities, which JSON does not have, but Python's parser reads."""
    raise ValueError(f"{name} is not a finite number")


def _finite(digits: str) -> float:
    """A number; those like 1e999 are too large for Python's, and would be infinite."""
    number = float(digits)
    return number if math.isfinite(number) else _no_number(digits)


def violation(content: Any, what: Literal["entry", "card"]) -> str:
    """How content violates the JSON schema of entries, or of their cards; empty if it does not."""
    from fastjsonschema import JsonSchemaValueException

    try:
        _schema(what)(content, name_prefix=what)
    except JsonSchemaValueException as error:
        return error.message[:200]
    return ""


@cache
def _schema(what: str) -> Callable[..., Any]:
    """Raises an error for content that violates it."""
    import fastjsonschema

    text = (resources("magical_mj.leaderboard") / "entry.schema.json").read_text(encoding="utf-8")
    schema = json.loads(text)
    return fastjsonschema.compile(schema if what == "entry" else schema["properties"]["card"])


def _check_schema(content: Any, name: object) -> None:
    if wrong := violation(content, "entry"):
        raise EvaluationError(f"{name} does not follow the schema: {wrong}")
    method = content["card"]["method"]
    if not is_readable(method):
        raise EvaluationError(f"{name} has a method whose name {method!r} {UNREADABLE}")
    columns = content["episodes"]
    for environment in sorted({environment for column in columns.values() for environment in column}):
        if tuple(environment.split("-", 1)) not in ENVIRONMENTS:
            raise EvaluationError(f"{name} has results in {environment}, which is no environment")
        lengths = {field: len(columns[field].get(environment, ())) for field in FIELDS}
        if len(set(lengths.values())) > 1:
            counts = ", ".join(f"{field} {length}" for field, length in lengths.items())
            raise EvaluationError(f"{name} has not all fields of all episodes in {environment}: {counts}")
        numbers = columns["run"][environment] + columns["seed"][environment]
        if any(type(number) is not int for number in numbers):  # to the schema, 1.0 is an integer
            raise EvaluationError(f"{name} has runs or seeds in {environment} that are not written as integers")


UNREADABLE: Final = "holds signs that cannot be seen, or begins or ends with a space"


def is_readable(name: str) -> bool:
    """Whether the name of a method looks like what it is."""
    return name.isprintable() and name == name.strip()


def check_unique(episodes: Sequence[Claim], name: object, remedy: str = "") -> None:
    """Raises an `EvaluationError`, which ends with `remedy`, if an episode appears twice."""
    seen: set[tuple[Any, ...]] = set()
    for episode in episodes:
        if episode[:4] in seen:
            raise EvaluationError(f"{name} holds an episode twice: {episode}{remedy}")
        seen.add(episode[:4])
