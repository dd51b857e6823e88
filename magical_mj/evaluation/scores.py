"""The scores of an evaluation: ``scores.jsonl`` in its folder, with a line per finished episode.

Lines are appended and never altered (`magical_mj.utils.lines`). If a failed episode is played again, its new line
replaces the earlier ones when the file is read.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec

from magical_mj._version import __version__
from magical_mj.policies.interface import Episode, letters_of
from magical_mj.policies.loading import loader_in
from magical_mj.rendering.backend import drawn_by
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import EVERY_VARIANT
from magical_mj.utils.errors import EvaluationError, MissingFileError, check_name, short_repr
from magical_mj.utils.lines import Appender, appending, read_lines

SCORE_TOLERANCE: Final = 1e-9
"""Scores that differ by less than this are equal."""
SCORES: Final = "scores.jsonl"
MUJOCO_VERSION: Final = version("mujoco")
"""Read from the package's metadata: importing MuJoCo is slow, and may fail without OpenGL."""

StoredInt = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
"""An integer that tables of scores can hold."""
StoredText = Annotated[str, msgspec.Meta(max_length=10_000)]
"""A text of a record, such as a name. Names of intents, the longest ones, have 200 characters."""
Key = tuple[str, int, str, str, int, str]
"""Identifies an episode: policy, run, task, variant, seed, shift."""
NO_SETTINGS_NEEDED: Final = ("", "instruction")
"""The descriptions of a task that need no settings: none, or the instruction for policies that read it."""


@dataclass
class Outcome:
    """The outcome of an episode."""

    actions: list[Any] = dataclasses.field(default_factory=list)
    score: float = 0.0
    """In [0, 1]. Meaningless if the policy failed."""
    others_moved: int | None = None
    """The side effects (`TaskSpec.side_effects`). None if the task does not define them."""
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
        gl: the renderer of pictures: OpenGL's backend, such as "egl", or "software".
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
        others_moved: the number of moved blocks that the goal does not name. None if it is not known.
    """

    policy: StoredText
    run: StoredInt
    task: StoredText
    variant: StoredText
    seed: StoredInt
    score: Annotated[float, msgspec.Meta(ge=0, le=1)]
    steps: StoredInt
    seconds: float
    rules: StoredText
    preset: StoredText | None
    version: StoredText
    mujoco: StoredText
    gl: StoredText
    actions: str
    failure: StoredText | None = None
    scene: StoredText | None = None
    worlds: StoredText = "single"
    split: StoredText = "test"
    shift: StoredText = ""
    wrap: StoredText = ""
    body: StoredText = GRIPPER
    retry: StoredInt = 0
    given: StoredText = ""
    demonstrations: StoredText = ""
    other: StoredText = ""
    other_score: Annotated[float, msgspec.Meta(ge=0, le=1)] | None = None
    others_moved: StoredInt | None = None

    @classmethod
    def of(cls, episode: Episode, outcome: Outcome, **facts: Any) -> EpisodeResult:
        """The result of an episode that this process has just played. `facts` are all other fields."""
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
            others_moved=None if outcome.failure else outcome.others_moved,
            **{"gl": drawn_by(), **facts},
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
    """The name of a policy in reports, with its body, wrapper and description of tasks, if they are unusual."""
    name = policy if body == GRIPPER else f"{policy} with {body}"
    name = name if given in NO_SETTINGS_NEEDED else f"{name}, {given}"
    return f"{name} in {wrap}" if wrap else name


_FIELDS: Final = tuple(field.name for field in dataclasses.fields(EpisodeResult))
_KNOWN: Final = frozenset(_FIELDS)
_USUAL: Final = tuple(
    (field.name, field.default) for field in dataclasses.fields(EpisodeResult)[_FIELDS.index("split") :]
)
"""The fields that older versions did not write, with their default values."""

_RETRY: Final = b'"retry": '
"""Only the line of an episode that was played again contains this."""


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
        problem = f"holds no {SCORES}" if folder.exists() else "does not exist"
        raise MissingFileError(f"{folder} {problem}; {remedy}")
    known: dict[tuple[Any, ...], int] = {}
    names: dict[str, str] = {}
    retried = _retried(path)
    for number, line in read_lines(path, EvaluationError):
        result = _parse_line(path, number, line)
        # each name once: the keys of a million episodes then take 200 MB instead of 400
        key: Any = tuple(names.setdefault(part, part) if isinstance(part, str) else part for part in result.key)
        if (other := known.setdefault((*key, result.retry), number)) != number:
            raise EvaluationError(f"{path}, line {number}: the same episode as line {other}; delete one")
        if result.retry == retried.get(key, result.retry):
            yield result
        elif result.failure is None:
            raise EvaluationError(
                f"{path}, line {number}: the episode did not fail, so no line can replace it; delete one of the two"
            )
    if not known:
        raise EvaluationError(f"{path} holds no finished episode yet")


def _retried(path: Path) -> dict[Key, int]:
    """The number of the last retry of each episode that was played again after a failure."""
    retries: dict[Key, int] = {}
    for number, line in read_lines(path, EvaluationError):
        if _RETRY in line:
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


def frame(results: Sequence[EpisodeResult]) -> Any:
    """The episodes as a pandas frame, one row each."""
    import pandas as pd

    return pd.DataFrame(results, columns=list(_FIELDS)).astype({"other_score": float})


def open_scores(folder: Path) -> AbstractContextManager[Appender]:
    """A context with the score file of a folder, open for appending, and locked so that only one process writes."""
    path = folder / SCORES
    return appending(path, busy=EvaluationError(f"another evaluation is writing to {path}"))
