"""The scores of an evaluation: the file ``scores.jsonl`` in its folder, with a line per finished episode.

Lines are appended, and none is altered. What a killed process left half written is cut off before more is appended, and
`ScoreFile.clear` removes all lines.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final, Self, get_type_hints

from magical_mj.policies.folders import loader_in
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, shown

SCORES: Final = "scores.jsonl"

Key = tuple[str, int, str, str, int]
"""Identifies an episode: policy, run, task, variant, seed."""


@dataclass(frozen=True, slots=True)
class Score:
    """One finished episode.

    Attributes:
        policy: the method's name.
        run: the number of the run of the method.
        task: the task's name.
        variant: the variant's name.
        seed: the scene's seed.
        score: in [0, 1]; 0 if the policy failed.
        steps: the number of actions.
        seconds: the duration of the episode, wall clock.
        rules: the rules by which it was scored.
        preset: the preset of the observations; None if the policy uses none.
        version: the version of this package.
        mujoco: MuJoCo's version.
        gl: the OpenGL backend.
        actions: a letter for each action, from which the episode can be replayed.
        failure: why the policy failed; None if it did not.
        scene: the digest of the scene in which the episode started; None in files of older versions.
        worlds: "single" if it was played in MuJoCo itself; "batched" scores are approximate.
    """

    policy: str
    run: int
    task: str
    variant: str
    seed: int
    score: float
    steps: int
    seconds: float
    rules: str
    preset: str | None
    version: str
    mujoco: str
    gl: str
    actions: str
    failure: str | None = None
    scene: str | None = None
    worlds: str = "single"

    @property
    def key(self) -> Key:
        """Identifies this episode."""
        return self.policy, self.run, self.task, self.variant, self.seed

    def line(self) -> str:
        """The episode as a line of the file."""
        return json.dumps(dataclasses.asdict(self), ensure_ascii=False) + "\n"


_TYPES: Final[dict[str, Any]] = {
    name: int | float if kind is float else kind for name, kind in get_type_hints(Score).items()
}
_ADDED_LATER: Final = {"scene", "worlds"}
"""What lines of older versions do not have."""

_BEGINNING: Final = b'{"policy": "'
"""Of each line."""


def parse(line: str) -> Score:
    """The episode in a line; raises a ValueError that says what is wrong with it."""
    try:
        entry = json.loads(line)
    except RecursionError:
        raise ValueError("lists in lists without end") from None
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise
        raise ValueError("more than one episode; each must have a line of its own") from None
    if not isinstance(entry, dict) or entry.keys() | _ADDED_LATER != _TYPES.keys():
        raise ValueError(f"it must be an object with the keys {', '.join(_TYPES)}")
    for name, value in entry.items():
        if not isinstance(value, _TYPES[name]) or isinstance(value, bool):
            raise ValueError(f"{name} must not be {shown(value)}")
        if isinstance(value, str) and not (_is_unicode(value) if name == "failure" else value.isprintable()):
            raise ValueError(f"{name} must be a text of printable characters, not {shown(value)}")
    if not 0 <= entry["score"] <= 1:
        raise ValueError(f"the score {entry['score']} is not in [0, 1]")
    return Score(**entry)


def _is_unicode(text: str) -> bool:
    """Whether a text can be encoded; halves of characters, which JSON can name, cannot."""
    return not any("\ud800" <= letter <= "\udfff" for letter in text)


def read(folder: Path) -> list[Score]:
    """The finished episodes in a folder. A last line that is still being written is left out.

    Raises:
        EvaluationError: if there is no such file, a line is invalid, or an episode occurs twice.
    """
    return list(episodes_in(folder))


def episodes_in(folder: Path) -> Iterator[Score]:
    """As `read`, one after another: the file may be larger than memory."""
    path = folder / SCORES
    if not path.is_file():
        raise _no_scores(folder)
    lines: dict[Key, int] = {}
    names: dict[str, str] = {}
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n") and _is_half(line):
                break
            try:
                score = parse(line.decode(errors="replace"))
            except ValueError as error:
                raise EvaluationError(
                    f"{path}, line {number}: {error}. Mend the line, or delete it: evaluate --resume plays what is "
                    "missing"
                ) from error
            policy, run, task, variant, seed = score.key
            # each name once: the keys of a million episodes then take 200 MB instead of 400
            policy, task, variant = (names.setdefault(name, name) for name in (policy, task, variant))
            if (other := lines.setdefault((policy, run, task, variant, seed), number)) != number:
                raise EvaluationError(f"{path}, line {number}: the same episode as line {other}; delete one")
            yield score
    if not lines:
        raise EvaluationError(f"{path} holds no finished episode yet")


def _no_scores(folder: Path) -> EvaluationError:
    """The error for a folder that is not one of an evaluation."""
    if folder.is_file():
        return EvaluationError(
            f"{folder} is a file, and not the folder of an evaluation; magical-mj leaderboard checks entries"
        )
    if loader_in(folder) is not None:
        return EvaluationError(
            f"{folder} holds a policy, and no evaluation of it; to make one in another folder: "
            f"magical-mj evaluate --policy {folder} --out ANOTHER"
        )
    return EvaluationError(f"{folder} holds no {SCORES}; magical-mj evaluate --out {folder} makes one")


def _is_half(last: bytes) -> bool:
    """Whether these bytes after the last line's end are what a killed process leaves: the beginning of one episode."""
    if not last.startswith(_BEGINNING[: len(last)]) or _BEGINNING in last[1:]:
        return False
    try:
        json.JSONDecoder().raw_decode(last.decode(errors="ignore"))
    except (ValueError, RecursionError):
        return True
    return False


class ScoreFile:
    """The file ``scores.jsonl``, open for appending and locked, so that only one process writes."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / SCORES
        self._file: IO[str] | None = None
        self._open = ExitStack()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self._file = stack.enter_context(self._path.open("a", encoding="utf-8"))
            busy = EvaluationError(f"another evaluation is writing to {self._path}")
            stack.enter_context(files.locked(self._path, busy=busy))
            _repair(self._path)
            self._open = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # of what could not be written, which `add` has told
            self._open.close()

    def clear(self) -> None:
        """Removes all episodes."""
        os.truncate(self._path, 0)

    def add(self, scores: Iterable[Score]) -> None:
        """Appends finished episodes in a single write."""
        if self._file is None:
            raise RuntimeError("enter the file first")
        try:
            self._file.write("".join(score.line() for score in scores))
            self._file.flush()
        except OSError as error:  # a full disk names no file
            raise OSError(error.errno, error.strerror, str(self._path)) from error


def _repair(path: Path) -> None:
    """Completes the last line if only its end is missing, and removes it if a killed run left it half written."""
    raw = path.read_bytes()
    last = raw[raw.rfind(b"\n") + 1 :]
    if _is_half(last):
        os.truncate(path, len(raw) - len(last))
    elif last:
        with suppress(ValueError), path.open("ab") as file:
            parse(last.decode())  # what is wrong otherwise, reading tells
            file.write(b"\n")


def frame(scores: Sequence[Score]) -> Any:
    """The episodes as a pandas frame, one row each, in a fixed order."""
    import pandas as pd

    rows = [dataclasses.asdict(score) for score in sorted(scores, key=lambda score: score.key)]
    return pd.DataFrame(rows, columns=[field.name for field in dataclasses.fields(Score)])
