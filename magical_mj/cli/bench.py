"""`magical-mj bench`: how fast the environments are here, beside what MuJoCo itself takes for the same."""

from __future__ import annotations

import cProfile
import json
import pstats
from collections.abc import Sequence
from contextlib import nullcontext
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from magical_mj.cli.console import console
from magical_mj.presets import PRESETS, preset
from magical_mj.registry import environments, listed
from magical_mj.rendering.backend import check_backend

if TYPE_CHECKING:
    from magical_mj.speed.measure import Measurement

PROFILED = 30  # functions shown

Tasks = Annotated[str, typer.Option(help="Tasks, separated by commas.")]
Variants = Annotated[str, typer.Option(help="Variants, separated by commas.")]
Presets = Annotated[str, typer.Option(help="Presets, separated by commas; or all.")]
Steps = Annotated[int, typer.Option(min=1, help="At least so many in each environment, in whole episodes.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON, times in seconds.")]
Markdown = Annotated[bool, typer.Option("--markdown", help="Print a Markdown table.")]
Profile = Annotated[bool, typer.Option("--profile", help="Print where the time goes instead.")]


def bench(
    tasks: Tasks = "all",
    variants: Variants = "all",
    presets: Presets = "LoRes4E",
    steps: Steps = 1000,
    as_json: Json = False,
    markdown: Markdown = False,
    profile: Profile = False,
) -> None:
    """Measure steps per second with resets, the bare MuJoCo loop in turn with them, and resets alone."""
    check_backend()  # before the simulator is loaded, which would not say why it fails
    from magical_mj.speed import report

    names = listed(presets, PRESETS)
    for name in names:
        preset(name)  # or its error
    chosen = [(*pair, name) for name in names for pair in environments(tasks, variants)]
    with cProfile.Profile() if profile else nullcontext() as profiler:
        measurements, yardstick = _measure(chosen, steps)
    if profiler is not None:
        pstats.Stats(profiler).sort_stats("tottime").print_stats(PROFILED)
    elif as_json:
        typer.echo(json.dumps(report.as_json(measurements, yardstick), indent=2))
    elif markdown:
        typer.echo(report.markdown(measurements, yardstick))
    else:
        _print_table(measurements, yardstick)


def _measure(chosen: Sequence[tuple[str, str, str]], steps: int) -> tuple[list[Measurement], float | None]:
    """One after another, and the yardstick in turn with them; progress on standard error."""
    from magical_mj.speed.measure import measure
    from magical_mj.speed.yardstick import Yardstick

    screen, yardstick, measurements = Console(stderr=True), Yardstick(), []
    for task, variant, name in track(
        chosen, "measuring", console=screen, transient=True, disable=not screen.is_terminal
    ):
        yardstick.run()
        measurements.append(measure(task, variant, name, steps))
    return measurements, yardstick.rate


def _print_table(measurements: Sequence[Measurement], yardstick: float | None) -> None:
    from magical_mj.speed import report

    table = Table(box=None, header_style="bold", pad_edge=False)
    for column, title in enumerate(report.HEAD):
        table.add_column(title, justify="right" if column >= report.NAMES else "left")
    for row in report.rows(measurements):
        table.add_row(*row)
    out = console()
    out.print(table)
    out.print(report.summary(yardstick), soft_wrap=True)
