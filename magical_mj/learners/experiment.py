"""Experiments: runs of methods x tasks x seeds, each trained and evaluated, and a report with the paper's results."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from operator import methodcaller
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.reports.report import check_free, report
from magical_mj.evaluation.reports.results import gather, published_results
from magical_mj.evaluation.reports.statistics import by_environment, rank_correlation
from magical_mj.evaluation.scores import SETTINGS, read_settings
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.learners.folder import check
from magical_mj.learners.learner import device
from magical_mj.learners.method_settings import check_changes, check_used, load_settings
from magical_mj.learners.planned import Run, Watch
from magical_mj.learners.run import METHODS
from magical_mj.learners.settings_file import flattened
from magical_mj.tasks.registry import TASKS, listed, task_name
from magical_mj.utils.errors import SettingsError, check_name, shown
from magical_mj.utils.files import read_toml
from magical_mj.utils.imports import check_named
from magical_mj.utils.parallel import check_backend, map_unordered
from magical_mj.utils.settings import LARGEST_SETTING, check_unchanged, made

ENTRIES: Final = {
    "methods": '["bc"]',
    "tasks": '["MoveToRegion"]',
    "seeds": "[0, 1, 2]",
    "multi_task": "false",
    "quick": "false",
    "settings": "{}",
    "evaluation": "{}",
}
"""The entries of an experiment's file, with examples; the first three are required."""
EVALUATION: Final = {name: getattr(EvaluationSettings, name) for name in ("variants", "episodes", "rules")}
LEAST_PAIRS: Final = 5
"""The least number of environments for which a rank correlation is printed."""


def runs(file: Path | str, out: Path | str) -> list[Run]:
    """The runs of an experiment.

    Args:
        file: TOML with the `ENTRIES`: `tasks` is a list, or "all"; with `multi_task` there is one policy for all of
            them; `settings` holds what is changed in all runs, as in a run's config.toml; `evaluation` may hold what
            is in `EVALUATION`.
        out: the folder of the experiment.

    Raises:
        SettingsError, UnknownNameError: if the file holds invalid settings.
        UntrustedNameError: if it names the code of a task that the user has not named.
    """
    file, out = Path(file), Path(out)
    table = read_toml(file)
    _check(f"entry of {file}", table, ENTRIES)
    for name, example in ENTRIES.items():
        value, kind = table.get(name), type(tomllib.loads(f"it = {example}")["it"])
        if not value and name in ("methods", "tasks", "seeds"):
            raise SettingsError(f"{file} must give {name}, such as: {name} = {example}")
        if value is not None and not isinstance(value, kind) and not (name == "tasks" and isinstance(value, str)):
            raise SettingsError(f"{file} gives {name} = {value!r}; it must look like: {name} = {example}")
    evaluation = table.get("evaluation", {})
    _check(f"entry of [evaluation] in {file}", evaluation, EVALUATION)
    episodes = evaluation.get("episodes", 1)
    if not isinstance(episodes, int) or episodes > LARGEST_SETTING:
        at_most = f"it must look like: episodes = 100, and be at most {LARGEST_SETTING}"
        raise SettingsError(f"{file} gives episodes = {shown(episodes)}; {at_most}")
    evaluation = EVALUATION | evaluation
    names = listed(table["tasks"], TASKS)
    for task in names:
        check_named(task, file)
    tasks = [task_name(task) for task in names]
    for method in table["methods"]:
        check_name("method", method, METHODS)
    for name, values in (("methods", table["methods"]), ("tasks", tasks), ("seeds", table["seeds"])):
        if len({str(value) for value in values}) < len(values):
            raise SettingsError(f"{file} gives one of its {name} twice: {', '.join(map(str, values))}")
    groups = [tuple(tasks)] if table.get("multi_task", False) else [(task,) for task in tasks]
    quick, changes = table.get("quick", False), flattened(table.get("settings", {}))
    check_changes(changes, ("method", "tasks", "quick", "seed"))
    check_used(changes, table["methods"])
    found = []
    for seed in table["seeds"]:
        for method in table["methods"]:
            for group in groups:
                settings = load_settings(method, group, quick=quick, **{**changes, "seed": seed})
                found.append(Run(settings, quick, changes, evaluation, out.absolute()))  # workers are in other folders
                made(EvaluationSettings, found[-1].played)  # an error now, not after the training
    return found


def conduct(
    planned: list[Run],
    out: Path | str,
    *,
    jobs: int | None = None,
    backend: str = "local",
    address: str | None = None,
    watch: Watch | None = None,
) -> Iterator[str]:
    """Trains and evaluates what is not done yet. Yields a line for each run, then `agreement` and the report's path.

    Args:
        planned: the `runs`.
        out: the folder of the experiment.
        jobs: the number of simultaneous runs, each on one thread; a single run uses all cores. None: one here, or as
            many as the cluster can do.
        backend: "local", "dask" or "ray".
        address: the cluster's address.
        watch: called with a run's name and progress after each of its updates, if the runs are not in other processes.

    Raises:
        MagicalError: if a run fails, or would do so from the start: then before the first run. Called again, it
            continues.
    """
    out = Path(out)
    check_backend(backend, jobs, address)
    _check_runs(planned, out, backend == "local")
    if backend == "local" and jobs in (None, 1):
        yield from (run.play(watch) for run in planned)
    else:
        yield from map_unordered(methodcaller("play"), planned, jobs, backend, address)
    yield from agreement(planned)
    yield str(report([run.scores for run in planned], out / "report", with_published=True))


def _check_runs(planned: list[Run], out: Path, here: bool) -> None:
    """Raises the errors that would come after hours: those with which a run or the report would begin."""
    check_free(out / "report")
    for run in planned:
        check(run.trained, run.settings, resume=True)
        if (run.scores / SETTINGS).exists():
            check_unchanged(run.scores, read_settings(run.scores), made(EvaluationSettings, run.played).recorded())
        if here:
            device(run.settings.device)
    for run in {(run.settings.method, run.settings.tasks): run for run in planned}.values():
        METHODS[run.settings.method].check(run.settings)


def agreement(planned: list[Run]) -> Iterator[str]:
    """The rank correlation of each finished method's mean scores with the paper's over environments, a line each."""
    ours = by_environment(gather([run.scores for run in planned]))
    paper = published_results()
    published = set(paper["policy"])
    for method, rows in {run.method: run.counterparts for run in planned}.items():
        counterpart = rows[0] if rows[0] in published else rows[1]
        first = ours[ours["policy"] == method].set_index(["task", "variant"])["mean"]
        second = paper[paper["policy"] == counterpart].set_index(["task", "variant"])["mean"]
        shared = first.index.intersection(second.index)
        ranks = rank_correlation(first.to_dict(), second.to_dict())
        if len(shared) >= LEAST_PAIRS and ranks == ranks:  # it is no number if all means are alike
            by_variant = [means[shared].groupby("variant").mean().to_dict() for means in (first, second)]
            counts = f"{ranks:.2f} over {len(shared)} environments"
            counts += f", {rank_correlation(*by_variant):.2f} over the means of {len(by_variant[0])} variants"
            yield f"{method} and the paper's {counterpart}: rank correlation {counts}"


def _check(kind: str, names: Any, allowed: Any) -> None:
    for name in names:
        check_name(kind, name, allowed)
