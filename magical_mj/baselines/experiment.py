"""Many runs: methods x tasks x seeds, each trained and evaluated, and all in one report beside the paper's."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from operator import methodcaller
from pathlib import Path
from typing import Any, Final

from magical_mj.baselines.config import flattened, read_toml
from magical_mj.baselines.policy import is_done
from magical_mj.baselines.run import METHODS, train
from magical_mj.baselines.settings import TrainingSettings, load_settings
from magical_mj.errors import SettingsError, unknown_name
from magical_mj.evaluation.report import report
from magical_mj.evaluation.run import evaluate
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.parallel import check_backend, spread
from magical_mj.registry import TASKS, check_rules, environments, listed, task_name, task_spec

ENTRIES: Final = {
    "methods": '["bc"]',
    "tasks": '["MoveToRegion"]',
    "seeds": "[0, 1, 2]",
    "multi_task": "false",
    "quick": "false",
    "settings": "{}",
    "evaluation": "{}",
}
"""Of an experiment's file, with examples; the first three must be there."""
EVALUATION: Final = {name: getattr(EvaluationSettings, name) for name in ("variants", "episodes", "rules")}
SIDE_BY_SIDE: Final = 10
"""Episodes that are played at once, for networks like batches."""
ABLATIONS: Final = {"all": "", "none": ", no aug.", "no-trans-rot": ", no trans./rot. aug."}


@dataclass(frozen=True)
class Run:
    """One of an experiment's runs.

    Attributes:
        settings: of the training.
        quick: whether they are the quick ones.
        evaluation: as in `EVALUATION`.
        folder: of the experiment.
    """

    settings: TrainingSettings
    quick: bool
    evaluation: dict[str, Any]
    folder: Path

    @property
    def name(self) -> str:
        """Of its folder: the method, the task and the seed."""
        tasks = self.settings.tasks
        return f"{self.settings.method}-{task_spec(tasks[0]).name if len(tasks) == 1 else 'multi'}-{self.settings.seed}"

    @property
    def method(self) -> str:
        """The method's name in tables, formed as the paper's are; runs of the same name are averaged."""
        settings = self.settings
        kind = "ST" if len(settings.tasks) == 1 else "MT"
        preset = {"LoRes4E": "", "LoRes4A": ", allo."}.get(settings.preset, f", {settings.preset}")
        name = f"{settings.method.upper()} ({kind}{preset}{ABLATIONS[settings.augment]})"
        return f"{name}, ours{', quick' if self.quick else ''}"

    @property
    def scores(self) -> Path:
        """The folder of the evaluation."""
        return self.folder / "evaluations" / self.name

    def play(self) -> str:
        """Trains and evaluates, or does what is left of it; returns a line about it."""
        trained = self.folder / "runs" / self.name
        before = is_done(trained)
        train(self.settings, trained, resume=True)
        frame = evaluate(
            {self.method: str(trained)},
            tasks=self.settings.tasks,
            preset=self.settings.preset,
            run=self.settings.seed,
            out=self.scores,
            resume=True,
            envs=SIDE_BY_SIDE,
            jobs=1,
            **self.evaluation,
        )
        means = frame.groupby("variant", sort=False)["score"].mean()
        shown = ", ".join(f"{variant} {mean:.2f}" for variant, mean in means.items())
        return f"{self.name}: {'was trained before' if before else 'trained'}; {shown}"


def runs(file: Path, out: Path) -> list[Run]:
    """The runs of an experiment.

    Args:
        file: TOML with the `ENTRIES`: `tasks` is a list, or "all"; with `multi_task` there is one policy for all of
            them; `settings` holds what is changed in all runs, as in a run's config.toml; `evaluation` may hold what
            is in `EVALUATION`.
        out: the folder of the experiment.

    Raises:
        SettingsError, UnknownNameError: if the file holds what cannot be.
    """
    table = read_toml(file)
    _check(f"entry of {file}", table, ENTRIES)
    for name in ("methods", "tasks", "seeds"):
        if not table.get(name):
            raise SettingsError(f"{file} must give {name}, such as: {name} = {ENTRIES[name]}")
    evaluation = {**EVALUATION, **table.get("evaluation", {})}
    _check(f"entry of [evaluation] in {file}", evaluation, EVALUATION)
    tasks = [task_name(task) for task in listed(table["tasks"], TASKS)]
    environments(tasks, evaluation["variants"])
    check_rules(evaluation["rules"])
    _check("method", table["methods"], METHODS)
    quick = table.get("quick", False)
    found = []
    for seed in table["seeds"]:
        for method in table["methods"]:
            for group in [tuple(tasks)] if table.get("multi_task", False) else [(task,) for task in tasks]:
                changes = {**flattened(table.get("settings", {})), "seed": seed}
                found.append(Run(load_settings(method, group, quick=quick, **changes), quick, evaluation, out))
    return found


def conduct(
    planned: list[Run], out: Path, *, jobs: int | None = 1, backend: str = "local", address: str | None = None
) -> Iterator[str]:
    """Trains and evaluates what is not done yet, a line for each run; the last is the path of the report.

    Args:
        planned: the `runs`.
        out: the folder of the experiment.
        jobs: how many runs go on at once, each on one thread; one alone uses all cores.
        backend: "local", "dask" or "ray".
        address: of the cluster.

    Raises:
        MagicalError: what stopped a run. Called again, it goes on.
    """
    check_backend(backend, jobs, address)
    if backend == "local" and jobs == 1:
        yield from (run.play() for run in planned)
    else:
        yield from spread(methodcaller("play"), planned, jobs, backend, address)
    yield str(report([run.scores for run in planned], out / "report", with_published=True))


def _check(kind: str, names: Any, allowed: Any) -> None:
    for name in names:
        if name not in allowed:
            raise unknown_name(kind, name, allowed)
