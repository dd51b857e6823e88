"""`magical-mj demo`: a short tour of the benchmark: an evaluation of all environments, its report, and videos."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Final

import typer

from magical_mj import files
from magical_mj.cli.console import Jobs, Tasks, claim_folder, console
from magical_mj.cli.environments import contact_sheet
from magical_mj.cli.evaluate import show_progress, summary
from magical_mj.cli.results import film_episodes
from magical_mj.errors import EvaluationError
from magical_mj.evaluation.report import extremes, report
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import SCORES, SETTINGS
from magical_mj.evaluation.settings import EvaluationSettings

AGENTS: Final = ("expert", "random", "noop")
SHEET: Final = "environments.png"

Out = Annotated[Path, typer.Option(help="The folder for all results; those of an earlier run are replaced.")]
Episodes = Annotated[int, typer.Option(min=1, help="Of each agent in each environment.")]


def demo(out: Out = Path("out/demo"), tasks: Tasks = "all", episodes: Episodes = 3, jobs: Jobs = None) -> None:
    """Evaluate the expert, the random and the no-op agent in all environments, and write the report."""
    screen = console()
    start = time.perf_counter()
    settings = EvaluationSettings(tasks=tasks, episodes=episodes, jobs=jobs, out=out)
    claim_folder(out)
    old = [path for path in (out / SCORES, out / SETTINGS, *out.glob("best-*.mp4")) if path.exists()]
    if old and not (out / SHEET).exists():
        raise EvaluationError(f"{out} holds an evaluation that this command has not made; give another folder by --out")
    if old:
        screen.print(f"replacing an earlier run in {out}", soft_wrap=True)
    for path in old:
        path.unlink()
    with files.new_file(out / SHEET, overwrite=True) as unfinished:  # first, since it marks the folder as ours
        contact_sheet(0, size=128).save(unfinished)
    evaluation = Evaluation(AGENTS, settings)
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
