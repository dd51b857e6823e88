"""`magical-mj list`: what there is."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from magical_mj import ENVIRONMENTS, env_id
from magical_mj.cli.console import console
from magical_mj.registry import environment_axes, task_spec

Ids = Annotated[bool, typer.Option("--ids", help="Print only the Gymnasium ids, one per line.")]


def list_environments(ids: Ids = False) -> None:
    """List the 60 environments, with their horizon and what varies between their scenes."""
    out = console()
    if ids:
        for task, variant in ENVIRONMENTS:
            out.print(env_id(task, variant))
        return
    table = Table("task", "variant", "steps", "what varies", box=None, pad_edge=False, header_style="bold")
    for task, variant in ENVIRONMENTS:
        axes = ", ".join(environment_axes(task, variant)) or "nothing"
        table.add_row(task, variant, str(task_spec(task).horizon()), axes)
    out.print(table)
