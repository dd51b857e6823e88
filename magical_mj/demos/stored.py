"""Demonstrations of the expert, stored as actions: 300 bytes each. A replay computes the states.

A file has a line of JSON for each demonstration. Lines are appended and never altered (`magical_mj.utils.lines`), so
several processes can add lines, and interrupted work continues.

The package ships some demonstrations, in such a file that xz compressed (`python -m tools.intents demonstrations`).
"""

from __future__ import annotations

import lzma
from base64 import b64decode, b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, Final

import msgspec
import numpy as np
from msgspec import Meta

from magical_mj.demos.demonstration import Demonstration, Demonstrator
from magical_mj.demos.recording import demonstrate, replayed
from magical_mj.policies.interface import actions_of, letters_of
from magical_mj.protocol import INTENTS, PROTOCOL
from magical_mj.scene.bodies import GRIPPER, body_named
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError
from magical_mj.utils.lines import appending, read_lines
from magical_mj.utils.parallel import map_here, map_unordered

Key = tuple[str, str, int]
"""Task, variant and number: the seed of the scene, if the expert solves it."""
Watch = Callable[[int, int], object]
"""Called with the number of finished demonstrations, and their total number."""

ATTEMPTS: Final = 4
"""The number of scenes that the expert tries for a demonstration."""
NEXT: Final = 840_000_000_000
"""The increment of the scene's seed between attempts. A demo scene that depends on the seed repeats after some number
of seeds from 1 to 8. The increment is a multiple of all these numbers, so further attempts have the same demo scene."""
FEW: Final = 4
"""The largest number of demonstrations that are made in this process, since starting other processes takes longer."""
SHOWN: Final = 3
"""The number of failures that an error shows."""


class Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True, kw_only=True):
    """A demonstration as actions. The defaults are those of the expert's file.

    Attributes:
        number: identifies it in this task and variant.
        seed: the seed of the scene. It is the number, unless the expert failed in that scene.
        expert: the expert's seed. None: the seed of the scene.
        scene: the digest of the scene; empty if unknown.
        actions: a letter for each; speeds in float32, as base64.
    """

    task: str
    variant: str
    number: Annotated[int, Meta(ge=0)] = 0
    seed: Annotated[int, Meta(ge=0)]
    expert: Annotated[int, Meta(ge=0)] | None = None
    scene: str = ""
    actions: Annotated[str, Meta(pattern="^[A-Za-z0-9+/]+=*$")]
    body: str = GRIPPER
    demonstrator: Demonstrator = "expert"
    score: float = 1.0

    @property
    def key(self) -> Key:
        """Identifies the demonstration."""
        return self.task, self.variant, self.number

    def played(self) -> Demonstration:
        """The demonstration with its states, computed by playing the actions again."""
        actions: Any
        if task_spec(self.task).speeds:
            size = 3 if body_named(self.body).fingers else 2
            actions = np.frombuffer(b64decode(self.actions), np.float32).reshape(-1, size)
        else:
            actions = actions_of(self.actions)
        expert = self.expert if self.demonstrator == "expert" else None
        return replayed(self.task, self.variant, self.seed, actions, self.demonstrator, expert, self.body)

    def verified(self, path: Path) -> Demonstration:
        """The demonstration with its states, which must solve the task. `path` is its file.

        Raises:
            DemonstrationError: if this version of the package has another scene for it, or the actions do not solve it.
        """
        demo = self.played()
        if (demo.scene.digest(), demo.score) != (self.scene, 1.0):
            raise DemonstrationError(
                f"{path} contains a demonstration of {self.task} {self.variant}, number {self.number}, from another "
                "version of this package: delete the file, and its demonstrations are made again"
            )
        return demo


def as_stored(demo: Demonstration, **more: Any) -> Stored:
    """The actions of a demonstration. `more` are further fields."""
    speeds = demo.actions.ndim == 2
    actions = b64encode(demo.actions.tobytes()).decode() if speeds else letters_of(demo.actions.tolist())
    body, maker = demo.scene.robot.body, demo.demonstrator
    given = {"task": demo.task, "variant": demo.variant, "seed": demo.scene_seed, "actions": actions, "body": body}
    return Stored(**{**given, "demonstrator": maker, "score": demo.score, **more})


def default_path() -> Path:
    """The file in the user's cache folder for these protocols and this version of MuJoCo."""
    return files.cache_folder() / f"demonstrations-p{PROTOCOL}-i{INTENTS}-mujoco{version('mujoco')}.jsonl"


def shipped_path() -> Path:
    """The file of the package for these protocols and this version of MuJoCo. It exists only for some versions."""
    return Path(__file__).parent / "data" / f"{default_path().name}.xz"


@cache
def shipped() -> Mapping[Key, Stored]:
    """The demonstrations that come with the package; none for other versions of MuJoCo."""
    path = shipped_path()
    lines = lzma.decompress(path.read_bytes()).splitlines() if path.exists() else []
    return MappingProxyType({stored.key: stored for stored in _decoded(path, enumerate(lines, start=1))})


def read(path: Path) -> dict[Key, Stored]:
    """The demonstrations in a file. Empty if the file does not exist.

    Raises:
        DemonstrationError: if a line is invalid.
    """
    lines = read_lines(path, DemonstrationError) if path.exists() else ()
    return {stored.key: stored for stored in _decoded(path, lines)}


def _decoded(path: Path, lines: Iterable[tuple[int, bytes]]) -> Iterator[Stored]:
    for number, line in lines:
        try:
            yield msgspec.json.decode(line, type=Stored)
        except (msgspec.MsgspecError, UnicodeError) as error:
            raise DemonstrationError(f"{path}, line {number}: {error}; delete this line") from error


def complete(
    keys: Iterable[Key],
    path: Path,
    *,
    known: Mapping[Key, Stored] = MappingProxyType({}),
    jobs: int | None = None,
    watch: Watch = lambda _, __: None,
) -> list[Stored]:
    """The demonstrations with these keys. The expert makes those that are not in the file, and they are added to it.

    They do not depend on the machine or the number of processes.

    Args:
        keys: task, variant and number of each demonstration.
        path: the file. It is created if it is missing.
        known: demonstrations that are not looked for in the file.
        jobs: the number of processes; None: one per core.
        watch: called before the first new demonstration, and after each.

    Raises:
        DemonstrationError: if some demonstrations could not be made. The file then contains all others.
    """
    keys = list(keys)
    known = read(path) | dict(known)
    todo = [key for key in dict.fromkeys(keys) if key not in known]
    if todo:
        watch(len(keys) - len(todo), len(keys))
    failures: list[str] = []
    made = map_here(_made, todo) if jobs == 1 or len(todo) <= FEW else map_unordered(_made, todo, jobs)
    for number, result in enumerate(made, start=len(keys) - len(todo) + 1):
        if isinstance(result, Stored):
            path.parent.mkdir(parents=True, exist_ok=True)
            with appending(path) as file:
                file.append(msgspec.json.encode(result) + b"\n")
            known[result.key] = result
        else:
            failures.append(result)
        watch(number, len(keys))
    if failures:
        listed = "; ".join(sorted(set(failures))[:SHOWN])
        raise DemonstrationError(
            f"{len(failures)} of {len(keys)} demonstrations could not be made: {listed}. All others are stored: leave "
            "these tasks out, or give them other demo scenes, as in 'intent:robot in() [seed=1]'"
        )
    return [known[key] for key in keys]


def _made(key: Key) -> Stored | str:
    """The demonstration with this key, or the error message if it could not be made."""
    task, variant, number = key
    problem = ""
    for attempt in range(ATTEMPTS):
        try:
            demo = demonstrate(task, variant, number + attempt * NEXT)
        except MagicalError as error:
            problem = problem or str(error)
            continue
        return as_stored(demo, number=number, expert=demo.seed, scene=demo.scene.digest())
    return problem
