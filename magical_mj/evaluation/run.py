"""Evaluations: they check the settings, read finished episodes from the folder, and play the others in workers."""

from __future__ import annotations

import inspect
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from dataclasses import replace
from itertools import chain, product
from typing import TYPE_CHECKING, Any, Final

import cloudpickle
import numpy as np

from magical_mj._version import __version__
from magical_mj.actions import ACTIONS
from magical_mj.envs.presets import observed
from magical_mj.evaluation.folder import EvaluationFolder, check_runs
from magical_mj.evaluation.scores import MUJOCO_VERSION, SCORE_TOLERANCE, EpisodeResult, Key, frame
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.evaluation.worker import Player, Unit, prepared, single_env
from magical_mj.policies.interface import reason
from magical_mj.policies.loading import Source
from magical_mj.shifts.registry import code_digests
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import EvaluationError, MagicalError, SettingsError, WorkerError
from magical_mj.utils.parallel import cores, map_here, map_unordered
from magical_mj.utils.settings import described, with_values

if TYPE_CHECKING:
    import pandas as pd

    from magical_mj.demos.stored import Watch

STEPS_PER_WORKER: Final = 2000
"""The smallest number of actions per process. Starting a process takes longer than playing fewer."""
CHECKED: Final = 3
"""The largest number of known episodes of an environment that are played again when an evaluation continues."""
FIRST_EPISODES: Final = 10
"""The evaluation stops if this number of a policy's first planned episodes fail with the same type of error."""
COMPARED_STEPS: Final = 40
"""The most steps that are compared."""
PICTURE_STEPS: Final = 10
"""Pictures are compared after every tenth step."""
PICTURE_SIZE: Final = 32  # pixels


def evaluate(
    policy: Any, *, name: str | None = None, watch: Callable[[EpisodeResult], None] = lambda _: None, **settings: Any
) -> pd.DataFrame:
    """Plays a policy's episodes in the test scenes of some environments, and returns all scores.

    Example:
        >>> scores = magical_mj.evaluate("noop", tasks="MoveToRegion", variants="Demo", episodes=2, jobs=1)
        >>> scores["score"].tolist()  # doing nothing does not reach the region
        [0.0, 0.0]

    Args:
        policy: "expert", "random", "noop", "module:object", the folder of a training, a model file (.zip of
            stable-baselines3, .onnx), a `Policy`, or a function from observation to action; or several policies, as a
            list or as a mapping from names to policies. Policies with the same name are successive runs of one method.
        name: the policy's name in results, instead of that of its class, function or file. Several policies are
            successive runs of a method with this name.
        watch: called with the result of each finished episode.
        settings: the fields of `magical_mj.evaluation.EvaluationSettings`, such as ``tasks="FindDupe", episodes=10``.

    Returns:
        A pandas frame with a row for each episode: policy by policy, then by environment, seed and shift, in the given
        order. Its columns are the fields of `magical_mj.evaluation.EpisodeResult`.

    Raises:
        SettingsError, UnknownNameError: if a setting is invalid, or differs from those of a resumed evaluation; or if
            an episode with a user's shift is not the same when it is repeated.
        EvaluationError: if the folder holds other files, two runs of a method have equal policy files, a worker
            dies repeatedly, or the first episodes of a policy all fail.
        TaskError: if a task of another package has no scene for a seed, or an invalid score.
        MissingExtraError: if an extra is not installed.
    """
    if name is not None and isinstance(policy, Mapping):
        raise SettingsError(f"the policies have names already ({', '.join(map(str, policy))}): leave out name")
    named = policy if name is None else {name: policy}
    evaluation = Evaluation(named, with_values(EvaluationSettings, settings))
    for result in evaluation.play():
        watch(result)
    return frame(evaluation.in_order())


def _signature() -> inspect.Signature:
    """The signature of `evaluate` with all settings, for `help` and editors."""
    kind = inspect.Parameter.KEYWORD_ONLY
    known = [
        inspect.Parameter(name, kind, default=setting.default, annotation=setting.kind)
        for name, setting in described(EvaluationSettings).items()  # pyright: ignore[reportArgumentType]
    ]
    *own, _ = inspect.signature(evaluate).parameters.values()
    return inspect.Signature([*own, *known], return_annotation="pd.DataFrame")


evaluate.__signature__ = _signature()


class Evaluation:
    """`evaluate` in two steps: the constructor checks and prepares, `play` plays.

    Attributes:
        settings: the settings of the evaluation.
        sources: the policies.
        scores: the results of the finished episodes.
        units: the work that remained at construction, or at the last call of `play`.
    """

    def __init__(self, policy: Any, settings: EvaluationSettings, watch: Watch = lambda _, __: None) -> None:
        """Checks the settings and reads finished episodes, but plays none. Raises the errors of `evaluate`.

        If a policy uses demonstrations of intents that are not in the user's cache, the expert makes them. `watch` is
        called with the number of finished demonstrations, and their total number.
        """
        settings.check_extras()
        self.sources, settings = prepared(policy, settings)
        self.settings = settings
        check_runs((source.name, source.run, source.digest.get("sha256", "")) for source in self.sources)
        if settings.wrap:
            source, pair = self.sources[0], settings.environments[0]
            single_env(Unit(source.name, source.run, *pair, ()), settings, observed=True).close()  # fail early
        self._labels = settings.shift_labels(self.sources)
        check_repeatable(settings, self.sources, self._labels)
        self._player = Player(self.sources, settings, watch)
        self._cause: Exception | None = None
        self.scores: list[EpisodeResult] = []
        self._folder: EvaluationFolder | None = None
        if settings.out is not None:
            recorded = {**settings.recorded(self.sources), **self._player.starts.recorded}
            self._folder = EvaluationFolder(settings.out, recorded, resume=settings.resume)
        self.units = self._remaining()

    @property
    def steps(self) -> int:
        """The number of actions in the remaining units."""
        return sum(len(unit.seeds) * task_spec(unit.task).horizon(self.settings.rules) for unit in self.units)

    def in_order(self) -> list[EpisodeResult]:
        """The results of the finished episodes, in the order of the policies, environments, seeds and shifts."""
        policies, pairs = list(self._player.policies), self.settings.environments

        def place(result: EpisodeResult) -> tuple[int, int, int, int]:
            policy, pair = (result.policy, result.run), (result.task, result.variant)
            shift = self._labels[result.task].index(result.shift)
            return policies.index(policy), pairs.index(pair), result.seed, shift

        return sorted(self.scores, key=place)

    def play(self) -> Iterator[EpisodeResult]:
        """Plays the remaining episodes and yields each result once it is in the file."""
        self._check_repeats()  # before anything is written
        with self._folder.open() if self._folder else nullcontext() as file:
            self.units = self._remaining()
            for results in self._trusted_results():
                _check_versions(results)
                if file is not None:
                    file.append("".join(map(EpisodeResult.line, results)).encode())
                self.scores += results
                yield from results

    def _check_repeats(self) -> None:
        """Raises a `SettingsError` if a policy does not repeat its known episodes, so that its scores would be mixed.

        Hashes do not cover an object in memory, or files that a policy, shift, wrapper or task reads. So the first
        known episode of each environment and of each shift is played again. If it differs, the next two decide:
        rounding errors of a network depend on how many episodes are in one batch.
        """
        if self.settings.batched or not self.scores:  # scores of batches are approximate
            return
        for source in self.sources:
            own = [result for result in self.scores if (result.policy, result.run) == (source.name, source.run)]
            known: dict[tuple[str, ...], list[EpisodeResult]] = defaultdict(list)
            for result in own:
                if result.failure is None:
                    known[(result.shift,) if result.shift else (result.task, result.variant)].append(result)
            if not known:
                continue
            with closing(Player([_copied(source)], self.settings)) as player:
                different = [results for results in known.values() if not _are_repeated(player, results[:CHECKED])]
                if not different or (isinstance(source.origin, str) and not _is_repeatable(player, different[0][0])):
                    continue
            raise SettingsError(
                f"{self.settings.out} holds episodes of another policy named {source.name}, or of other code: "
                f"{different[0][0].title} and {len(different) - 1} other environments or shifts differ when they are "
                "played again. Evaluate it in another folder. If it is the same policy, it is random: draw its random "
                "numbers from episode.rng(), or give it as module:object"
            )

    def _remaining(self) -> list[Unit]:
        """The units that must still be played. Sets `scores` to the finished episodes.

        Units with long episodes come first, so that all workers end at about the same time.
        """
        settings, units = self.settings, list[Unit]()
        done = {result.key: result for result in (self._folder.done if self._folder else self.scores)}
        for task, variant in settings.environments:
            for source, shift in product(self.sources, self._labels[task]):
                every = Unit(source.name, source.run, task, variant, (), shift)
                new, again = list[int](), list[Unit]()
                for seed in settings.seeds:
                    known = done.get(every.key(seed))
                    if known is None:
                        new.append(seed)
                    elif settings.retry_failed and known.failure is not None:
                        again.append(replace(every, seeds=(seed,), retry=known.retry + 1))
                        del done[known.key]
                together = settings.batched or (source.batches and not settings.wrap)
                size = settings.side_by_side if together else 1
                units += [replace(every, seeds=tuple(new[first : first + size])) for first in range(0, len(new), size)]
                units += again
        self.scores = list(done.values())
        return sorted(units, key=lambda unit: -task_spec(unit.task).horizon(settings.rules))

    def _trusted_results(self) -> Iterator[list[EpisodeResult]]:
        """The results of all units, unless a policy always fails.

        The results of a policy are held back until one of its first episodes succeeds, or two fail with different types
        of errors. If all fail with the same type, an error is raised, and none is yielded. The first planned episodes
        decide, because the first finished ones depend on the number of workers.
        """
        planned: dict[tuple[str, int], list[Key]] = defaultdict(list)
        for unit in self.units:
            planned[unit.policy, unit.run] += map(unit.key, unit.seeds)
        proven = {(result.policy, result.run) for result in self.scores}
        held: dict[tuple[str, int], list[EpisodeResult]] = defaultdict(list)
        failed: dict[tuple[str, int], list[EpisodeResult]] = defaultdict(list)
        for result in chain.from_iterable(self._play_units()):
            policy = result.policy, result.run
            first, failures = planned[policy][:FIRST_EPISODES], failed[policy]
            held[policy].append(result)
            if policy not in proven and result.key in first:
                failures.append(result)
                if result.failure is None or _error_type(result) != _error_type(failures[0]):
                    proven.add(policy)
                elif len(failures) == len(first):
                    raise _all_failed_error(failures) from self._cause
            if policy in proven:
                yield held.pop(policy)

    def _play_units(self) -> Iterator[list[EpisodeResult]]:
        player, workers = self._player, self._workers()
        if workers == 0:
            played = map_here(player, self.units)
        else:
            played = map_unordered(player, self.units, workers, self.settings.backend, self.settings.address)
        results: list[EpisodeResult]
        try:
            with closing(played), closing(player):
                for results, self._cause in played:
                    yield results
        except WorkerError as error:
            raise EvaluationError(f"{error}; --resume continues (resume=True)") from error

    def _workers(self) -> int | None:
        """The number of worker processes. 0: this process plays the episodes. None: as many as the cluster has.

        Raises:
            SettingsError: if the settings need worker processes, and a policy cannot be sent to them.
        """
        settings, local = self.settings, self.settings.backend == "local"
        if local and settings.jobs == 1:
            return 0
        problem = self._unsendable()
        if local and settings.jobs is None:
            alone = settings.batched or problem is not None  # processes do not share an accelerator
            return 0 if alone else min(cores(), self.steps // STEPS_PER_WORKER)
        if problem is not None:
            raise SettingsError(f"{problem}: give it as module:object, or jobs=1")
        return settings.jobs

    def _unsendable(self) -> str | None:
        """Why a policy cannot be sent to other processes. None if all can."""
        for source in self.sources:
            try:
                cloudpickle.dumps(source)
            except Exception as error:  # noqa: BLE001 a policy's objects may raise anything
                return f"{source.name} cannot be sent to other processes ({reason(error)})"
        return None


def _error_type(result: EpisodeResult) -> str:
    """The type of the error of a failed episode."""
    return (result.failure or "").partition(":")[0]


def _copied(source: Source) -> Source:
    """A copy of the source of a policy, so that playing it does not change the original; itself if it has no copy."""
    try:
        return cloudpickle.loads(cloudpickle.dumps(source))
    except Exception:  # noqa: BLE001 a policy's objects may raise anything
        return source


def _are_repeated(player: Player, known: Sequence[EpisodeResult]) -> bool:
    """Whether the first of the known episodes has the same result if it is played again, or most of them have."""
    if _repeats(player, known[0]):
        return True
    return 2 * sum(_repeats(player, result) for result in known[1:]) > len(known)


def _is_repeatable(player: Player, known: EpisodeResult) -> bool:
    """Whether two attempts at an episode have the same actions."""
    first, second = (_again(player, known) for _ in range(2))
    return first.actions == second.actions


def _repeats(player: Player, known: EpisodeResult) -> bool:
    """Whether a known episode has the same start, actions and score if it is played again."""
    again = _again(player, known)
    same = again.actions == known.actions and abs(again.score - known.score) < SCORE_TOLERANCE
    return same and known.scene in (None, again.scene)


def _again(player: Player, known: EpisodeResult) -> EpisodeResult:
    unit = Unit(known.policy, known.run, known.task, known.variant, (known.seed,), known.shift, known.retry)
    return player.play(unit)[0]


def _all_failed_error(results: list[EpisodeResult]) -> EvaluationError:
    result, count = results[0], len(results)
    run = f", run {result.run}," if result.run else ""
    given = "" if result.preset is None else f"; it was given {observed(result.preset)}"
    which = "the first episode" if count == 1 else f"the first {count} episodes"
    return EvaluationError(
        f"{which} of {result.policy}{run} failed, so no result is kept; {result.task} {result.variant}, "
        f"seed {result.seed}: {result.failure}{given}"
    )


def _check_versions(results: Iterable[EpisodeResult]) -> None:
    """Raises an `EvaluationError` if a worker has versions different from those of this process."""
    for result in results:
        if (result.version, result.mujoco) != (__version__, MUJOCO_VERSION):
            raise EvaluationError(
                f"a worker has magical_mj {result.version} and mujoco {result.mujoco}, "
                f"but this process {__version__} and {MUJOCO_VERSION}: install the same versions everywhere"
            )


def check_repeatable(
    settings: EvaluationSettings, sources: Sequence[Source], labels: Mapping[str, Sequence[str]]
) -> None:
    """Plays the first steps of an episode twice, with each of the user's shifts. `labels`: those of each task.

    If they depended on more than the seed and the actions, no score could be repeated, and only `magical-mj verify`
    would notice it.

    Raises:
        SettingsError: if the two differ. Errors of the shifts are left to the evaluation.
    """
    played: dict[tuple[str, ...], tuple[str, str, str]] = {}  # the greatest strength of each
    for task, variant in settings.environments:
        for label in labels[task][1:]:  # the first is without a shift
            if names := tuple(code_digests(label)):
                played[names] = task, variant, label
    for names, (task, variant, label) in played.items():
        drawn = any("observations" in source.uses and "pictures" not in source.unnoticed for source in sources)
        try:
            first, second = (_beginning(settings, task, variant, label, drawn) for _ in range(2))
            pairs = zip(first, second, strict=True)
            different = next((what for (what, one), (_, other) in pairs if not np.array_equal(one, other)), None)
        except MagicalError:
            continue
        if different:
            raise SettingsError(
                f"{' or '.join(names)} is not repeatable: with the same seed and actions, two episodes differ in their "
                f"{different}. Draw random numbers only from self.rng() or self.uniform(step)"
            )


def _beginning(
    settings: EvaluationSettings, task: str, variant: str, shifts: str, drawn: bool
) -> Iterator[tuple[str, Any]]:
    """What can differ in an episode with random actions: names and values."""
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    seed, actions = settings.seeds[0], np.random.default_rng(0)
    how: dict[str, Any] = {"rules": settings.rules, "renderer": settings.renderer, "body": settings.body}
    with closing(Engine(task, variant, seed=seed, shifts=shifts, **how)) as engine:
        yield "initial scene", engine.initial_scene.digest()
        yield "instruction", engine.instruction
        for step in range(min(COMPARED_STEPS, engine.horizon or COMPARED_STEPS)):
            if drawn and step % PICTURE_STEPS == 0:
                for view in ("ego", "allo"):
                    yield "pictures", engine.render(view, PICTURE_SIZE)
            engine.step(int(actions.integers(len(ACTIONS))))
            yield "states", engine.get_state().simulation
        yield "score", engine.score()
