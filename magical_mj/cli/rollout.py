"""`magical-mj rollout`: episodes with a simple agent, their scores, and a video."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from statistics import fmean
from typing import Annotated

import typer
from rich.progress import track

import magical_mj
from magical_mj.cli.console import Force, Seed, Size, Task, Variant, check_suffix, claim, console
from magical_mj.cli.episodes import Agent, film, play

Who = Annotated[Agent, typer.Option(help="The expert, uniform random actions, or none at all.")]
Episodes = Annotated[int, typer.Option(min=1, help="How many; the scenes are those of SEED, SEED + 1, ...")]
Video = Annotated[Path | None, typer.Option(help="Write an MP4 file of the episodes, both views.", show_default=False)]


def rollout(
    task: Task,
    variant: Variant = "Demo",
    agent: Who = "expert",
    episodes: Episodes = 1,
    seed: Seed = 0,
    video: Video = None,
    size: Size = 384,
    force: Force = False,
) -> None:
    """Play episodes with the expert or a simple agent, and print the scores."""
    check_suffix(video, ".mp4")
    env = magical_mj.load(task, variant, seed=seed, observations=())
    if video is not None:
        claim(video, force)
    out = console()
    scores = []
    with nullcontext() if video is None else film(video, size) as watch:
        for episode in track(
            range(seed, seed + episodes), "playing", console=out, transient=True, disable=not out.is_terminal
        ):
            result = play(env, task, agent, episode, watch)
            scores.append(result.score)
            out.print(f"seed {episode}: score {result.score:.2f} after {result.steps} steps")
    env.close()
    out.print(f"mean of {episodes}: {fmean(scores):.3f}")
    if video is not None:
        out.print(video, soft_wrap=True)
