"""`magical-mj demo`: a short tour of the benchmark: an evaluation of all environments, its report, and videos."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console

from magical_mj.cli.console import Jobs, Tasks, console, make_writable_folder
from magical_mj.cli.environments import contact_sheet
from magical_mj.cli.evaluate import show_progress, summary
from magical_mj.cli.results import film_episodes
from magical_mj.evaluation.folder import read_settings
from magical_mj.evaluation.reports.report import extremes, report
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import ScoreFile
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.policies.loading import sources
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.extras import check_extra

AGENTS: Final = ("expert", "random", "noop")
SHEET: Final = "environments.png"
SAME: Final = ("environments", "episodes", "preset", "rules", "time_limit", "worlds")
"""The settings by which an earlier run of the same tour is recognised; those that a new version changes are not."""

Out = Annotated[Path, typer.Option(help="The folder for all results; those of the same tour are replaced.")]
Episodes = Annotated[int, typer.Option(min=1, help="Of each agent in each environment.")]


def demo(out: Out = Path("out/demo"), tasks: Tasks = "all", episodes: Episodes = 3, jobs: Jobs = None) -> None:
    """Evaluate the expert, the random and the no-op agent in all environments, and write the report."""
    settings = EvaluationSettings(tasks=tasks, episodes=episodes, jobs=jobs, out=out)
    check_extra("videos", "video")
    busy = EvaluationError(f"another demo is running in {out}; wait for it, or give another folder by --out")
    with files.locked(make_writable_folder(out), busy=busy):
        _tour(console(), out, settings)


def _tour(screen: Console, out: Path, settings: EvaluationSettings) -> None:
    start = time.perf_counter()
    if any(path.lstat().st_size and not files.is_unfinished(path) for path in out.iterdir()):
        if not _is_ours(out, settings):
            raise EvaluationError(
                f"{out} holds files that this command has not made, or not with these options; "
                "give another folder by --out"
            )
        screen.print(f"replacing an earlier run in {out}", soft_wrap=True)
        with ScoreFile(out) as scores:
            scores.clear()
    evaluation = Evaluation(AGENTS, settings)  # writes the settings, by which the folder is recognised
    with files.new_file(out / SHEET, overwrite=True) as unfinished:
        contact_sheet(0, size=128).save(unfinished)
    show_progress(screen, evaluation)
    for line in summary(evaluation.scores):
        screen.print(line, soft_wrap=True)
    best = [
        (which, score) for which, score in extremes(evaluation.scores) if (which, score.policy) == ("best", AGENTS[0])
    ]
    links = {"The initial scenes of all environments": SHEET, **film_episodes(best, out)}
    page = report([out], out, links=links)
    screen.print(
        f"{len(evaluation.scores)} episodes, {time.perf_counter() - start:.0f} s; scores, tables, figures, videos:"
    )
    screen.print(page, soft_wrap=True)


def _is_ours(folder: Path, settings: EvaluationSettings) -> bool:
    """Whether the folder holds this evaluation: another one may have taken days."""
    try:
        known = read_settings(folder)
    except EvaluationError:
        return False
    now = settings.recorded()
    policies = [source.describe() for source in sources(AGENTS)]
    return known.get("policies") == policies and all(known.get(name) == now[name] for name in SAME)
