"""`magical-mj compare`: two policies on the same scenes."""

from __future__ import annotations

from typing import Annotated

import typer
from rich.table import Table

from magical_mj.cli.console import console
from magical_mj.evaluation.compare import choose, compare

Side = Annotated[str, typer.Argument(help="DIR, or DIR:POLICY where it holds several.", show_default=False)]


def make_comparison(a: Side, b: Side) -> None:
    """Compare two policies on the scenes that both have played: A - B, with its 95 % interval."""
    found = compare(a, b)
    names = [choose(side)[0] for side in (a, b)]
    if names[0] == names[1]:
        names = [a, b]
    screen = console()
    table = Table("variant", *names, "difference", "95 %", "better", "worse", "scenes", box=None, header_style="bold")
    for column in table.columns[1:]:
        column.justify = "right"
    for row in found.to_dict("records"):
        interval = f"[{row['low']:+.3f}, {row['high']:+.3f}]" if row["low"] == row["low"] else "-"
        means = (f"{row[side]:.3f}" for side in ("first", "second"))
        counts = (str(row[name]) for name in ("better", "worse", "scenes"))
        table.add_row(row["variant"], *means, f"{row['difference']:+.3f}", interval.replace("[", r"\["), *counts)
    screen.print(table)
    unpaired = found["unpaired"].iloc[-1]
    if unpaired:
        screen.print(f"{unpaired} scenes that only one of them has played are left out")
