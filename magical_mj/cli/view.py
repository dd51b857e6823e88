"""`magical-mj view`: pictures of initial scenes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from PIL import Image

import magical_mj
from magical_mj import TASKS
from magical_mj.cli.console import Force, Seed, Variant, check_suffix, claim, console, file_name
from magical_mj.cli.episodes import both_views
from magical_mj.cli.sheet import contact_sheet

Task = Annotated[str | None, typer.Argument(help=f"One of {', '.join(TASKS)}.", show_default=False)]
Grid = Annotated[bool, typer.Option("--grid", help="All 60 environments on one sheet, instead of TASK and VARIANT.")]
Out = Annotated[Path | None, typer.Option(help="The PNG file.", show_default="TASK-VARIANT-SEED.png")]
Size = Annotated[
    int | None,
    typer.Option(min=16, max=2048, help="Side of each picture in pixels.", show_default="384; 128 in the grid"),
]


def view(
    task: Task = None,
    variant: Variant = "Demo",
    seed: Seed = 0,
    grid: Grid = False,
    out: Out = None,
    size: Size = None,
    force: Force = False,
) -> None:
    """Draw the initial scene of an environment, from above and as the robot sees it, or those of all 60."""
    check_suffix(out, ".png")
    if grid:
        if task is not None:
            raise typer.BadParameter("give either TASK or --grid, not both.")
        path = claim(out or Path(f"environments-{seed}.png"), force)
        picture = contact_sheet(seed, size or 128)
    else:
        if task is None:
            raise typer.BadParameter("give TASK, or --grid for all 60 environments.")
        env = magical_mj.load(task, variant, seed=seed, observations=())
        path = claim(out or Path(file_name(task, variant, seed, ".png")), force)
        env.reset()
        picture = Image.fromarray(both_views(env, size or 384))
        env.close()
    picture.save(path)
    console().print(path, soft_wrap=True)
