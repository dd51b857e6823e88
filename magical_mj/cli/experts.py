"""`magical-mj experts`: how well the experts do, in every environment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from statistics import fmean
from typing import Annotated, NamedTuple

import typer

import magical_mj
from magical_mj import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.cli.console import Force, check_suffix, claim, console
from magical_mj.cli.parallel import Jobs, in_parallel
from magical_mj.registry import task_spec, variant_name

Tasks = Annotated[list[str] | None, typer.Argument(help="Which tasks.", show_default="all")]
Variants = Annotated[list[str] | None, typer.Option("--variant", help="Only these variants.", show_default="all")]
Seeds = Annotated[int, typer.Option(min=1, help="How many episodes each: scenes and experts of seeds 0, 1, ...")]
Out = Annotated[Path | None, typer.Option(help="Also write the tables to this Markdown file.", show_default=False)]


class Episode(NamedTuple):
    """One episode of an expert."""

    task: str
    variant: str
    seed: int
    score: float
    seconds: float
    """Of processor time, for thinking and acting."""


def experts(
    tasks: Tasks = None,
    variant: Variants = None,
    seeds: Seeds = 20,
    jobs: Jobs = None,
    out: Out = None,
    force: Force = False,
) -> None:
    """Play the experts in every environment, and print their mean scores, their time, and what they missed."""
    chosen = {task_spec(task).name for task in tasks or TASKS}
    variants = {variant_name(name) for name in variant or VARIANTS}
    check_suffix(out, ".md")
    if out is not None:
        claim(out, force)
    screen = console()
    pairs = [(task, name) for task, name in ENVIRONMENTS if task in chosen and name in variants]
    work = [(task, name, seed) for task, name in reversed(pairs) for seed in range(seeds)]  # the longest first
    text = report(list(in_parallel(screen, "playing", play, work, jobs)), seeds)
    screen.print(text, soft_wrap=True, markup=False)
    if out is not None:
        out.write_text(text + "\n")


def play(task: str, variant: str, seed: int) -> Episode:
    """What a worker does: one episode, in the scene of a seed by the expert of the same seed."""
    env = magical_mj.load(task, variant, seed=seed, observations=())
    start = time.process_time()
    score = magical_mj.experts.run_episode(env, task, scene_seed=seed, seed=seed)
    env.close()
    return Episode(task, variant, seed, score, time.process_time() - start)


def report(episodes: Sequence[Episode], seeds: int) -> str:
    """Tables of mean scores and times, tasks down and variants across, and a list of what was missed."""
    missed = sorted(f"{e.task} {e.variant} {e.seed}: {e.score:.2f}" for e in episodes if e.score < 1.0)
    return "\n".join(
        [
            "# The experts\n",
            f"{seeds} episodes in each environment, rules of the paper. Mean scores:\n",
            *_table(episodes, lambda some: f"{fmean(episode.score for episode in some):.3f}"),
            "\nSeconds for an episode, on one core:\n",
            *_table(episodes, lambda some: f"{fmean(episode.seconds for episode in some):.1f}"),
            f"\n{len(episodes) - len(missed)} of {len(episodes)} episodes have the full score.",
            *(f"- {line}" for line in missed),
        ]
    )


def _table(episodes: Sequence[Episode], cell: Callable[[list[Episode]], str]) -> Iterator[str]:
    yield f"| Task | {' | '.join(VARIANTS)} |"
    yield f"| --- |{' ---: |' * len(VARIANTS)}"
    for task in TASKS:
        row = [[e for e in episodes if (e.task, e.variant) == (task, variant)] for variant in VARIANTS]
        if any(row):
            yield f"| {task} | {' | '.join(cell(some) if some else '' for some in row)} |"
