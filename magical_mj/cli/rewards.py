"""`magical-mj evaluate-reward`: how well learnt rewards rank episodes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from magical_mj.cli import option
from magical_mj.cli.console import check_suffix, check_writable, console
from magical_mj.utils.extras import check_extra

Runs = Annotated[
    list[Path],
    typer.Argument(
        help="Folders of trainings. Those that learn no reward, such as bc, only add episodes.", show_default=False
    ),
]
Scenes = Annotated[int, typer.Option(min=1, max=1000, help="Number of scenes in each environment, none of the test's.")]
Out = Annotated[Path | None, typer.Option("--out", help="A CSV file for all sums and scores.", show_default=False)]


def evaluate_reward(
    runs: Runs,
    variants: option.Variants = "all",
    scenes: Scenes = 5,
    out: Out = None,
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
