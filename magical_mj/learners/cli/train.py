"""`magical-mj train`, `experiment`, `export-policy` and `evaluate-reward`: trainings, and what they have learnt."""

from __future__ import annotations

import shlex
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from rich.console import Console
from rich.progress import ProgressColumn, Task, TimeElapsedColumn
from rich.table import Column, Table
from rich.text import Text
from typer import Argument, Option

from magical_mj import learners
from magical_mj.cli import option
from magical_mj.cli.console import Bars, check_fits, check_suffix, check_writable, console, how_to_continue, output_path
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.learners.config import check_changes, users, uses
from magical_mj.learners.settings import METHODS, OWN, PPOSettings, TrainingSettings
from magical_mj.policies.interface import AGENTS
from magical_mj.utils.errors import MagicalError, SettingsError, check_name, counted
from magical_mj.utils.extras import check_extra
from magical_mj.utils.settings import described

if TYPE_CHECKING:
    from magical_mj.learners import Progress

DAY: Final = 86400.0
"""Speeds are averaged over this many seconds, since a run may take hours. Rich keeps a thousand updates at most."""
PAUSE: Final = 10.0
"""Seconds between two looks at the progress of other processes."""


def experiment(
    file: Annotated[Path, Argument(help="TOML: methods, tasks, seeds ...; see docs/learners.md.")],
    out: Annotated[Path, Option(help="The folder for runs, evaluations and the report.")],
    jobs: Annotated[
        int | None,
        Option(
            min=1,
            help="Number of simultaneous runs, each on one core; a single run uses all cores.",
            show_default="one, or as many as a cluster can do",
        ),
    ] = None,
    trusted: option.Trusted = "",
    **where: Any,
) -> None:
    """Train and evaluate methods x tasks x seeds. Called again, it continues."""
    planned = learners.plan_experiment(file, out, trusted=trusted.split(","))
    screen, began = console(), time.time()
    views: dict[str, TrainingView] = {}
    with how_to_continue(screen, "the same command continues"), bars(screen) as progress:
        bar = progress.add_task("experiment", total=len(planned), unit="runs", latest="")

        def watch(name: str, trained: Progress) -> None:
            views[name] = views.get(name) or TrainingView(progress, name)
            views[name](trained)
            if trained.update == trained.updates:
                progress.remove_task(views.pop(name).bar)

        def poll() -> None:
            """Shows the progress of evaluations and of trainings in other processes, if none trains in this one."""
            if not views:
                news = filter(None, (run.standing(began) for run in planned))
                progress.update(bar, latest=", ".join(news))

        lines = learners.run_experiment(planned, out, jobs=jobs, watch=watch, **where)
        with repeating(poll):
            for number, line in enumerate(lines, 1):
                screen.print(line, soft_wrap=True)
                done = min(number, len(planned))  # lines about the whole experiment follow those of the runs
                progress.update(bar, completed=done, latest="")


option.add_options(experiment, EvaluationSettings, only=("backend", "address"))


def train(
    context: typer.Context,
    method: Annotated[
        str,
        Argument(help=f"{', '.join(OWN)}, or a method of another package."),
    ],
    tasks: Annotated[str, Option(help="A task; with --multi-task several, separated by commas, or all.")],
    out: Annotated[Path, Option(help="The run's folder.")],
    demonstrations: Annotated[
        Path | None,
        Option(
            help="A folder with your own demonstrations; all in the demo scene are used.",
            show_default="10 of those that come with each task",
        ),
    ] = None,
    multi_task: Annotated[bool, Option("--multi-task", help="One policy for all the tasks.")] = False,
    simulator: Annotated[str, Option(help=described(PPOSettings)["simulator"].description)] = PPOSettings.simulator,
    renderer: option.Renderer = None,
    quick: Annotated[
        bool, Option("--quick", help="Use a smaller network and a shorter training, for two cores.")
    ] = False,
    change: Annotated[list[str] | None, Option("--set", help="Any setting, such as ppo.clip=0.02.")] = None,
    resume: Annotated[bool, Option("--resume", help="Continue the training in the folder.")] = False,
    **options: Any,
) -> None:
    """Train a policy. OUT then holds the policy, for `magical-mj evaluate --policy OUT`, with settings and metrics."""
    check_extra("learners", "eval", "il")
    from magical_mj.learners.learner import keep_freed_memory

    check_name("method", method, METHODS)
    options["ppo.simulator"] = simulator
    options["recordings"] = "" if demonstrations is None else str(demonstrations)
    options |= {} if renderer is None else {"renderer": renderer}  # quick trainings have another default
    others = {}
    for text in change or []:
        name, equals, others[name] = text.partition("=")
        if not equals:
            raise SettingsError(f"--set must be NAME=VALUE, such as ppo.clip=0.02, not {text!r}")
    check_changes(others, [method], options["preset"], elsewhere=("method", "tasks", "quick", *options))
    check_fits(context, uses(method, "augment"), f"with {', '.join(users('augment'))}", "augment")
    settings = learners.load_settings(method, tasks, quick=quick, **options, **others)
    if len(settings.tasks) > 1 and not multi_task:
        raise SettingsError(
            "one policy for several tasks needs --multi-task; magical-mj experiment trains one for each"
        )
    METHODS[method].check_settings(settings)
    keep_freed_memory()
    screen = console()
    _describe_demonstrations(screen, settings)
    with how_to_continue(screen, "the same command with --resume continues"), bars(screen) as progress:
        learners.train(settings, out, resume=resume, watch=TrainingView(progress, method))
    folder = shlex.quote(f"./{out}" if str(out) in AGENTS else str(out))
    tasks = shlex.quote(",".join(settings.tasks))
    again = f"magical-mj evaluate --policy {folder} --tasks {tasks}"
    screen.print(f"the policy is in {out}; to evaluate it: {again} --out ...", soft_wrap=True)


def _describe_demonstrations(screen: Console, settings: TrainingSettings) -> None:
    """Prints the number of demonstrations of each task, and their scores."""
    from magical_mj.learners.data import chosen, to_choose_from

    for task in settings.tasks:
        scores, count = [demo.score for demo in chosen(settings, task)], len(to_choose_from(settings, task))
        where = f" of the demo scene in {settings.recordings}" if settings.recordings else ""
        screen.print(
            f"{task}: {len(scores)} of {counted(count, 'demonstration')}{where}, mean score {fmean(scores):.2f}, "
            f"lowest {min(scores):.2f}",
            soft_wrap=True,
        )


option.add_options(train, TrainingSettings, only=("seed", "augment", "preset", "device"))


def export(
    run: Annotated[Path, Argument(help="The folder of a training.")],
    out: Annotated[Path | None, Option(help="The ONNX file, or its folder.", show_default="policy.onnx")] = None,
    task: Annotated[str, Option(help="The task, if the policy has several.")] = "",
    force: option.Force = False,
) -> None:
    """Write the policy of a training as an ONNX file for `evaluate --policy` and any ONNX runtime.

    It takes the most likely action, but `magical-mj evaluate --policy RUN` samples actions.
    """
    check_extra("learners", "eval", "il")
    from magical_mj.learners.policy import export_policy

    path = check_writable(output_path(out, "policy.onnx"), force)
    console().print(export_policy(run, path, task, overwrite=force), soft_wrap=True)


def bars(screen: Console) -> Bars:
    """Progress bars of trainings, which count updates, or of an experiment, which counts runs."""
    updates = UpdateColumn(Column(no_wrap=True, overflow="ellipsis"))
    return Bars(screen, updates, TimeElapsedColumn(Column(no_wrap=True)), speed_estimate_period=DAY)


@contextmanager
def repeating(poll: Callable[[], None]) -> Iterator[None]:
    """While the context is open, a thread calls `poll` every few seconds. Errors of files and our own are ignored."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(PAUSE):
            with suppress(OSError, MagicalError):
                poll()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class UpdateColumn(ProgressColumn):
    """The number of finished updates or runs, updates per second, and the latest metrics."""

    def render(self, task: Task) -> Text:
        """The text of the column for a bar."""
        done = f"{task.completed}/{task.total or '?'} {task.fields['unit']}"
        speed = f", {task.speed:.2f}/s" if task.speed and task.fields["unit"] == "updates" else ""
        return Text(f"{done}{speed} {task.fields['latest']}".rstrip())


class TrainingView:
    """Shows the progress of a training: a bar with the latest metrics, and a line per evaluation."""

    def __init__(self, progress: Bars, name: str) -> None:
        self._progress, self._name = progress, name
        self.bar = progress.add_task(name, total=None, unit="updates", latest="")

    def __call__(self, trained: Progress) -> None:
        """Shows the state of the training after an update."""
        shown = "  ".join(f"{name} {value:.3g}" for name, value in trained.metrics.items())
        latest = {"latest": shown} if shown else {}  # metrics come with some updates only
        self._progress.update(self.bar, completed=trained.update, total=trained.updates, **latest)
        if trained.scores:
            scores = ", ".join(f"{task} {score:.2f}" for task, score in trained.scores.items())
            line = f"{self._name}: after {trained.update} updates: mean score on Demo: {scores}"
            self._progress.console.print(line, soft_wrap=True)


def evaluate_reward(
    runs: Annotated[
        list[Path],
        Argument(help="Folders of trainings. Methods without a learnt reward, such as bc, only add episodes."),
    ],
    variants: option.Variants = "all",
    scenes: Annotated[
        int, Option(min=1, max=1000, help="Number of scenes in each environment, none of the test's.")
    ] = 5,
    out: Annotated[Path | None, Option(help="A CSV file for all sums and scores.")] = None,
    jobs: option.Jobs = None,
    force: option.Force = False,
) -> None:
    """Compare learnt rewards with the score over episodes of experts, of policies, and of random actions.

    For each method and variant, it prints the means over tasks of the rank correlation of summed rewards with scores,
    and of the probability that a solved episode has a larger sum than another one (AUC).
    """
    check_extra("learners", "eval", "il")
    from magical_mj.learners.rewards import agreements, evaluate_rewards

    if out is not None:
        check_suffix(out, ".csv")
        check_writable(out, force)
    screen = console()
    frame = evaluate_rewards(runs, variants, scenes, jobs=jobs, watch=screen.print)
    if out is not None:
        frame.to_csv(out, index=False, float_format="%.6g")
    found = agreements(frame)
    table = Table("method", *(f"{variant} {name}" for variant in found["variant"].unique() for name in ("r", "AUC")))
    for method, group in found.groupby("method", sort=False):
        means = group.groupby("variant", sort=False)[["correlation", "auc"]].mean()
        table.add_row(str(method), *(f"{value:.2f}" for row in means.to_numpy() for value in row))
    screen.print(table)
