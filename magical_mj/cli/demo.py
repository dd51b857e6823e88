"""`magical-mj demo`: every environment played once, with scores, a picture and videos."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Final, get_args

import typer
from rich.console import Console
from rich.table import Table

import magical_mj
from magical_mj import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.cli.console import Seed, claim_folder, console
from magical_mj.cli.episodes import Agent, Result, film, play
from magical_mj.cli.parallel import Jobs, cores, in_parallel
from magical_mj.cli.sheet import contact_sheet
from magical_mj.registry import task_spec

AGENTS: Final[tuple[Agent, ...]] = get_args(Agent)
FILMED: Final = ("Demo", "expert")  # of each task, the variant and the agent that go into its video
FILM_SIZE: Final = 192  # pixels
FILM_SPEED: Final = 4  # times real time: 10 s for the longest task
SHEET: Final = "environments.png"

Pair = tuple[str, str]
Scores = dict[tuple[str, str, Agent], Result]
Out = Annotated[Path, typer.Option(help="The folder for the picture and the videos; those of an earlier run go.")]


def demo(out: Out = Path("out/demo"), seed: Seed = 0, jobs: Jobs = None) -> None:
    """Play one full episode of each of the 60 environments with the expert, the random and the no-op agent."""
    screen = console()
    start = time.perf_counter()
    claim_folder(out)
    old = [path for path in (out / SHEET, *(out / f"{task}.mp4" for task in TASKS)) if path.exists()]
    if old:
        screen.print(f"replacing {len(old)} files of an earlier run in {out}", soft_wrap=True)
    results = _play_all(screen, out, seed, jobs or cores())
    contact_sheet(seed, size=128).save(out / SHEET)
    _print_scores(screen, results)
    steps = sum(result.steps for result in results.values())
    seconds = time.perf_counter() - start
    screen.print(f"{len(results)} episodes, {steps} steps, {seconds:.0f} s with {jobs or cores()} processes")
    screen.print(f"the initial scenes: {out / SHEET}", soft_wrap=True)
    screen.print(f"the expert at each task: {out}/*.mp4", soft_wrap=True)


def play_pair(pair: Pair, seed: int, out: Path) -> Scores:
    """What a worker does: one environment, one episode with each agent, with both pictures drawn at every step."""
    task, variant = pair
    env = magical_mj.load(task, variant, seed=seed)
    results: Scores = {}
    for agent in AGENTS:
        if (variant, agent) == FILMED:
            with film(out / f"{task}.mp4", FILM_SIZE, FILM_SPEED) as watch:
                results[task, variant, agent] = play(env, task, agent, seed, watch)
        else:
            results[task, variant, agent] = play(env, task, agent, seed)
    env.close()
    return results


def _play_all(screen: Console, out: Path, seed: int, jobs: int) -> Scores:
    """Plays everything, longest first."""
    pairs = sorted(ENVIRONMENTS, key=lambda pair: -task_spec(pair[0]).horizon())
    results: Scores = {}
    for found in in_parallel(screen, "playing", play_pair, [(pair, seed, out) for pair in pairs], jobs):
        results |= found
    return results


def _print_scores(screen: Console, results: Scores) -> None:
    table = Table("score", "agent", box=None, header_style="bold", padding=(0, 1, 0, 0))
    for variant in VARIANTS:
        table.add_column(variant, justify="right")
    for task in TASKS:
        for agent in AGENTS:
            table.add_row(task if agent == AGENTS[0] else "", agent, *_row(results, task, agent))
    screen.print(table)


def _row(results: Scores, task: str, agent: Agent) -> Iterator[str]:
    for variant in VARIANTS:
        result = results.get((task, variant, agent))
        yield "-" if result is None else f"{result.score:.2f}"
