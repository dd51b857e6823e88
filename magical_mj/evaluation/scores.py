"""The folder of an evaluation: ``run.json`` with its settings, and ``scores.jsonl`` with a line per finished episode.

Lines are appended and never altered. If a failed episode is played again, its new line replaces the earlier ones when
the file is read. A killed process may leave an incomplete last line. It is ignored by readers, and removed before more
lines are appended. An evaluation that is resumed may grow, but keeps its other settings.
"""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import IO, Annotated, Any, Final, NotRequired, TypedDict

import msgspec

from magical_mj._version import __version__
from magical_mj.evaluation.settings import MUJOCO_VERSION
from magical_mj.policies.interface import Episode, letters_of
from magical_mj.policies.loading import loader_in
from magical_mj.rendering.backend import drawn_by
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import EVERY_VARIANT
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, check_name, short_repr
from magical_mj.utils.settings import check_unchanged

SCORE_TOLERANCE: Final = 1e-9
"""Scores that differ by less than this are equal."""
SCORES: Final = "scores.jsonl"
SETTINGS: Final = "run.json"
MOST_SETTINGS: Final = 10_000_000
"""The largest size of a settings file in bytes."""

Natural = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
"""An integer that tables of scores can hold."""
Key = tuple[str, int, str, str, int, str]
"""Identifies an episode: policy, run, task, variant, seed, shift."""
PLAIN_GIFTS: Final = ("", "instruction")
"""The descriptions of a task that need no settings: none, or the instruction for policies that read it."""
GROWING: Final = ("policies", "environments", "shifts")
"""The settings that a resumed evaluation may extend. It may add seeds as well."""
OLDER: Final = {
    "worlds": "single",
    "split": "test",
    "first_seed": 0,
    "shifts": [""],
    "shift_protocol": 1,
    "wrap": "",
    "like": "",
    "body": GRIPPER,
}
"""The values of settings that older versions did not write."""


class PlayedPolicy(TypedDict):
    """A policy in the settings of an evaluation."""

    name: str
    run: Natural
    sha256: NotRequired[str]
    code: NotRequired[str]
    given: NotRequired[str]
    demonstration_set: NotRequired[Natural]
    played_in: NotRequired[str]


class Played(TypedDict):
    """The settings in every ``run.json``. `OLDER` completes those of older versions."""

    policies: list[PlayedPolicy]
    environments: list[str]
    shifts: list[str]
    first_seed: Natural
    episodes: Natural


@dataclass
class Outcome:
    """The outcome of an episode."""

    actions: list[Any] = dataclasses.field(default_factory=list)
    score: float = 0.0
    """In [0, 1]. Meaningless if the policy failed."""
    failure: str | None = None
    """Why the policy failed. None if it did not."""
    seconds: float = 0.0
    cause: Exception | None = None
    """The error that the policy raised. None if it raised none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """One played episode, with everything that a replay needs: a line of ``scores.jsonl``.

    Attributes:
        policy: the method's name. By default, the name of its class or function.
        run: the number of the run of the method.
        task: the task's name. A name from a file is untrusted: see `magical_mj.utils.imports` before looking it up.
        variant: the variant's name.
        seed: the scene's seed.
        score: in [0, 1]; 0 if the policy failed.
        steps: the number of actions.
        seconds: the duration of the episode, wall clock.
        rules: the scoring rules.
        preset: the preset of the observations. None if the policy uses none, or if they have no name.
        version: the version of this package.
        mujoco: MuJoCo's version.
        gl: the OpenGL backend.
        actions: a letter for each action. A replay needs them.
        failure: why the policy failed. None if it did not.
        scene: the digest of the episode's initial scene. None in files of older versions.
        worlds: "single" if MuJoCo itself simulated it. Scores of "batched" worlds are approximate.
        split: the split of the seed; see `magical_mj.tasks.registry.SPLITS`.
        shift: the shift, such as "camera:3". Empty without a shift.
        wrap: the wrapper around the environment, such as "mine:Wrapper". Empty without one.
        body: the robot's body.
        retry: how many times the episode had failed before and was played again (``retry_failed``).
        given: the description of the task that the policy received, such as "8 demonstrations in 4 scenes". Empty if
            it received none.
        demonstrations: the digest of its demonstrations. Empty without demonstrations.
        other: in a control, the task whose demonstrations or instruction the policy received.
        other_score: in a control, the score of the other task's intent, in [0, 1]. None if that intent has no meaning
            in the scene or holds at the start, or if the policy failed.
    """

    policy: str
    run: Natural
    task: str
    variant: str
    seed: Natural
    score: Annotated[float, msgspec.Meta(ge=0, le=1)]
    steps: Natural
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
    split: str = "test"
    shift: str = ""
    wrap: str = ""
    body: str = GRIPPER
    retry: Natural = 0
    given: str = ""
    demonstrations: str = ""
    other: str = ""
    other_score: Annotated[float, msgspec.Meta(ge=0, le=1)] | None = None

    @classmethod
    def of(cls, episode: Episode, outcome: Outcome, **facts: Any) -> EpisodeResult:
        """The result of an episode that this process has just played.

        The facts are `policy`, `rules`, `preset`, `scene` and the fields after it. If a renderer was chosen, they
        include `gl`.
        """
        with_gl: dict[str, Any] = {"gl": drawn_by(), **facts}
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
            actions=letters_of(outcome.actions),
            failure=outcome.failure,
            **with_gl,
        )

    @property
    def key(self) -> Key:
        """Identifies this episode."""
        return self.policy, self.run, self.task, self.variant, self.seed, self.shift

    @property
    def title(self) -> str:
        """The run, the environment and the seed, in words."""
        environment = " ".join(filter(None, (self.task, self.variant, self.shift)))
        return f"run {self.run}, {environment}, seed {self.seed}"

    @property
    def method(self) -> str:
        """The name of the method in reports: the policy, with what `method_name` adds."""
        return method_name(self.policy, self.body, self.wrap, self.given)

    def line(self) -> str:
        """The line of the file. Fields that older versions did not write are left out if they have default values."""
        values = {name: value for name, value in dataclasses.asdict(self).items() if (name, value) not in _USUAL}
        return json.dumps(values, ensure_ascii=False) + "\n"


def method_name(policy: str, body: str, wrap: str, given: str = "") -> str:
    """The name of a policy in reports, with its body, wrapper and description of tasks.

    It does not contain the gripper or the instruction.
    """
    name = policy if body == GRIPPER else f"{policy} with {body}"
    name = name if given in PLAIN_GIFTS else f"{name}, {given}"
    return f"{name} in {wrap}" if wrap else name


_FIELDS: Final = tuple(field.name for field in dataclasses.fields(EpisodeResult))
_KNOWN: Final = frozenset(_FIELDS)
_USUAL: Final = tuple(
    (field.name, field.default) for field in dataclasses.fields(EpisodeResult)[_FIELDS.index("split") :]
)
"""The fields that older versions did not write, with their default values."""

_RETRY: Final = b'"retry": '
"""Only the line of an episode that was played again contains this."""
_BEGINNING: Final = b'{"policy": '
"""Each line begins with this."""


def parse(line: str | bytes) -> EpisodeResult:
    """The episode in a line. Raises a ValueError with an explanation if the line is invalid."""
    try:
        values = msgspec.json.decode(line)
        if not isinstance(values, dict) or not values.keys() <= _KNOWN:
            raise ValueError(f"it must be an object with the keys {', '.join(_FIELDS)}")
        result = msgspec.convert(values, EpisodeResult)
    except RecursionError:
        raise ValueError("its lists are nested too deeply") from None
    except msgspec.MsgspecError as error:
        raise ValueError(str(error)) from None
    check_name("variant", result.variant, EVERY_VARIANT)
    texts = {name: value for name, value in values.items() if isinstance(value, str) and name != "failure"}
    if not "".join(texts.values()).isprintable():
        name = next(name for name, text in texts.items() if not text.isprintable())
        raise ValueError(f"{name} must be a text of printable characters, not {short_repr(texts[name])}")
    return result


def read(folder: Path) -> list[EpisodeResult]:
    """The finished episodes in a folder.

    Raises:
        EvaluationError: if the file is missing or a line is invalid, or an episode occurs twice.
    """
    return list(episodes_in(folder))


def episodes_in(folder: Path) -> Iterator[EpisodeResult]:
    """Yields the episodes of `read` one after another, since the file may be larger than memory."""
    path = folder / SCORES
    if not path.is_file():
        remedy = f"magical-mj evaluate --out {folder} makes one"
        if loader_in(folder) is not None:  # a training's folder
            remedy = f"it holds a policy: magical-mj evaluate --policy {folder} --out ANOTHER evaluates it"
        raise EvaluationError(f"{folder} holds no {SCORES}; {remedy}")
    lines: dict[tuple[Any, ...], int] = {}
    names: dict[str, str] = {}
    retried = _retried(path)
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if _is_half(line):
                break
            result = _parse_line(path, number, line)
            # each name once: the keys of a million episodes then take 200 MB instead of 400
            key: Any = tuple(names.setdefault(part, part) if isinstance(part, str) else part for part in result.key)
            if (other := lines.setdefault((*key, result.retry), number)) != number:
                raise EvaluationError(f"{path}, line {number}: the same episode as line {other}; delete one")
            if result.retry == retried.get(key, result.retry):
                yield result
            elif result.failure is None:
                raise EvaluationError(
                    f"{path}, line {number}: the episode did not fail, but another line replaces it; delete one"
                )
    if not lines:
        raise EvaluationError(f"{path} holds no finished episode yet")


def _retried(path: Path) -> dict[Key, int]:
    """The number of the last retry of each episode that was played again after a failure."""
    retries: dict[Key, int] = {}
    with path.open("rb") as file:
        for number, line in enumerate(file, start=1):
            if _RETRY in line and not _is_half(line):
                result = _parse_line(path, number, line)
                retries[result.key] = max(result.retry, retries.get(result.key, 0))
    return retries


def _parse_line(path: Path, number: int, line: bytes) -> EpisodeResult:
    try:
        return parse(line)
    except ValueError as error:
        raise EvaluationError(
            f"{path}, line {number}: {error}. Correct the line, or delete it: evaluate --resume plays missing episodes"
        ) from error


def _is_half(line: bytes) -> bool:
    """Whether a killed process left this line incomplete. A line with several episodes has lost line ends instead."""
    return not line.endswith(b"\n") and line.count(_BEGINNING) < 2


def frame(results: Sequence[EpisodeResult]) -> Any:
    """The episodes as a pandas frame, one row each, in a fixed order."""
    import pandas as pd

    rows = [dataclasses.asdict(result) for result in sorted(results, key=lambda result: result.key)]
    return pd.DataFrame(rows, columns=list(_FIELDS)).astype({"other_score": float})


@contextmanager
def open_scores(folder: Path) -> Iterator[IO[bytes]]:
    """A context with the score file of a folder, open for `append`, and locked so that only one process writes."""
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
        while lines:  # a full disk may write only a part before it raises an error
            lines = lines[file.write(lines) :]
    except OSError as error:  # its message lacks the path
        raise OSError(error.errno, error.strerror, file.name) from error


class EvaluationFolder:
    """The folder of an evaluation. It is new, or with `resume`, an evaluation that these settings continue.

    If it has no finished episodes, the evaluation is started anew.

    Raises:
        EvaluationError: if the folder cannot be written to, holds other files, or holds an evaluation but `resume` is
            false.
        SettingsError: if the evaluation was started with other settings.

    Attributes:
        done: the finished episodes in it.
    """

    def __init__(self, path: Path, settings: dict[str, Any], *, resume: bool) -> None:
        self._path, self._settings = path, settings
        scores = path / SCORES
        if scores.exists() and not scores.is_file():
            raise EvaluationError(f"{scores} is not a plain file; choose another folder")
        if scores.exists() and scores.stat().st_size and not resume:
            raise EvaluationError(f"{path} holds an evaluation already; --resume continues it (resume=True)")
        if (path / SETTINGS).exists():
            read_settings(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
            with open_scores(path):
                self._read()
                if not self.done:
                    self._write_settings()
        except OSError as error:
            raise EvaluationError(f"cannot write into {path}: {error.strerror}") from error

    @contextmanager
    def open(self) -> Iterator[IO[bytes]]:
        """Opens the score file as `open_scores` does, then updates `done` and writes the settings.

        Raises:
            EvaluationError: if another process is writing.
            SettingsError: if another process has started an evaluation with other settings.
        """
        with open_scores(self._path) as file:
            self._read()
            self._write_settings()
            yield file

    def _read(self) -> None:
        self.done: list[EpisodeResult] = []
        if (self._path / SCORES).stat().st_size:
            check_continues(self._path, self._settings)
            self.done = read(self._path)

    def _write_settings(self) -> None:
        """Replaces the settings of a smaller evaluation."""
        files.write(self._path / SETTINGS, json.dumps(self._settings, indent=2) + "\n", overwrite=True)


def check_continues(folder: Path, settings: dict[str, Any]) -> None:
    """Raises a `SettingsError` unless an evaluation with these settings continues, or adds to, the one in a folder."""
    before = read_settings(folder)
    for name in (name for name in GROWING if name in settings):
        now = [_identity(item) for item in settings[name]]
        if absent := [item for item in before[name] if _identity(item) not in now]:
            listed = ", ".join(map(_named, absent))
            raise SettingsError(
                f"{folder} holds {name} that are left out here, or have changed: {listed}. A resumed evaluation may "
                f"have more {name}, but must keep all of these"
            )
    (first, last), (least, most) = (
        (known["first_seed"], known["first_seed"] + known["episodes"] - 1) for known in (before, settings)
    )
    if not (least <= first and last <= most):
        raise SettingsError(
            f"{folder} holds the scenes {first} to {last} of its split, but {least} to {most} are requested: a "
            "resumed evaluation may have more scenes, but must keep all of these"
        )
    free = (*GROWING, "episodes", "first_seed")
    new = {name for name in settings if name.startswith(("code of ", "demonstrations of ")) and name not in before}
    others = settings.keys() - new - set(free)
    check_unchanged(folder, before, {name: value for name, value in settings.items() if name in others})


def _named(item: Any) -> str:
    """The name of a missing item for an error. A policy is shown with its hash, since its file may have changed."""
    if not isinstance(item, dict):
        return str(item)
    hashes = [f"{name} {item[name][:12]}..." for name in ("sha256", "code") if name in item]
    facts = [*hashes[:1], *([item["given"]] if item.get("given") else [])]
    return f"{item['name']} ({', '.join(facts)})" if facts else item["name"]


def _identity(item: Any) -> Any:
    """The item, without its path if it is a policy with a hash: its folder may have been moved."""
    return {**item, "origin": None} if isinstance(item, dict) and "sha256" in item else item


def read_settings(folder: Path) -> dict[str, Any]:
    """The recorded settings of the evaluation in a folder.

    Raises:
        EvaluationError: if there are none, or they lack a field of `Played`.
    """
    path = folder / SETTINGS
    try:
        content = files.read_foreign(path, most=MOST_SETTINGS, error=EvaluationError)
        known = {**OLDER, **msgspec.json.decode(content, type=dict[str, Any])}
        msgspec.convert(known, Played)
    except (OSError, msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise EvaluationError(f"{path} does not belong to an evaluation ({error}); choose another folder") from error
    return known


def recorded_settings(folder: Path) -> dict[str, Any]:
    """The settings in an evaluation's ``run.json``. Empty if there are none, as in entries, or they are invalid."""
    try:
        return read_settings(folder)
    except EvaluationError:
        return {}


def recorded_policies(settings: Mapping[str, Any]) -> list[tuple[str, str, int, str]]:
    """Name, method, run and SHA-256 (empty without a file) of an evaluation's policies."""
    return [
        (
            row["name"],
            method_name(row["name"], settings["body"], settings["wrap"], row.get("given", "")),
            row["run"],
            row.get("sha256", ""),
        )
        for row in settings.get("policies", ())
    ]


def recorded_sets(settings: Mapping[str, Any]) -> dict[str, set[int]]:
    """Name -> the sets of the package's demonstrations from which the policies of an evaluation learnt."""
    return _recorded(settings, "demonstration_set", 1)


def recorded_variants(settings: Mapping[str, Any]) -> dict[str, set[str]]:
    """Name -> the variants whose scenes the policies of an evaluation played in their training."""
    return _recorded(settings, "played_in", "Demo")


def _recorded(settings: Mapping[str, Any], fact: str, usual: Any) -> dict[str, set[Any]]:
    """Name -> the values of a recorded fact about the policies with this name. The usual value is not recorded."""
    values: dict[str, set[Any]] = defaultdict(set)
    for row in settings.get("policies", ()):
        values[row["name"]].add(row.get(fact, usual))
    return values


def check_runs(policies: Iterable[tuple[str, int, str]]) -> None:
    """Raises an `EvaluationError` if two runs of a method have equal policies, given as (name, run, SHA-256 or "")."""
    runs: dict[tuple[str, str], set[int]] = defaultdict(set)
    for name, run, digest in policies:
        if digest:
            runs[name, digest].add(run)
    for (name, digest), same in runs.items():
        if len(same) > 1:
            raise EvaluationError(
                f"the runs {', '.join(map(str, sorted(same)))} of {name} have equal policies (sha256 "
                f"{digest[:12]}...), which count as one run: leave the others out"
            )


def folders_of(folders: Iterable[Path | str]) -> list[Path]:
    """The folders as a list. A single path is a `SettingsError`, since its letters would be taken as paths."""
    if isinstance(folders, str | bytes | PathLike):
        raise SettingsError(f"give a list of folders, such as [{str(folders)!r}], not {short_repr(folders)}")
    return [files.to_path(folder) for folder in folders]
