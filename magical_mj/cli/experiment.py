"""`magical-mj experiment`: many trainings and their evaluations, in one report."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from magical_mj.cli.console import console
from magical_mj.evaluation.backends import Backend

File = Annotated[
    Path, typer.Argument(help="TOML: methods, tasks, seeds ...; see docs/learners.md.", show_default=False)
]
Out = Annotated[Path, typer.Option(help="The folder for runs, evaluations and the report.", show_default=False)]
Jobs = Annotated[int | None, typer.Option(min=1, help="Runs at once, each on one core. One alone uses all cores.")]
Where = Annotated[Backend, typer.Option(help="Where they run: on this machine or on a cluster.")]
Address = Annotated[str | None, typer.Option(help="Of the cluster, such as tcp://host:8786.", show_default=False)]


def experiment(file: File, out: Out, jobs: Jobs = 1, backend: Where = "local", address: Address = None) -> None:
    """Train and evaluate methods x tasks x seeds. Called again, it goes on with what is left."""
    from magical_mj import baselines

    planned = baselines.runs(file, out)
    screen = console()
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=screen) as progress:
        bar = progress.add_task("runs, and the report", total=len(planned) + 1)
        for line in baselines.conduct(planned, out, jobs=jobs, backend=backend, address=address):
            screen.print(line, soft_wrap=True)
            progress.advance(bar)
