"""Entries: the evaluations of one method in one file, with a card that describes it and a hash of everything."""

from __future__ import annotations

import hashlib
import json
import lzma
import re
from collections import defaultdict
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta, Struct

from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.tasks.spec import Rules
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, short_repr

FORMAT: Final = 2
SUFFIX: Final = ".json.xz"
SEEDS: Final = 100
"""The number of episodes in each environment that the protocol requires."""
MOST_BYTES: Final = 20_000_000
"""The largest size of an entry's file in bytes. Ours have 2 MB at most."""
MOST_UNPACKED: Final = 60_000_000
"""The largest size of an unpacked entry in bytes: a small file may expand to a huge one. Ours have 6 MB."""
MOST_VALUES: Final = 2_000_000
"""The largest number of values in an entry: small ones take ten times as much memory as their text. Ours have 180,000:
six for each of 30,000 episodes."""
_MEMORY: Final = 100_000_000
"""How much memory in bytes unpacking may take: a file says how much it wants. Ours need 66 MB."""

Natural = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
Name = Annotated[str, Meta(max_length=80)]
Line = Annotated[str, Meta(max_length=500)]


class Demonstrations(Struct, forbid_unknown_fields=True):
    """What was learnt from: the number of the shipped set, how many of each task, anything else."""

    set: Positive | None = None
    per_task: Natural | None = None
    other: Line | None = None


class Training(Struct, forbid_unknown_fields=True):
    """What one run cost: hours on the device, and environment steps."""

    hours: Annotated[float, Meta(ge=0, le=1e9)] | Natural | None = None
    device: Annotated[str, Meta(max_length=200)] | None = None
    steps: Natural | None = None


class Card(Struct, forbid_unknown_fields=True):
    """The description of a method; what was not said is None."""

    method: Annotated[str, Meta(pattern=r"^[^<>|`\[\]\x00-\x1f\u2020\u2605\u2b50]{1,80}$(?!\n)")]
    description: Annotated[str, Meta(max_length=2000)] | None = None
    authors: Line | None = None
    links: Annotated[list[Annotated[str, Meta(pattern="^https?://")]], Meta(max_length=10)] | None = None
    demonstrations: Demonstrations = msgspec.field(default_factory=Demonstrations)
    training: Training = msgspec.field(default_factory=Training)
    hardware: Line | None = None


class Versions(Struct, forbid_unknown_fields=True):
    """The versions of this package and of MuJoCo, and the OpenGL backends, with which the episodes were played."""

    version: Annotated[list[Name], Meta(min_length=1)]
    mujoco: Annotated[list[Name], Meta(min_length=1)]
    gl: Annotated[list[Name], Meta(min_length=1)]


class Columns(Struct, forbid_unknown_fields=True):
    """The episodes: field -> environment, such as "FindDupe-All" -> a value for each, in the same order in all fields.

    Values of one kind compress best side by side.
    """

    run: dict[str, list[Natural]]
    seed: dict[str, list[Natural]]
    scene: dict[str, list[Annotated[str, Meta(pattern=r"^[0-9a-f]{16}$(?!\n)")] | None]]
    score: dict[str, list[Annotated[float, Meta(ge=0, le=1)]]]
    actions: dict[str, list[Annotated[str, Meta(pattern=r"^[a-r]*$(?!\n)")]]]
    failure: dict[str, list[Annotated[str, Meta(max_length=300)] | None]]


class Content(Struct, forbid_unknown_fields=True):
    """What the file holds, as JSON with sorted keys, compressed by xz. `sha256` is of all else in the same form."""

    format: Literal[2]
    card: Card
    observations: Annotated[str, Meta(pattern=r"^[0-9A-Za-z]{0,80}$(?!\n)")] | None
    rules: Rules
    protocol: Positive | None
    versions: Versions
    runs: Annotated[list[Natural], Meta(min_length=1)]
    episodes: Columns
    sha256: str


class Entry(Struct, frozen=True):
    """The results of one method.

    Attributes:
        card: the description of the method.
        observations: the preset of the observations; None if it used none.
        rules: the rules by which it was scored.
        protocol: the protocol's number; None if it was not recorded.
        versions: what it was played with.
        episodes: all episodes. Those from a file have no duration, and no versions of their own.
    """

    card: Card
    observations: str | None
    rules: Rules
    protocol: int | None
    versions: Versions
    episodes: list[EpisodeResult]

    @property
    def method(self) -> str:
        """The method's name."""
        return self.card.method

    @property
    def runs(self) -> list[int]:
        """The numbers of its runs."""
        return sorted({episode.run for episode in self.episodes})

    @property
    def counted(self) -> list[EpisodeResult]:
        """The episodes that count: those in the scenes that the protocol requires."""
        return [episode for episode in self.episodes if episode.seed < SEEDS]


def entry_files(folder: Path | str) -> list[Path]:
    """The files of entries in a folder, sorted by name; or the one file that is given instead.

    Raises:
        EvaluationError: if there are none.
    """
    paths = [Path(folder)] if Path(folder).is_file() else sorted(Path(folder).glob(f"*{SUFFIX}"))
    if not paths:
        raise EvaluationError(f"{folder} holds no entries (*{SUFFIX}); magical-mj submit makes them")
    return paths


def read_entry(path: Path | str) -> Entry:
    """The entry in a file, which may be anybody's.

    Raises:
        EvaluationError: if it is not an entry, is too large, damaged or was altered, or has another format or protocol.
    """
    try:
        return unpacked(files.read_foreign(Path(path), most=MOST_BYTES, error=EvaluationError), path)
    except OSError as error:
        raise EvaluationError(f"{path} cannot be read: {error.strerror}") from error


def packed(entry: Entry) -> bytes:
    """The bytes of the entry's file; equal entries have equal bytes.

    Raises:
        EvaluationError: if they are so many that nobody would read them again.
    """
    columns: dict[str, dict[str, list[Any]]] = {field: defaultdict(list) for field in Columns.__struct_fields__}
    for episode in sorted(entry.episodes, key=attrgetter("run", "task", "variant", "seed")):
        for field, column in columns.items():
            column[f"{episode.task}-{episode.variant}"].append(getattr(episode, field))
    kept = {name: msgspec.to_builtins(getattr(entry, name)) for name in Entry.__struct_fields__}
    content = {**kept, "format": FORMAT, "runs": entry.runs, "episodes": columns}
    text = _text({**content, "sha256": _hash(_text(content))})
    if len(text) > MOST_UNPACKED:
        raise EvaluationError(
            f"an entry has {MOST_UNPACKED / 1e6:.0f} MB at most, and this {len(text) / 1e6:.0f}: take fewer runs"
        )
    return lzma.compress(text, preset=9 | lzma.PRESET_EXTREME)  # a sixth smaller than with gzip


def _text(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def _hash(text: bytes) -> str:
    return hashlib.sha256(text).hexdigest()


def unpacked(data: bytes, name: object = "the entry") -> Entry:
    """The entry in a file's bytes; see `read_entry`.

    Args:
        data: the file's content.
        name: the name of the entry in errors.
    """
    text = _decompressed(data, name)
    try:
        content = msgspec.json.decode(text, type=Content)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise EvaluationError(f"{name} is no entry: {str(error)[:200]}") from error
    if content.sha256 != _hash(re.sub(rb',"sha256":"[^"]*"(?=,"versions":\{[^{]*$)', b"", text)):
        raise EvaluationError(f"{name} was altered after it was made: its hash is not that of its content")
    if content.protocol not in (None, PROTOCOL):
        raise EvaluationError(f"{name} follows protocol {content.protocol}, and this version plays {PROTOCOL}")
    check_method(content.card, name)
    episodes = _episodes(content, name)
    check_unique(episodes, name)
    if content.runs != sorted({episode.run for episode in episodes}):
        raise EvaluationError(f"{name} names the runs {content.runs}, and its episodes are of others")
    return Entry(content.card, content.observations, content.rules, content.protocol, content.versions, episodes)


def _decompressed(data: bytes, name: object) -> bytes:
    try:
        file = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=_MEMORY)
        text = file.decompress(data, MOST_UNPACKED + 1)
    except lzma.LZMAError as error:
        raise EvaluationError(f"{name} cannot be read: {error}") from error
    if len(text) > MOST_UNPACKED:
        raise EvaluationError(f"{name} expands to more than {MOST_UNPACKED / 1e6:.0f} MB, which no entry may")
    if not file.eof or file.unused_data:
        raise EvaluationError(f"{name} is cut short" if not file.eof else f"{name} goes on after its end")
    if text.count(b",") > MOST_VALUES:
        raise EvaluationError(f"{name} holds more than {MOST_VALUES:,} values, which no entry may")
    return text


def _episodes(content: Content, name: object) -> list[EpisodeResult]:
    """The episodes in columns, which must be of the benchmark's environments and equally long."""
    columns = [getattr(content.episodes, field) for field in Columns.__struct_fields__]
    episodes: list[EpisodeResult] = []
    for environment in sorted({environment for column in columns for environment in column}):
        task, _, variant = environment.partition("-")
        if (task, variant) not in ENVIRONMENTS:
            raise EvaluationError(f"{name} has results in {short_repr(environment)}, which is no environment")
        lengths = [len(column.get(environment, ())) for column in columns]
        if len(set(lengths)) > 1 or not lengths[0]:
            fields = zip(Columns.__struct_fields__, lengths, strict=True)
            counts = ", ".join(f"{field} {count}" for field, count in fields)
            raise EvaluationError(f"{name} has not all fields of all episodes in {environment}: {counts}")
        for run, seed, scene, score, actions, failure in zip(*(column[environment] for column in columns), strict=True):
            episodes.append(
                EpisodeResult(
                    policy=content.card.method,
                    run=run,
                    task=task,
                    variant=variant,
                    seed=seed,
                    score=score,
                    steps=len(actions),
                    seconds=0.0,
                    rules=content.rules,
                    preset=content.observations,
                    version="",
                    mujoco="",
                    gl="",
                    actions=actions,
                    failure=failure,
                    scene=scene,
                )
            )
    return episodes


def check_unique(episodes: Sequence[EpisodeResult], name: object, remedy: str = "") -> None:
    """Raises an `EvaluationError`, which ends with `remedy`, if an episode appears twice."""
    keys: set[tuple[int, str, str, int]] = set()
    for episode in episodes:
        key = episode.run, episode.task, episode.variant, episode.seed
        if key in keys:
            raise EvaluationError(f"{name} holds an episode twice: {name_of(episode)}{remedy}")
        keys.add(key)


def name_of(episode: EpisodeResult) -> str:
    """The episode in words, for problems."""
    return f"run {episode.run}, {episode.task} {episode.variant}, seed {episode.seed}"


def check_method(card: Card, where: object) -> None:
    """Raises an `EvaluationError` unless the name of the method looks like what it is."""
    if not (card.method.isprintable() and card.method == card.method.strip()):
        raise EvaluationError(
            f"the method's name {card.method!r} in {where} holds signs that cannot be seen, or begins or ends with a "
            "space"
        )
