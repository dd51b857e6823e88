"""Experiments: runs of methods x tasks x seeds, each trained and evaluated, and a report with the paper's results."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from itertools import product
from operator import methodcaller
from pathlib import Path
from typing import Annotated, Any, Final

from msgspec import Meta

from magical_mj.evaluation.folder import SETTINGS, check_continues
from magical_mj.evaluation.reports.report import check_free, report
from magical_mj.evaluation.reports.results import gather, published_results
from magical_mj.evaluation.reports.statistics import by_environment, rank_correlation
from magical_mj.evaluation.run import evaluate
from magical_mj.evaluation.scores import SCORES
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.learners.config import check_changes, flattened, load_settings, uses
from magical_mj.learners.learner import device, keep_freed_memory
from magical_mj.learners.run_folder import METRICS, RunFolder, read_metrics
from magical_mj.learners.settings import METHODS, TrainingSettings
from magical_mj.learners.training import Progress, train
from magical_mj.tasks.registry import environments, task_spec, tasks_in_file
from magical_mj.utils.errors import SettingsError, check_name, counted
from magical_mj.utils.files import read_toml, to_path
from magical_mj.utils.parallel import check_backend, map_unordered
from magical_mj.utils.settings import Names, Settings, with_values

NAMED: Final = ("preset", "augment", "device", "evaluations", "episodes", "checkpoints")
"""Settings that are not appended to a method's name: the name contains them already, or they do not affect results."""
ABLATIONS: Final = {"all": "", "none": ", no aug.", "no-trans-rot": ", no trans./rot. aug."}
EVALUATION: Final = {name: getattr(EvaluationSettings, name) for name in ("variants", "episodes", "split", "rules")}
"""The settings that the table `evaluation` of an experiment's file may contain."""
LEAST_PAIRS: Final = 5
"""The least number of environments for printing a rank correlation."""

Watch = Callable[[str, Progress], None]


@dataclass(frozen=True)
class ExperimentSettings(Settings):
    """The file of an experiment. The first three entries are required."""

    methods: tuple[str, ...] = ()
    tasks: Annotated[Names, Meta(description='tasks, or "all"')] = ()
    seeds: tuple[int, ...] = ()
    multi_task: Annotated[bool, Meta(description="one policy for all the tasks")] = False
    quick: bool = False
    settings: Annotated[dict[str, Any], Meta(description="changed settings of all runs, as in a run's config.toml")] = (
        field(default_factory=dict)
    )
    evaluation: Annotated[dict[str, Any], Meta(description="some of `EVALUATION`")] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Checks each entry, and that none is repeated."""
        super().__post_init__()
        for name, example in (("methods", '["bc"]'), ("tasks", '["MoveToRegion"]'), ("seeds", "[0, 1, 2]")):
            values = getattr(self, name)
            if not values:
                raise SettingsError(f"an experiment must give {name}, such as: {name} = {example}")
            if not isinstance(values, str) and len(set(values)) < len(values):
                raise SettingsError(f"{name} contains an entry twice: {', '.join(map(str, values))}")


@dataclass(frozen=True)
class Run:
    """One run of an experiment.

    Attributes:
        settings: the settings of the training.
        quick: whether these are the settings of quick trainings.
        changes: the changed settings, except the seed.
        evaluation: the settings of the evaluation, as in `EVALUATION`.
        folder: the folder of the experiment.
    """

    settings: TrainingSettings
    quick: bool
    changes: dict[str, Any]
    evaluation: dict[str, Any]
    folder: Path

    @property
    def name(self) -> str:
        """The name of its folder: method, task and seed."""
        tasks = self.settings.tasks
        return f"{self.settings.method}-{task_spec(tasks[0]).name if len(tasks) == 1 else 'multi'}-{self.settings.seed}"

    @property
    def method(self) -> str:
        """The method's name in tables; runs with the same name are averaged."""
        used = {name: value for name, value in self.changes.items() if uses(self.settings.method, name)}
        changed = "".join(f", {name} {value}" for name, value in used.items() if name not in NAMED)
        return f"{self.counterparts[0]}, ours{', quick' if self.quick else ''}{changed}"

    @property
    def counterparts(self) -> tuple[str, str]:
        """The paper's rows with these observations and augmentations, and with its usual ones. They may not exist."""
        settings = self.settings
        method, kind = settings.method.upper(), "ST" if len(settings.tasks) == 1 else "MT"
        preset = {"LoRes4E": "", "LoRes4A": ", allo."}.get(settings.preset, f", {settings.preset}")
        ablation = ABLATIONS[settings.augment] if uses(settings.method, "augment") else ""
        return f"{method} ({kind}{preset}{ablation})", f"{method} ({kind})"

    @property
    def trained(self) -> Path:
        """The folder of the training."""
        return self.folder / "runs" / self.name

    @property
    def scores(self) -> Path:
        """The folder of the evaluation."""
        return self.folder / "evaluations" / self.name

    @property
    def played(self) -> dict[str, Any]:
        """The settings of the evaluation that determine scores."""
        settings = self.settings
        return {**self.evaluation, "tasks": settings.tasks, "preset": settings.preset, "run": settings.seed}

    def play(self, watch: Watch | None = None) -> str:
        """Trains and evaluates, and continues if part of it is done. Returns a line with the result."""
        keep_freed_memory()
        updates = 0

        def count(progress: Progress) -> None:
            nonlocal updates
            updates += 1
            if watch is not None:
                watch(self.name, progress)

        train(self.settings, self.trained, resume=True, watch=count)
        frame = evaluate({self.method: self.trained}, out=self.scores, resume=True, jobs=1, **self.played)
        means = frame.groupby("variant", sort=False)["score"].mean()
        scores = ", ".join(f"{variant} {mean:.2f}" for variant, mean in means.items())
        return f"{self.name}: {'trained' if updates else 'was trained before'}; {scores}"

    def standing(self, since: float) -> str:
        """The progress according to its files. Empty if it is finished, or if no file has changed after `since`."""
        known = {path: path.stat().st_mtime for path in (self.trained / METRICS, self.scores / SCORES) if path.exists()}
        latest = max(known, key=known.__getitem__, default=None)
        if latest is None or known[latest] < since:
            return ""
        if latest.name == METRICS:
            rows = read_metrics(self.trained)
            return f"{self.name}: {rows[-1]['update'] if rows else 0} updates"
        done = latest.read_bytes().count(b"\n")
        of = len(environments(self.settings.tasks, self.evaluation["variants"])) * self.evaluation["episodes"]
        return f"{self.name}: {done} of {of} episodes evaluated" if done < of else ""


def plan_experiment(file: Path | str, out: Path | str, *, trusted: Collection[str] = ()) -> list[Run]:
    """The runs of an experiment in the folder `out`, whose file is TOML with the `ExperimentSettings`.

    Args:
        file: the file.
        out: the folder.
        trusted: references such as "mine:SPEC" that the file may name; see docs/trust.md.

    Raises:
        SettingsError, UnknownNameError: if the file contains invalid settings.
        UntrustedNameError: if it contains a reference to a task that is not trusted.
    """
    file, out = to_path(file), to_path(out)
    experiment = with_values(ExperimentSettings, read_toml(file))
    for name in experiment.evaluation:
        check_name(f"entry of [evaluation] in {file}", name, EVALUATION)
    evaluation = EVALUATION | experiment.evaluation
    names = tasks_in_file(experiment.tasks, file, trusted)
    tasks = tuple(dict.fromkeys(names))
    if len(tasks) < len(names):
        raise SettingsError(f"{file} contains a task twice: {', '.join(names)}")
    for method in experiment.methods:
        check_name("method", method, METHODS)
    changes = flattened(experiment.settings)
    check_changes(changes, experiment.methods, elsewhere=("method", "tasks", "quick", "seed"))
    planned = []
    groups = [tasks] if experiment.multi_task else [(task,) for task in tasks]
    for seed, method, group in product(experiment.seeds, experiment.methods, groups):
        settings = load_settings(method, group, quick=experiment.quick, **{**changes, "seed": seed})
        # workers have another working directory
        run = Run(settings, experiment.quick, changes, evaluation, out.absolute())
        with_values(EvaluationSettings, run.played)  # raises errors before the training
        planned.append(run)
    return planned


def run_experiment(
    planned: list[Run],
    out: Path | str,
    *,
    jobs: int | None = None,
    backend: str = "local",
    address: str | None = None,
    watch: Watch | None = None,
) -> Iterator[str]:
    """Trains and evaluates all unfinished runs. Yields a line for each run, then `agreement` and the report's path.

    Args:
        planned: the runs, from `plan_experiment`.
        out: the folder of the experiment.
        jobs: the number of simultaneous runs, each on one thread. A single run uses all cores. None: one run at a time
            on this machine, or as many as the cluster can run.
        backend: "local" or "dask".
        address: the cluster's address.
        watch: called with a run's name and progress after each of its updates. Not called for runs in other processes.

    Raises:
        MagicalError: if a run fails. Errors that can be found in advance are raised before the first run. Another call
            continues the experiment.
    """
    out = to_path(out)
    check_backend(backend, address)
    _check_runs(planned, out, backend == "local")
    if backend == "local" and jobs in (None, 1):
        yield from (run.play(watch) for run in planned)
    else:
        yield from map_unordered(methodcaller("play"), planned, jobs, backend, address)
    yield from agreement(planned)
    yield str(report([run.scores for run in planned], out / "report", with_published=True))


def _check_runs(planned: list[Run], out: Path, here: bool) -> None:
    """Raises in advance the errors of the start of each run, and of the report."""
    check_free(out / "report")
    for run in planned:
        RunFolder(run.trained, run.settings, resume=True)
        if (run.scores / SETTINGS).exists():
            check_continues(run.scores, with_values(EvaluationSettings, run.played).recorded())
        if here:
            device(run.settings.device)
    for run in {(run.settings.method, run.settings.tasks): run for run in planned}.values():
        METHODS[run.settings.method].check(run.settings)


def agreement(planned: list[Run]) -> Iterator[str]:
    """A line for each finished method: the rank correlation of its mean scores with the paper's, over environments."""
    ours = by_environment(gather([run.scores for run in planned]))
    paper = published_results()
    published = set(paper["policy"])
    for method, rows in {run.method: run.counterparts for run in planned}.items():
        counterpart = rows[0] if rows[0] in published else rows[1]
        first = ours[ours["policy"] == method].set_index(["task", "variant"])["mean"]
        second = paper[paper["policy"] == counterpart].set_index(["task", "variant"])["mean"]
        shared = first.index.intersection(second.index)
        ranks = rank_correlation(first.to_dict(), second.to_dict())
        if len(shared) >= LEAST_PAIRS and ranks == ranks:  # NaN if all means are equal
            by_variant = [means[shared].groupby("variant").mean().to_dict() for means in (first, second)]
            counts = f"{ranks:.2f} over {counted(len(shared), 'environment')}"
            counts += f", {rank_correlation(*by_variant):.2f} over the means of {len(by_variant[0])} variants"
            yield f"{method} and the paper's {counterpart}: rank correlation {counts}"
