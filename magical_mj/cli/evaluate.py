"""`magical-mj evaluate`, `rollout` and `demo`: play policies and store scores, make videos, or do both."""

from __future__ import annotations

import shlex
import time
from collections.abc import Sequence
from contextlib import closing, nullcontext
from math import isnan
from pathlib import Path
from statistics import fmean
from typing import Annotated, Any, Final

import typer
from rich.console import Console
from rich.progress import TextColumn, TimeElapsedColumn
from rich.table import Table
from typer import Option

from magical_mj.cli import option
from magical_mj.cli.console import (
    Bars,
    check_fits,
    check_suffix,
    check_writable,
    console,
    counting,
    how_to_continue,
    make_writable_folder,
    with_bar,
)
from magical_mj.cli.environments import contact_sheet
from magical_mj.cli.film import film, film_episodes, replay, views_of
from magical_mj.envs.presets import DEFAULT_PRESET
from magical_mj.evaluation.folder import read_settings
from magical_mj.evaluation.reports.report import extremes, report
from magical_mj.evaluation.reports.results import counted_tasks
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import SCORES, EpisodeResult, frame, open_scores
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.evaluation.worker import Player, Unit, prepared
from magical_mj.shifts.registry import axis_and_level, parse_shifts, shift_label
from magical_mj.tasks.registry import SPLITS, VARIANTS, task_name, task_spec, variant_name
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError, counted
from magical_mj.utils.extras import check_extra
from magical_mj.utils.settings import LARGEST_SETTING

TOURED: Final = ("expert", "random", "noop")
SHEET: Final = "environments.png"
SAME: Final = ("policies", "environments", "episodes", "preset", "rules", "time_limit", "worlds")
"""The settings that identify an earlier run of the same tour. Settings that depend on the version do not count."""

ENVIRONMENTS: Final = "Environments"
PANELS: Final = {
    ENVIRONMENTS: ("split", "first_seed", "rules", "renderer", "wrap", "body"),
    "Runs and files": ("run", "retry_failed", "trust"),
    "Workers": ("backend", "address", "time_limit"),
}
"""Heading in the help of `evaluate` -> settings that few people need."""
_POLICIES = (
    "expert, random, noop, module:object, the folder of a training, or a file (.zip of stable-baselines3, .onnx); "
    "several with commas (in a name: \\,)."
)


def evaluate(
    policy: Annotated[
        str, Option(help=f"{_POLICIES} NAME=... names a method; policies with the same name are its runs.")
    ],
    out: Annotated[Path, Option(help="The folder for the scores.")],
    like: Annotated[
        str,
        Option(
            "--as", help="The task name that policies receive instead of the real one.", rich_help_panel=ENVIRONMENTS
        ),
    ] = "",
    **options: Any,
) -> None:
    """Evaluate policies in the test scenes; all scores are stored in OUT/scores.jsonl."""
    if out.suffix in (".json", ".jsonl", ".csv"):
        raise typer.BadParameter(f"{out} is the name of a file; --out must be a folder, for {SCORES} and run.json.")
    screen = console()
    with counting(screen, "demonstrating") as watch:
        evaluation = Evaluation(policy, EvaluationSettings(out=out, like=like, **options), watch)
    _print_preset(screen, options["preset"], evaluation.settings.observed)
    if evaluation.scores:
        number = len(evaluation.scores)
        screen.print(f"{counted(number, 'episode')} {'is' if number == 1 else 'are'} done already")
    with how_to_continue(screen, "the same command with --resume continues"):
        play_all(screen, evaluation)
    screen.print(f"{out / SCORES}; tables and figures: magical-mj report {shlex.quote(str(out))}", soft_wrap=True)


option.add_options(evaluate, EvaluationSettings, panels=PANELS)


def rollout(
    context: typer.Context,
    task: option.Task,
    variant: option.Variant = "Demo",
    policy: Annotated[str, Option(help=_POLICIES)] = "expert",
    episodes: Annotated[
        int, Option(min=1, max=LARGEST_SETTING, help="Number of episodes, in the scenes of SEED, SEED + 1, ...")
    ] = 1,
    seed: option.Seed = 0,
    shifts: option.Shifts = "",
    video: Annotated[Path | None, Option(help="Write an MP4 video of the episodes.")] = None,
    size: option.Size = 384,
    camera: option.Cameras = "allo,ego",
    force: option.Force = False,
    **options: Any,
) -> None:
    """Play some episodes with a policy, print the scores, and make a video. For the whole benchmark, use `evaluate`."""
    check_fits(context, video is not None, "with --video", "size", "camera", "force")
    check_suffix(video, ".mp4")
    views = views_of(camera)
    pair = task_name(task), variant_name(variant)  # single names, neither lists nor "all"
    shift = shift_label(parse_shifts(shifts, pair[0]))
    settings = EvaluationSettings(tasks=(pair[0],), variants=(pair[1],), shifts=shift, **options)
    listed, settings = prepared(policy, settings)
    first = SPLITS[settings.split] + seed
    if video is not None:
        check_writable(video, force)
    screen, failed, played = console(), False, 0
    _print_preset(screen, options["preset"], settings.observed)
    showing = nullcontext() if video is None else film(video, size, views=views, overwrite=force)
    try:
        with showing as movie, closing(Player(listed, settings)) as player:
            for source in listed:
                units = [Unit(source.name, source.run, *pair, (first + k,), shift) for k in range(episodes)]
                scores = []
                for unit in with_bar(screen, f"playing {source.name}", units, episodes):
                    scores += player.play(unit)
                    screen.print(_line(scores[-1]), soft_wrap=True)
                    if movie is not None:
                        replay(movie, scores[-1], settings.renderer)
                    played += 1
                mean = fmean(score.score for score in scores)
                screen.print(f"{source.name}: mean score of {counted(episodes, 'episode')} {mean:.3f}", soft_wrap=True)
                failed |= all(score.failure is not None for score in scores)
    except KeyboardInterrupt:
        left = "" if video is None else f"; {video} was not written"
        screen.print(f"stopped after {played} of {counted(episodes * len(listed), 'episode')}{left}", soft_wrap=True)
        raise
    if video is not None:
        screen.print(video, soft_wrap=True)
    if failed:  # a policy has not finished a single episode
        raise typer.Exit(1)


option.add_options(
    rollout,
    EvaluationSettings,
    only=("split", "preset", "body", "renderer", "trust", "demonstrations", "scenes"),
)


def _print_preset(screen: Console, given: str | None, preset: str) -> None:
    """Prints the preset that the policy has chosen, if it is not the default."""
    if given is None and preset != DEFAULT_PRESET:
        screen.print(f"preset {preset}, which the policy needs")


def _line(score: EpisodeResult) -> str:
    line = f"seed {score.seed}: score {score.score:.2f} after {score.steps} steps"
    return line if score.failure is None else f"{line}; the policy failed: {score.failure}"


def play_all(screen: Console, evaluation: Evaluation) -> None:
    """Plays the remaining episodes and prints their means. The bar counts steps, since episodes differ in length."""
    done = len(evaluation.scores)
    total = done + sum(len(unit.seeds) for unit in evaluation.units)
    shown = TextColumn("{task.fields[shown]}", markup=False)
    with Bars(screen, shown, TimeElapsedColumn(), speed_estimate_period=120) as progress:
        bar = progress.add_task("playing", total=evaluation.steps, shown=f"{done}/{total} episodes")
        start = time.monotonic()
        for count, score in enumerate(evaluation.play(), start=1):
            rate = count / (time.monotonic() - start)
            length = task_spec(score.task).horizon(evaluation.settings.rules)
            progress.update(bar, advance=length, shown=f"{done + count}/{total} episodes, {rate:.1f}/s")
    _summarise(screen, evaluation.scores)


def _summarise(screen: Console, scores: Sequence[EpisodeResult]) -> None:
    """Prints the mean scores over tasks: by variant, and by strength of each shift. Then prints the failures.

    As in reports, means of several tasks leave out those of other packages.
    """
    rows = frame(scores).assign(method=[score.method for score in scores])
    places = [_heading_and_column(score) for score in scores]
    rows["heading"], rows["column"] = [heading for heading, _ in places], [column for _, column in places]
    averaged = rows[rows["task"].isin(counted_tasks(rows["task"]))]
    environments = averaged.groupby(["heading", "method", "column", "task", "variant"])["score"].mean()
    means = environments.groupby(["heading", "method", "column"]).mean()
    for heading in averaged["heading"].unique():
        table_of = means[heading].unstack()
        columns = sorted(table_of, key=lambda column: (VARIANTS.index(column) if column in VARIANTS else 0, column))
        table = Table(heading, *columns, box=None, header_style="bold")
        for column in table.columns[1:]:
            column.justify = "right"
        for method, values in table_of[columns].iterrows():
            table.add_row(str(method), *("-" if isnan(value) else f"{value:.3f}" for value in values))
        screen.print(table)
    for method, reasons in rows.groupby("method", sort=False)["failure"]:
        if count := reasons.count():
            screen.print(f"{method}: {counted(count, 'episode')} failed: {reasons.dropna().iloc[0]}", soft_wrap=True)


def _heading_and_column(score: EpisodeResult) -> tuple[str, str]:
    if not score.shift:
        return "mean score", score.variant
    return ("several shifts", score.shift) if "+" in score.shift else axis_and_level(score.shift)


def demo(
    out: Annotated[Path, Option(help="The folder for all results; those of the same tour are replaced.")] = Path(
        "out/demo"
    ),
    tasks: option.Tasks = "all",
    episodes: Annotated[int, Option(min=1, help="Episodes of each agent in each environment.")] = 3,
    jobs: option.Jobs = None,
) -> None:
    """Evaluate the expert, the random and the no-op agent in all environments, and write the report."""
    settings = EvaluationSettings(tasks=tasks, episodes=episodes, jobs=jobs, out=out, renderer="software")
    check_extra("the tour's figures and videos", "eval", "video")
    busy = EvaluationError(f"another demo is running in {out}; wait for it, or give another folder with --out")
    with files.locked(make_writable_folder(out), busy=busy):
        _tour(console(), out, settings)


def _tour(screen: Console, out: Path, settings: EvaluationSettings) -> None:
    start = time.perf_counter()
    if any(path.lstat().st_size and not files.is_unfinished(path) for path in out.iterdir()):
        if not _is_ours(out, settings):
            raise EvaluationError(
                f"{out} holds files that this command did not make with these options; give another folder with --out"
            )
        screen.print(f"replacing an earlier run in {out}", soft_wrap=True)
        with open_scores(out) as scores:
            scores.clear()
    evaluation = Evaluation(TOURED, settings)  # writes the settings, which identify the folder
    with files.new_file(out / SHEET, overwrite=True) as unfinished:
        contact_sheet(0, 128, settings.renderer).save(unfinished)
    play_all(screen, evaluation)
    episodes = extremes(score for score in evaluation.scores if score.policy == TOURED[0])
    best = [(which, score) for which, score in episodes if which == "best"]
    links = {"The initial scenes of all environments": SHEET, **film_episodes(best, out, settings.renderer)}
    page = report([out], out, links=links)
    count = counted(len(evaluation.scores), "episode")
    screen.print(f"{count}, {time.perf_counter() - start:.0f} s; scores, tables, figures, videos:")
    screen.print(page, soft_wrap=True)


def _is_ours(folder: Path, settings: EvaluationSettings) -> bool:
    """Whether the folder holds this evaluation. Another one, which may have taken days, must not be replaced."""
    try:
        known = read_settings(folder)
    except EvaluationError:
        return False
    now = settings.recorded() | {"policies": [source.described() for source in prepared(TOURED, settings)[0]]}
    return all(known.get(name) == now[name] for name in SAME)
