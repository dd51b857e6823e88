"""The folder of an evaluation: ``run.json`` with its settings, and the scores (see `magical_mj.evaluation.scores`).

An evaluation that is resumed may grow, but keeps its other settings.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from itertools import combinations
from os import PathLike
from pathlib import Path
from typing import Any, Final, Protocol

import msgspec
from msgspec import Struct

from magical_mj.evaluation.scores import SCORES, EpisodeResult, StoredInt, method_name, open_scores, read
from magical_mj.policies.facts import Learnt
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, SettingsError, short_repr
from magical_mj.utils.imports import announced, imported
from magical_mj.utils.lines import Appender
from magical_mj.utils.settings import check_unchanged

SETTINGS: Final = "run.json"
FORMAT_GROUP: Final = "magical_mj.result_formats"
"""The entry-point group of other formats, such as ``leaderboard = "magical_mj.leaderboard.entry:ENTRIES"``."""
MOST_SETTINGS: Final = 10_000_000
"""The largest size of a settings file in bytes."""
RECORDED: Final = ("uses", "loaded")
"""Fields of a policy that older versions did not write, and that need not be the same when an evaluation is resumed."""
CODE: Final = "code of "
"""The beginning of the names of settings with hashes of code."""
EXTENDABLE: Final = ("policies", "environments", "shifts")
"""The settings that a resumed evaluation may extend. It may add seeds as well."""
OLD_DEFAULTS: Final = {
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


class ResultFormat(Protocol):
    """What an entry point of `FORMAT_GROUP` refers to: official results by the protocol, stored in another way."""

    def holds(self, path: Path) -> bool:
        """Whether the path is such a file or folder."""
        ...

    def episodes(self, path: Path) -> Iterable[EpisodeResult]:
        """The episodes in it. Raises an `EvaluationError` if it is damaged."""
        ...


@cache
def _formats() -> tuple[ResultFormat, ...]:
    points = announced("format of results", FORMAT_GROUP, (), str.isidentifier, 'mine = "package.module:MINE"')
    return tuple(imported("format of results", name, point, EvaluationError) for name, point in points.items())


def other_format(path: Path) -> ResultFormat | None:
    """The format of the results at this path. None if it is the folder of an evaluation."""
    return next((known for known in _formats() if known.holds(path)), None)


class PlayedPolicy(Learnt, frozen=True, kw_only=True):
    """The fields of a policy in the settings of an evaluation that reports and entries read."""

    name: str
    run: StoredInt
    sha256: str = ""
    code: str = ""
    given: str = ""
    uses: list[str] = []  # noqa: RUF012 (msgspec copies it)
    loaded: str = ""


class Played(Struct):
    """The settings in every ``run.json``. `OLD_DEFAULTS` completes those of older versions."""

    policies: list[PlayedPolicy]
    environments: list[str]
    shifts: list[str]
    first_seed: StoredInt
    episodes: StoredInt


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
    def open(self) -> Iterator[Appender]:
        """Opens the score file (`open_scores`), updates `done`, and replaces the settings of a smaller evaluation.

        Another process may have started an evaluation in the meantime: the errors are those of the constructor.
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
        files.write(self._path / SETTINGS, json.dumps(self._settings, indent=2) + "\n", overwrite=True)


def check_continues(folder: Path, settings: dict[str, Any]) -> None:
    """Raises a `SettingsError` unless an evaluation with these settings continues, or adds to, the one in a folder."""
    before = read_settings(folder)
    for name in EXTENDABLE:
        if name not in settings:
            continue
        now = [_identity(item) for item in settings[name]]
        if absent := [item for item in before[name] if _identity(item) not in now]:
            listed = ", ".join(map(_named, absent))
            raise SettingsError(
                f"{folder} holds {name} that are left out here, or have changed: {listed}. A resumed evaluation may "
                f"have more {name}, but must keep all of these"
            )
    held, wanted = (range(each["first_seed"], each["first_seed"] + each["episodes"]) for each in (before, settings))
    if held.start < wanted.start or held.stop > wanted.stop:
        raise SettingsError(
            f"{folder} holds the scenes {held.start} to {held.stop - 1} of its split, but {wanted.start} to "
            f"{wanted.stop - 1} are requested: a resumed evaluation may have more scenes, but must keep all of these"
        )
    free = {*EXTENDABLE, "episodes", "first_seed"}
    free |= {name for name in settings if name.startswith((CODE, "demonstrations of ")) and name not in before}
    check_unchanged(folder, before, {name: value for name, value in settings.items() if name not in free})


def _named(item: Any) -> str:
    """The name of a missing item for an error. A policy is shown with its hash, since its file may have changed."""
    if not isinstance(item, dict):
        return str(item)
    hashes = [f"{name} {item[name][:12]}..." for name in ("sha256", "code") if name in item]
    facts = [*hashes[:1], *([item["given"]] if item.get("given") else [])]
    return f"{item['name']} ({', '.join(facts)})" if facts else item["name"]


def _identity(item: Any) -> Any:
    """The item. A policy has no facts of `RECORDED` here, and with a hash no path: its folder may have been moved."""
    if not isinstance(item, dict):
        return item
    known = {name: value for name, value in item.items() if name not in RECORDED}
    return {**known, "origin": None} if "sha256" in item else known


def read_settings(folder: Path) -> dict[str, Any]:
    """The recorded settings of the evaluation in a folder.

    Raises:
        EvaluationError: if there are none, or they lack a field of `Played`.
    """
    path = folder / SETTINGS
    try:
        content = files.read_foreign(path, most=MOST_SETTINGS, error=EvaluationError)
        known = {**OLD_DEFAULTS, **msgspec.json.decode(content, type=dict[str, Any])}
        msgspec.convert(known, Played)
    except (OSError, msgspec.MsgspecError, UnicodeError, RecursionError) as error:
        raise EvaluationError(f"{path} does not belong to an evaluation ({error}); choose another folder") from error
    return known


def recorded_settings(folder: Path) -> dict[str, Any]:
    """The settings of `read_settings`. Empty if there are none, as in entries."""
    return read_settings(folder) if (folder / SETTINGS).exists() else {}


def recorded_policies(settings: Mapping[str, Any]) -> list[PlayedPolicy]:
    """The policies in the settings of an evaluation."""
    return msgspec.convert(settings.get("policies", []), list[PlayedPolicy])


def recorded_method(policy: PlayedPolicy, settings: Mapping[str, Any]) -> str:
    """The name of an evaluation's policy in reports."""
    return method_name(policy.name, settings["body"], settings["wrap"], policy.given)


def check_trainings(folders: Iterable[Path], name: str | None = None) -> None:
    """Checks the runs of the methods in the folders of evaluations, or only of the policy `name`.

    Raises:
        EvaluationError: if two runs of a method have equal policies, since each must be a separate training; or if two
            folders with a run, task and shift in common differ in the policy or in the code that they played with.
    """
    known = {folder: recorded_settings(folder) for folder in folders}
    played = [
        (folder, settings, policy)
        for folder, settings in known.items()
        for policy in recorded_policies(settings)
        if name in (None, policy.name)
    ]
    check_runs((recorded_method(policy, settings), policy.run, policy.sha256) for _, settings, policy in played)
    for (folder, settings, policy), (other, others, same) in combinations(played, 2):
        if (recorded_method(policy, settings), policy.run) != (recorded_method(same, others), same.run):
            continue
        common = {*settings["environments"]} & {*others["environments"]}
        fields = [field for field in PlayedPolicy.__struct_fields__ if field not in RECORDED]
        facts = {field: (getattr(policy, field), getattr(same, field)) for field in fields}
        facts |= {key: (settings[key], others[key]) for key in settings.keys() & others.keys() if key.startswith(CODE)}
        if common and (differing := [field for field, pair in facts.items() if pair[0] != pair[1]]):
            raise EvaluationError(
                f"run {policy.run} of {policy.name} is not the same in {folder} and {other}, which both hold "
                f"{min(common)}: they differ in {', '.join(differing)}; evaluate one of them with another --run or "
                "NAME=POLICY"
            )


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
    """The folders as a list, each once. A single path is a `SettingsError`: its letters would be taken as paths."""
    if isinstance(folders, str | bytes | PathLike):
        raise SettingsError(f"give a list of folders, such as [{str(folders)!r}], not {short_repr(folders)}")
    paths = list({path.resolve(): path for path in map(files.to_path, folders)}.values())
    for path in paths:
        if path.name in (SCORES, SETTINGS) and path.is_file():
            raise EvaluationError(f"{path} is a file of an evaluation: give its folder, {path.parent}")
    return paths
