"""Demonstrations of the expert as actions: a hundred bytes each, replayed when they are needed.

They are kept in a file with a line of JSON for each. Lines are appended and never altered, so several processes can add
some, and what is interrupted continues. A killed process may leave an incomplete last line, which is ignored, and
removed before more lines are appended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Final

import msgspec
from msgspec import Meta

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import demonstrate, replayed
from magical_mj.policies.interface import actions_of, letters_of
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError
from magical_mj.utils.parallel import map_here, map_unordered

Key = tuple[str, str, int]
"""Task, variant and number: the seed of the scene, if the expert solves it."""
Watch = Callable[[int, int], object]
"""Called with the number of demonstrations that are there, and the number of all."""

ATTEMPTS: Final = 3
"""The number of scenes that are tried for a demonstration."""
NEXT: Final = 840_000_000_000
"""The increment of the scene's seed between attempts. A multiple of all numbers up to 8 keeps the demo scene."""
FEW: Final = 4
"""Up to so many demonstrations are made in this process, since starting others takes longer."""
SHOWN: Final = 3
"""The number of failures that an error shows."""


class Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A line of the file: a demonstration of the expert with score 1.

    Attributes:
        number: identifies it among those of this task and variant.
        seed: the seed of the scene; the number, or if the expert could not solve that scene, another one.
        expert: the expert's seed.
        scene: the digest of the scene.
        actions: a letter for each.
    """

    task: str
    variant: str
    number: Annotated[int, Meta(ge=0)]
    seed: Annotated[int, Meta(ge=0)]
    expert: Annotated[int, Meta(ge=0)]
    scene: str
    actions: Annotated[str, Meta(pattern="^[a-r]+$")]

    @property
    def key(self) -> Key:
        """Identifies the demonstration."""
        return self.task, self.variant, self.number


def default_path() -> Path:
    """The file in the user's cache folder, of this protocol and version of MuJoCo."""
    return files.cache_folder() / f"demonstrations-p{PROTOCOL}-mujoco{version('mujoco')}.jsonl"


def read(path: Path) -> dict[Key, Stored]:
    """The demonstrations in a file; none if there is no file.

    Raises:
        DemonstrationError: if a line is invalid.
    """
    lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
    return {stored.key: stored for stored in _decoded(path, lines)}


def _decoded(path: Path, lines: Sequence[bytes]) -> Iterator[Stored]:
    for number, line in enumerate(lines, start=1):
        try:
            yield msgspec.json.decode(line, type=Stored)
        except (msgspec.MsgspecError, UnicodeError) as error:
            raise DemonstrationError(f"{path}, line {number}: {error}; delete the line: it is made again") from error


def complete(
    keys: Iterable[Key], path: Path, *, jobs: int | None = None, watch: Watch = lambda _, __: None
) -> list[Stored]:
    """The demonstrations with these keys. Those that are not in the file are made by the expert, and added to it.

    They are the same on every machine and for any number of processes.

    Args:
        keys: task, variant and number of each.
        path: the file. It is made if it is missing.
        jobs: the number of processes; None: one per core.
        watch: called when one was made.

    Raises:
        DemonstrationError: if the expert did not solve some of the scenes; all others are in the file.
    """
    keys = list(keys)
    known = read(path)
    todo = [key for key in dict.fromkeys(keys) if key not in known]
    watch(len(keys) - len(todo), len(keys))
    failures: list[str] = []
    made = map_here(_made, todo) if jobs == 1 or len(todo) <= FEW else map_unordered(_made, todo, jobs)
    for number, result in enumerate(made, start=len(keys) - len(todo) + 1):
        if isinstance(result, Stored):
            _append(path, result)
            known[result.key] = result
        else:
            failures.append(result)
        watch(number, len(keys))
    if failures:
        listed = "; ".join(sorted(set(failures))[:SHOWN])
        raise DemonstrationError(f"{len(failures)} of {len(keys)} demonstrations could not be made: {listed}")
    return [known[key] for key in keys]


def _made(key: Key) -> Stored | str:
    """The demonstration with this key, or why there is none."""
    task, variant, number = key
    problem = ""
    for attempt in range(ATTEMPTS):
        try:
            demo = demonstrate(task, variant, number + attempt * NEXT)
        except MagicalError as error:
            problem = problem or str(error)
            continue
        actions = letters_of(demo.actions.tolist())
        return Stored(task, variant, number, demo.scene_seed, demo.seed, demo.scene.digest(), actions)
    return problem


def _append(path: Path, stored: Stored) -> None:
    """Adds a line to the file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a+b") as file, files.locked(path):
        file.seek(0)
        if (content := file.read()) and not content.endswith(b"\n"):
            file.truncate(content.rfind(b"\n") + 1)
        file.write(msgspec.json.encode(stored) + b"\n")


def replay(stored: Stored, path: Path) -> Demonstration:
    """The demonstration, with all its states. `path` is the file that holds it.

    Raises:
        DemonstrationError: if its scene is another one in this version of the package, or the actions do not solve it.
    """
    task, variant, _ = stored.key
    demo = replayed(task, variant, stored.seed, actions_of(stored.actions), "expert", stored.expert)
    if (demo.scene.digest(), demo.score) != (stored.scene, 1.0):
        raise DemonstrationError(
            f"{path} holds a demonstration of {task} {variant}, number {stored.number}, that was made by another "
            "version: delete the file, and its demonstrations are made again"
        )
    return demo
