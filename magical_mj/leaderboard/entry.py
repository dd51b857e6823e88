"""Leaderboard entries: the evaluations of one method in one file, with a descriptive card and a hash of everything.

`magical_mj.leaderboard.submission` makes entries. `read_entry` reads them, and trusts nothing in the file.
"""

from __future__ import annotations

import hashlib
import json
import lzma
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any, Final, Literal

import msgspec
from msgspec import Meta, Struct

from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.tasks import PREFIX
from magical_mj.leaderboard.names import check_method_name
from magical_mj.leaderboard.places import in_track, place_of, places
from magical_mj.protocol import PROTOCOL, SHIFT_SEEDS
from magical_mj.tasks.spec import Rules
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, short_repr

FORMAT: Final = 2
SUFFIX: Final = ".json.xz"
CARD: Final = "card.toml"
"""The card in a folder that is an entry. Each other file holds some runs, so a new run adds a file and changes none."""
SHARED: Final = ("observations", "rules", "protocol")
"""The fields that must be the same in all files of an entry."""
MOST_OF_CARD: Final = 20_000
"""The largest size of such a card in bytes."""
GIVEN: Final = "demonstrations at test"
"""The privilege of methods whose policies receive demonstrations."""
SIMULATOR: Final = "simulator at test"
"""The privilege of methods whose policies use the simulation."""
NEEDED: Final = {"simulation": SIMULATOR, "demonstrations": GIVEN}
"""What a policy uses -> the privilege that its card must declare."""
OTHER_SCENES: Final = "other scenes"
"""The privilege of methods that learn in other scenes than the demo scene."""
MOST_OF_ENTRY: Final = 20_000_000
"""The largest size of an entry's file in bytes. Ours have 2 MB at most."""
MOST_UNPACKED: Final = 60_000_000
"""The largest size of a decompressed entry in bytes, since a small file may expand to a huge one. Ours have 6 MB."""
MOST_VALUES: Final = 2_000_000
"""The largest number of values in an entry: parsed, small values take ten times as much memory as their text. Ours have
180,000: six for each of 30,000 episodes."""
MOST_MEMORY: Final = 100_000_000
"""The most memory in bytes that decompression may take. The file specifies how much it needs. Ours need 66 MB."""

Natural = Annotated[int, Meta(ge=0)]
Positive = Annotated[int, Meta(ge=1)]
Name = Annotated[str, Meta(max_length=80)]
Line = Annotated[str, Meta(max_length=500)]


Privilege = Literal[
    "states",
    "simulator in training",
    "renderer in training",
    "score in training",
    "scripted skill",
    "tuned on other scenes of the test variants",
    "other scenes",
    "knowledge of tasks",
    "simulator at test",
    "demonstrations at test",
]
"""Information that a method uses in addition to the observations and actions of demonstrations.

In this order: the demonstrations' states; in training, the simulator, pictures of any state, and the task's score; a
program for a part of the tasks, such as gripping a block; choices by scores in dev scenes of the test variants; scenes
other than the demo scene; the author's knowledge of the tasks; a copy of the simulation during tests; and
demonstrations at the start of each episode, of a task that was not in the training data."""


class Demonstrations(Struct, forbid_unknown_fields=True):
    """The training data.

    `set` is `magical_mj.protocol.DEMONSTRATIONS` if it includes shipped demonstrations, and `loaded_set` is the
    argument `set` of `magical_mj.demos.load`. `per_task` is the number of demonstrations per task, and `other` any
    other data.
    """

    set: Positive | None = None
    loaded_set: Positive = 1
    per_task: Natural | None = None
    other: Line | None = None


class Training(Struct, forbid_unknown_fields=True):
    """The cost of one training run: hours on the device, and environment steps."""

    hours: Annotated[float, Meta(ge=0, le=1e9)] | Natural | None = None
    device: Annotated[str, Meta(max_length=200)] | None = None
    steps: Natural | None = None


class Card(Struct, forbid_unknown_fields=True):
    """The description of a method. Fields that its author left out are None."""

    method: Annotated[str, Meta(pattern=r"^[^<>|`\[\]\x00-\x1f\u2020\u2605\u2b50]{1,80}$(?!\n)")]
    description: Annotated[str, Meta(max_length=2000)] | None = None
    authors: Line | None = None
    links: Annotated[list[Annotated[str, Meta(pattern="^https?://")]], Meta(max_length=10)] | None = None
    demonstrations: Demonstrations = msgspec.field(default_factory=Demonstrations)
    training: Training = msgspec.field(default_factory=Training)
    hardware: Line | None = None
    privileges: Annotated[list[Privilege], Meta(max_length=10)] | None = None
    commands: Annotated[list[Annotated[str, Meta(max_length=500)]], Meta(max_length=20)] | None = None
    """The commands that reproduce it, from a checkout of this repository or of the method's."""
    repeats: Annotated[str, Meta(max_length=80)] = ""
    """The method of another entry, if its authors trained that method again by its commands."""


class Versions(Struct, forbid_unknown_fields=True):
    """The versions of this package and of MuJoCo, and the OpenGL backends, that played the episodes."""

    version: Annotated[list[Name], Meta(min_length=1)]
    mujoco: Annotated[list[Name], Meta(min_length=1)]
    gl: Annotated[list[Name], Meta(min_length=1)]


class Columns(Struct, forbid_unknown_fields=True):
    """The episodes: field -> environment -> a value for each, in the same order in all fields.

    An environment has a name such as "FindDupe-All", in the shift track "FindDupe-Demo camera:3", and for intents
    "intent:line(all)-All". The format is by column because values of one kind compress best next to each other.
    """

    run: dict[str, list[Natural]]
    seed: dict[str, list[Natural]]
    scene: dict[str, list[Annotated[str, Meta(pattern=r"^[0-9a-f]{16}$(?!\n)")] | None]]
    score: dict[str, list[Annotated[float, Meta(ge=0, le=1)]]]
    actions: dict[str, list[Annotated[str, Meta(pattern=r"^[a-r]*$(?!\n)")]]]
    failure: dict[str, list[Annotated[str, Meta(max_length=300)] | None]]


class Recorded(Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """What the evaluations recorded about the policies. Empty in entries of older versions.

    `uses` lists what they used in episodes (`magical_mj.policies.interface.USES`), and `loaded` what they were made of,
    such as "onnx". `milliseconds` is the mean time of a step, with the simulation and the pictures. `given` is the
    description of intents that they received, such as "8 demonstrations in 4 scenes", and `given_in_tasks` that of the
    benchmark's tasks.
    """

    uses: Annotated[list[Name], Meta(max_length=10)] = []
    loaded: Annotated[list[Name], Meta(max_length=10)] = []
    milliseconds: Annotated[float, Meta(ge=0)] | None = None
    given: Name = ""
    given_in_tasks: Name = ""


class EntryFields(Struct, frozen=True):
    """The fields that `Entry` and `Content` share.

    `observations` is None if the policy used none, `protocol` if none was recorded.
    """

    card: Card
    observations: Annotated[str, Meta(pattern=r"^[0-9A-Za-z]{0,80}$(?!\n)")] | None
    rules: Rules
    protocol: Positive | None
    versions: Versions


class Content(EntryFields, frozen=True, forbid_unknown_fields=True):
    """The content of the file: JSON with sorted keys, compressed by xz.

    `sha256` is the hash of the same JSON without that field.
    """

    format: Literal[2]
    runs: Annotated[list[Natural], Meta(min_length=1, max_length=1_000)]
    episodes: Columns
    sha256: str
    played_in: Annotated[list[Annotated[str, Meta(pattern=r"^\w{1,80}$(?!\n)")]], Meta(max_length=20)] = []
    other_tasks: Annotated[list[Line], Meta(max_length=1_000)] = []
    recorded: Recorded = Recorded()


class Entry(EntryFields, frozen=True):
    """The results of one method. Episodes read from a file have no duration, and no individual versions.

    `played_in` names the variants, apart from Demo, of the scenes in its policies' training, as far as the evaluations
    recorded them. `other_tasks` names the tasks that its encoders or rewards, but not its policies, were trained on.
    """

    episodes: list[EpisodeResult]
    played_in: list[str] = []
    other_tasks: list[str] = []
    recorded: Recorded = Recorded()

    @property
    def method(self) -> str:
        """The method's name."""
        return self.card.method

    @property
    def runs(self) -> list[int]:
        """The numbers of its runs."""
        return sorted({episode.run for episode in self.episodes})

    @property
    def undeclared(self) -> str:
        """What its card must declare of its training or its uses in tests. Empty if nothing is known to be missing."""
        privileges = self.card.privileges
        for use, privilege in NEEDED.items():
            if use in self.recorded.uses and privileges is not None and privilege not in privileges:
                return f'uses the {use} during tests: add "{privilege}" to the card\'s privileges'
        if self.played_in and OTHER_SCENES not in (privileges or ()):
            return f'learnt in scenes of {", ".join(self.played_in)}: add "{OTHER_SCENES}" to the card\'s privileges'
        stated = self.card.demonstrations.other or ""
        if absent := [task for task in self.other_tasks if task not in stated]:
            return f"has an encoder or a reward of {', '.join(absent)}: name them in the card's [demonstrations] other"
        return ""

    @property
    def counted(self) -> list[EpisodeResult]:
        """The episodes without shifts that count: those with the seeds that the protocol requires."""
        plain = (episode for episode in self.episodes if not episode.shift)
        return [episode for episode in plain if episode.seed < places()[episode.task, episode.variant]]

    @property
    def shifted(self) -> list[EpisodeResult]:
        """The episodes of the shift track that count."""
        return [episode for episode in self.episodes if episode.shift and episode.seed < SHIFT_SEEDS]


def common(setting: str, values: Iterable[tuple[Any, object]]) -> Any:
    """The value of a setting, which must be the same in all files or folders. `values` are pairs (value, source)."""
    (first, folder), *others = values
    for value, other in others:
        if value != first:
            pair = f"{first or 'none'} in {folder}, {value or 'none'} in {other}"
            raise EvaluationError(f"different {setting}: {pair}; they must be the same in all of an entry")
    return first


def entry_files(folder: Path | str) -> list[Path]:
    """The entries in a folder, sorted by name: files, and folders with a card. An entry's own path gives itself."""
    folder = files.to_path(folder)
    if is_entry(folder):
        return [folder]
    paths = sorted([*folder.glob(f"*{SUFFIX}"), *(path.parent for path in folder.glob(f"*/{CARD}"))])
    if not paths:
        raise EvaluationError(f"{folder} holds no entries (*{SUFFIX}); magical-mj submit makes them")
    return paths


def packed(entry: Entry) -> bytes:
    """The bytes of the entry's file; equal entries have equal bytes."""
    columns: dict[str, dict[str, list[Any]]] = {field: defaultdict(list) for field in Columns.__struct_fields__}
    for episode in sorted(entry.episodes, key=attrgetter("run", "task", "variant", "seed")):
        for field, column in columns.items():
            environment = f"{episode.task}-{episode.variant} {episode.shift}".rstrip()
            column[environment].append(getattr(episode, field))
    fields = {name: msgspec.to_builtins(getattr(entry, name)) for name in Entry.__struct_fields__}
    usual = {"played_in": [], "other_tasks": [], "recorded": msgspec.to_builtins(Recorded())}
    for name, value in usual.items():
        if fields[name] == value:  # older versions did not write them
            del fields[name]
    content = {**fields, "format": FORMAT, "runs": entry.runs, "episodes": columns}
    text = _text({**content, "sha256": hashlib.sha256(_text(content)).hexdigest()})
    return lzma.compress(text, preset=9 | lzma.PRESET_EXTREME)  # a sixth smaller than with gzip


def _text(content: dict[str, Any]) -> bytes:
    return json.dumps(content, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()


def is_entry(path: Path) -> bool:
    """Whether a path is an entry: a file, or a folder with a card. An evaluation is a folder without one."""
    return path.is_file() or (path / CARD).is_file()


def read_entry(path: Path | str) -> Entry:
    """The entry in a file or a folder. The source need not be trusted.

    A folder holds a `CARD` and one or several files with equal `SHARED` fields. Its card replaces those in the files.

    Raises:
        EvaluationError: if it is not an entry, is too large, damaged or was altered, or has another format or protocol.
    """
    path = files.to_path(path)
    if not (path / CARD).is_file():
        return unpacked(_content(path, MOST_OF_ENTRY), path)
    card = _card_in(path)
    parts = {part: unpacked(_content(part, MOST_OF_ENTRY), part) for part in sorted(path.glob(f"*{SUFFIX}"))}
    if not parts:
        raise EvaluationError(f"{path} has a card, but no episodes (*{SUFFIX})")
    holders: dict[tuple[object, ...], Path] = {}
    for part, entry in parts.items():
        for row in entry.episodes:
            if holders.setdefault(row.key[1:], part) is not part:
                raise EvaluationError(f"{part} and another file of {path} hold the same episode: {row.title}")
    observations, rules, protocol = (
        common(name, ((getattr(entry, name), part) for part, entry in parts.items())) for name in SHARED
    )
    known = [[getattr(entry.versions, name) for entry in parts.values()] for name in Versions.__struct_fields__]
    versions = Versions(*(sorted({*chain.from_iterable(lists)}) for lists in known))
    episodes = [row for entry in parts.values() for row in entry.episodes]
    played_in = sorted({name for entry in parts.values() for name in entry.played_in})
    other_tasks = sorted({task for entry in parts.values() for task in entry.other_tasks})
    recorded = _joined(parts)
    return Entry(card, observations, rules, protocol, versions, episodes, played_in, other_tasks, recorded)


def _joined(parts: Mapping[Path, Entry]) -> Recorded:
    recorded = [entry.recorded for entry in parts.values()]
    times = [part.milliseconds for part in recorded if part.milliseconds is not None]
    return Recorded(
        sorted({use for part in recorded for use in part.uses}),
        sorted({kind for part in recorded for kind in part.loaded}),
        sum(times) / len(times) if times else None,
        *given_in((row, part) for part, entry in parts.items() for row in entry.episodes),
    )


def given_in(sources: Iterable[tuple[EpisodeResult, object]]) -> tuple[str, str]:
    """What the policy received in episodes of intents, and in those of tasks. Each episode comes with its source."""
    given: dict[bool, dict[str, object]] = {True: {}, False: {}}
    for row, source in sources:
        given[row.task.startswith(PREFIX)].setdefault(row.given, source)
    intents, tasks = (
        common(f"descriptions of {kind}", found.items()) if found else ""
        for kind, found in zip(("intents", "tasks"), given.values(), strict=True)
    )
    return intents, tasks


def _content(path: Path, most: int) -> bytes:
    try:
        return files.read_foreign(path, most=most, error=EvaluationError)
    except OSError as error:
        raise EvaluationError(f"{path} cannot be read: {error.strerror}") from error


def _card_in(folder: Path) -> Card:
    path = folder / CARD
    try:
        card = msgspec.toml.decode(_content(path, MOST_OF_CARD), type=Card)
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise EvaluationError(f"{path} is not a card: {str(error)[:200]}") from error
    check_method_name(card.method, path)
    return card


def unpacked(data: bytes, name: object = "the entry") -> Entry:
    """The entry in a file's bytes. Errors use `name`, and are those of `read_entry`."""
    text = _decompressed(data, name)
    try:
        content = msgspec.json.decode(text, type=Content)
    except (msgspec.MsgspecError, RecursionError, UnicodeError) as error:
        raise EvaluationError(f"{name} is not an entry: {str(error)[:200]}") from error
    without_hash = re.sub(rb',"sha256":"[^"]*"(?=,"versions":\{[^{]*$)', b"", text)
    if content.sha256 != hashlib.sha256(without_hash).hexdigest():
        raise EvaluationError(f"{name} was altered after it was made: its hash does not match its content")
    if content.protocol not in (None, PROTOCOL):
        raise EvaluationError(f"{name} follows protocol {content.protocol}, but this version plays {PROTOCOL}")
    check_method_name(content.card.method, name)
    episodes = _episodes(content, name)
    if content.runs != sorted({episode.run for episode in episodes}):
        raise EvaluationError(f"{name} lists the runs {content.runs}, but its episodes belong to other runs")
    shared = {name: getattr(content, name) for name in EntryFields.__struct_fields__}
    facts = {name: getattr(content, name) for name in ("played_in", "other_tasks", "recorded")}
    return Entry(**shared, episodes=episodes, **facts)


def _decompressed(data: bytes, name: object) -> bytes:
    try:
        file = lzma.LZMADecompressor(lzma.FORMAT_XZ, memlimit=MOST_MEMORY)
        text = file.decompress(data, MOST_UNPACKED + 1)
    except lzma.LZMAError as error:
        raise EvaluationError(f"{name} cannot be read: {error}") from error
    if len(text) > MOST_UNPACKED:
        raise EvaluationError(f"{name} expands to more than {MOST_UNPACKED / 1e6:.0f} MB, the limit for entries")
    if not file.eof or file.unused_data:
        raise EvaluationError(f"{name} is cut short" if not file.eof else f"{name} has data after its end")
    if text.count(b",") > MOST_VALUES:
        raise EvaluationError(f"{name} holds more than {MOST_VALUES:,} values, the limit for entries")
    return text


def _episodes(content: Content, name: object) -> list[EpisodeResult]:
    """The episodes in the columns of an entry, which are checked."""
    columns = msgspec.structs.asdict(content.episodes)
    shared: dict[str, Any] = {"policy": content.card.method, "rules": content.rules, "preset": content.observations}
    shared |= {name: ", ".join(found) for name, found in msgspec.structs.asdict(content.versions).items()}
    episodes: list[EpisodeResult] = []
    for environment in sorted({environment for column in columns.values() for environment in column}):
        task, variant, shift = place_of(environment)
        shared["shift"] = shift
        recorded = content.recorded
        shared["given"] = recorded.given if task.startswith(PREFIX) else recorded.given_in_tasks
        if (task, variant) not in places() or (shift and not in_track(task, variant, shift)):
            raise EvaluationError(f"{name} has results in {short_repr(environment)}, which is not an environment")
        lengths = {field: len(column.get(environment, ())) for field, column in columns.items()}
        if len(set(lengths.values())) > 1 or not lengths["run"]:
            counts = ", ".join(f"{field} {count}" for field, count in lengths.items())
            raise EvaluationError(f"{name} lacks fields of some episodes in {environment}: {counts}")
        numbers: set[tuple[int, int]] = set()
        for values in zip(*(column[environment] for column in columns.values()), strict=True):
            fields = dict(zip(columns, values, strict=True))
            episode = EpisodeResult(
                task=task, variant=variant, steps=len(fields["actions"]), seconds=0.0, **fields, **shared
            )
            if (episode.run, episode.seed) in numbers:
                remedy = "if these are two runs, evaluate one of them again with another --run"
                raise EvaluationError(f"{name} holds an episode twice: {episode.title}; {remedy}")
            numbers.add((episode.run, episode.seed))
            episodes.append(episode)
    return episodes


class Entries:
    """Entries in reports; see `magical_mj.evaluation.folder.ResultFormat`."""

    def holds(self, path: Path) -> bool:
        """Whether the path is an entry."""
        return is_entry(path)

    def episodes(self, path: Path) -> Iterator[EpisodeResult]:
        """The episodes of an entry."""
        return iter(read_entry(path).episodes)


ENTRIES: Final = Entries()
