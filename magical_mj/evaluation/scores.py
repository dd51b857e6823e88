"""The folder of an evaluation: ``run.json`` with its settings, and ``scores.jsonl`` with a line per finished episode.

Lines are appended, and none is altered. A line counts once it has its end: what a killed process left half written is
not read, and cut off before more is appended. An evaluation is resumed only with the settings it was started with.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Annotated, Any, Final, NamedTuple

import msgspec

from magical_mj._version import __version__
from magical_mj.evaluation.settings import MUJOCO_VERSION
from magical_mj.policies.interface import Episode, letters_of
from magical_mj.policies.loading import loader_in
from magical_mj.rendering.backend import drawn_by
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, short_repr
from magical_mj.utils.settings import check_unchanged

SCORES: Final = "scores.jsonl"
SETTINGS: Final = "run.json"

Key = tuple[str, int, str, str, int]
"""Identifies an episode: policy, run, task, variant, seed."""


class Outcome(NamedTuple):
    """What came of playing an episode."""

    actions: Sequence[int]
    score: float
    """In [0, 1]; of no meaning if the policy failed."""
    failure: str | None
    """Why the policy failed; None if it did not."""
    seconds: float


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """One played episode, with all that is needed to replay it: a line of ``scores.jsonl``.

    Attributes:
        policy: the method's name; of a policy that was not given a name, that of its class or function.
        run: the number of the run of the method.
        task: the task's name. In files it is text: see `magical_mj.utils.imports` before it is looked up.
        variant: the variant's name.
        seed: the scene's seed.
        score: in [0, 1]; 0 if the policy failed.
        steps: the number of actions.
        seconds: the duration of the episode, wall clock.
        rules: the rules by which it was scored.
        preset: the preset of the observations; None if the policy uses none, or they have no name.
        version: the version of this package.
        mujoco: MuJoCo's version.
        gl: the OpenGL backend.
        actions: a letter for each action, from which the episode can be replayed.
        failure: why the policy failed; None if it did not.
        scene: the digest of the scene in which the episode started; None in files of older versions.
        worlds: "single" if MuJoCo itself simulated it; the scores of "batched" worlds are approximate.
    """

    policy: str
    run: Annotated[int, msgspec.Meta(ge=0)]
    task: str
    variant: str
    seed: Annotated[int, msgspec.Meta(ge=0)]
    score: Annotated[float, msgspec.Meta(ge=0, le=1)]
    steps: Annotated[int, msgspec.Meta(ge=0)]
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

    @classmethod
    def of(cls, episode: Episode, outcome: Outcome, **facts: Any) -> EpisodeResult:
        """The result of an episode that was played here and now.

        Args:
            episode: the episode.
            outcome: what came of it.
            facts: the fields `policy`, `rules`, `preset`, `scene` and `worlds`.
        """
        return cls(
            run=episode.run,
            task=episode.task,
            variant=episode.variant,
            seed=episode.seed,
            score=0.0 if outcome.failure else float(outcome.score),
            steps=len(outcome.actions),
            seconds=round(outcome.seconds, 4),
            version=__version__,
            mujoco=MUJOCO_VERSION,
            gl=drawn_by(),
            actions=letters_of(outcome.actions),
            failure=outcome.failure,
            **facts,
        )

    @property
    def key(self) -> Key:
        """Identifies this episode."""
        return self.policy, self.run, self.task, self.variant, self.seed

    def line(self) -> str:
        """As a line of the file."""
        return json.dumps(dataclasses.asdict(self), ensure_ascii=False) + "\n"


_FIELDS: Final = tuple(field.name for field in dataclasses.fields(EpisodeResult))
_BEGINNING: Final = b'{"policy": '
"""Of each line."""


def parse(line: str | bytes) -> EpisodeResult:
    """The episode in a line; raises a ValueError that says what is wrong with it."""
    try:
        values = msgspec.json.decode(line)
        if not isinstance(values, dict) or not values.keys() <= set(_FIELDS):
            raise ValueError(f"it must be an object with the keys {', '.join(_FIELDS)}")
        result = msgspec.convert(values, EpisodeResult)
    except RecursionError:
        raise ValueError("lists in lists without end") from None
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from None
    for name, value in values.items():
        if isinstance(value, str) and name != "failure" and not value.isprintable():
            raise ValueError(f"{name} must be a text of printable characters, not {short_repr(value)}")
    return result


def read(folder: Path) -> list[EpisodeResult]:
    """The finished episodes in a folder.

    Raises:
        EvaluationError: if there is no such file, a line is invalid, or an episode occurs twice.
    """
    return list(episodes_in(folder))


def episodes_in(folder: Path) -> Iterator[EpisodeResult]:
    """As `read`, one after another: the file may be larger than memory."""
    path = folder / SCORES
    if not path.is_file():
        remedy = f"magical-mj evaluate --out {folder} makes one"
        if loader_in(folder) is not None:  # a training's folder
            remedy = f"it holds a policy: magical-mj evaluate --policy {folder} --out ANOTHER evaluates it"
        raise EvaluationError(f"{folder} holds no {SCORES}; {remedy}")
    lines: dict[Key, int] = {}
    names: dict[str, str] = {}
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if _is_half(line):
                break
            try:
                result = parse(line)
            except ValueError as error:
                raise EvaluationError(
                    f"{path}, line {number}: {error}. Mend the line, or delete it: evaluate --resume plays what is "
                    "missing"
                ) from error
            policy, run, task, variant, seed = result.key
            # each name once: the keys of a million episodes then take 200 MB instead of 400
            policy, task, variant = (names.setdefault(name, name) for name in (policy, task, variant))
            if (other := lines.setdefault((policy, run, task, variant, seed), number)) != number:
                raise EvaluationError(f"{path}, line {number}: the same episode as line {other}; delete one")
            yield result
    if not lines:
        raise EvaluationError(f"{path} holds no finished episode yet")


def _is_half(line: bytes) -> bool:
    """Whether a line is what a killed process leaves; what holds several episodes has lost the ends of its lines."""
    return not line.endswith(b"\n") and line.count(_BEGINNING) < 2


def frame(results: Sequence[EpisodeResult]) -> Any:
    """The episodes as a pandas frame, one row each, in a fixed order."""
    import pandas as pd

    rows = [dataclasses.asdict(result) for result in sorted(results, key=lambda result: result.key)]
    return pd.DataFrame(rows, columns=list(_FIELDS))


@contextmanager
def open_scores(folder: Path) -> Iterator[IO[bytes]]:
    """The file of scores in a folder, open for `append`, and locked so that only one process writes.

    Raises:
        EvaluationError: if another process has opened it.
    """
    path = folder / SCORES
    busy = EvaluationError(f"another evaluation is writing to {path}")
    with path.open("ab", buffering=0) as file, files.locked(path, busy=busy):
        written = path.read_bytes()
        end = written.rfind(b"\n") + 1
        if _is_half(written[end:]):
            file.truncate(end)
        yield file


def append(file: IO[bytes], results: Iterable[EpisodeResult]) -> None:
    """Appends finished episodes in a single write."""
    lines = "".join(result.line() for result in results).encode()
    try:
        while lines:  # of which a full disk may take a part before it raises an error
            lines = lines[file.write(lines) :]
    except OSError as error:  # which names no file
        raise OSError(error.errno, error.strerror, file.name) from error


def prepare(folder: Path, settings: dict[str, Any], resume: bool) -> list[EpisodeResult]:
    """Makes the folder, or reads what is in it. An evaluation without finished episodes is started anew.

    Raises:
        EvaluationError: if it cannot be written to, holds something else, or holds an evaluation and `resume` is false.
        SettingsError: if it was started with other settings.
    """
    path = folder / SCORES
    if path.exists() and path.stat().st_size and not resume:
        raise EvaluationError(f"{folder} holds an evaluation already; --resume continues it (resume=True)")
    if (folder / SETTINGS).exists() and "policies" not in read_settings(folder):
        raise EvaluationError(f"{folder / SETTINGS} is not of an evaluation; choose another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with open_scores(folder):
            return load_or_start(folder, settings)
    except OSError as error:
        raise EvaluationError(f"cannot write into {folder}: {error.strerror}") from error


def load_or_start(folder: Path, settings: dict[str, Any]) -> list[EpisodeResult]:
    """The finished episodes in a folder whose scores are open; if there are none, its settings become these.

    Raises:
        EvaluationError, SettingsError: as `prepare`.
    """
    if (folder / SCORES).stat().st_size:
        check_unchanged(folder, _without_paths(read_settings(folder)), _without_paths(settings))
        return read(folder)
    files.write(folder / SETTINGS, json.dumps(settings, indent=2) + "\n", overwrite=True)
    return []


def _without_paths(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings without the paths of policies that a hash identifies: folders may be moved, or written otherwise."""
    policies = settings.get("policies")
    if not isinstance(policies, list):
        return settings
    known = [dict(policy) for policy in policies if isinstance(policy, dict)]
    return {**settings, "policies": [{**policy, "origin": None} if "sha256" in policy else policy for policy in known]}


def read_settings(folder: Path) -> dict[str, Any]:
    """The settings with which the evaluation in a folder was started.

    Raises:
        EvaluationError: if they cannot be read.
    """
    try:
        known = dict(json.loads((folder / SETTINGS).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise EvaluationError(f"{folder / SETTINGS} cannot be read ({error}); start again in another folder") from error
    return {"worlds": "single", **known}  # of which older versions write nothing


def folders_of(folders: Iterable[Path | str]) -> list[Path]:
    """The folders as a list; raises a `SettingsError` for a single one, since a text is a sequence of letters."""
    if isinstance(folders, str | bytes | PathLike):
        raise SettingsError(f"give a list of folders, such as [{str(folders)!r}], not {short_repr(folders)}")
    return [Path(folder) for folder in folders]
