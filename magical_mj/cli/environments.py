"""`magical-mj list`, `view` and `export`: the environments, pictures of their initial scenes, and their models."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Annotated, Final

import typer
from PIL import Image, ImageDraw, ImageFont
from rich.console import Console
from rich.table import Table
from typer import Argument, Option

import magical_mj
from magical_mj import ENVIRONMENTS, TASKS, VARIANTS, env_id
from magical_mj.cli import option
from magical_mj.cli.console import check_fits, check_writable, complain, console, file_name, output_path
from magical_mj.cli.film import INK, PAPER, side_by_side, views_of
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks import KNOWN
from magical_mj.tasks.languages import described_tasks
from magical_mj.tasks.languages import languages as task_languages
from magical_mj.tasks.registry import Pair, environment_axes, environments, task_plugins, task_spec
from magical_mj.tasks.suites import suite_of
from magical_mj.utils import files
from magical_mj.utils.errors import MagicalError, counted

GAP: Final = 6  # pixels between the cells of the contact sheet
MARGIN: Final = 28  # pixels above and left of the cells, for the labels
TEXT_SIZE: Final = 15  # pixels
ABSENT: Final = (242, 242, 242)  # the colour of cells without an environment


def list_environments(
    tasks: Annotated[
        str | None,
        Argument(
            metavar="[TASKS]",
            help="Tasks, separated by commas, also as package.module:SPEC.",
            show_default="all installed",
        ),
    ] = None,
    ids: Annotated[bool, Option("--ids", help="Print only the Gymnasium ids, one per line.")] = False,
    **languages: bool,
) -> None:
    """List the environments, with their horizons and what varies in them. Those of other packages come last."""
    out = console()
    for prefix in (name.removesuffix("s") for name, given in languages.items() if given):
        if ids:
            raise typer.BadParameter(f"--ids and --{prefix}s cannot be combined: {prefix}s have no registered ids.")
        for line in described_tasks(prefix, tasks or "all"):
            out.print(line, soft_wrap=True, markup=False, highlight=False)
        return
    pairs = environments(tasks or tuple(KNOWN))
    for name in () if tasks else task_plugins():
        try:
            pairs += environments([name])
        except MagicalError as error:  # the tasks of the other packages may still work
            complain(str(error))
    if ids:
        for task, variant in pairs:
            suite = suite_of(task)
            for id_ in [env_id(task, variant)] if suite is None else suite.ids(task, variant):
                out.print(id_)
        return
    benchmark = [pair for pair in pairs if pair[0] in TASKS]
    others = [pair for pair in pairs if pair[0] not in TASKS]
    for what, group in (
        ("The benchmark", benchmark),
        ("Not in the benchmark: other suites and installed tasks", others),
    ):
        _print_table(out, group, what if tasks is None else "")


def _print_table(out: Console, pairs: Sequence[Pair], title: str) -> None:
    """Prints the horizons and the varied axes of environments. Their numbers follow the title."""
    if title:
        names = len({task for task, _ in pairs})
        out.print(f"{title}: {counted(names, 'task')}, {counted(len(pairs), 'environment')}", style="bold")
    if not pairs:
        return
    table = Table("task", "variant", "steps", "varies", box=None, pad_edge=False, header_style="bold")
    for task, variant in pairs:
        axes = ", ".join(environment_axes(task, variant)) or "nothing"
        table.add_row(task, variant, str(task_spec(task).horizon()), axes)
    out.print(table)


option.add_flags(
    list_environments,
    {
        f"{prefix}s": f"List {prefix}s instead: the sets or {prefix}s in TASKS, or all sets."
        for prefix in task_languages()
    },
)


def view(
    context: typer.Context,
    task: option.OptionalTask = None,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    grid: Annotated[
        bool, Option("--grid", help="Draw all environments on one sheet; without TASK and VARIANT.")
    ] = False,
    out: Annotated[
        Path | None, Option(help="The PNG file, or its folder.", show_default="TASK-VARIANT-SEED.png")
    ] = None,
    size: Annotated[
        int | None,
        Option(min=16, max=2048, help="Side of each picture in pixels.", show_default="384; 128 in the grid"),
    ] = None,
    camera: option.Cameras = "allo,ego",
    shifts: option.Shifts = "",
    body: option.Body = GRIPPER,
    renderer: option.Renderer = None,
    force: option.Force = False,
) -> None:
    """Draw the initial scene of an environment from above and from the robot's view, or all initial scenes."""
    views = views_of(camera)
    if grid:
        if task is not None:
            raise typer.BadParameter("give either TASK or --grid, not both.")
        check_fits(context, False, "for one environment: the grid shows all from above", "camera", "shifts", "body")
        path = check_writable(output_path(out, f"environments-{seed}.png"), force)
        picture = contact_sheet(seed, size or 128, renderer)
    else:
        if task is None:
            raise typer.BadParameter("give TASK, or --grid for all environments.")
        path = output_path(out, file_name(task, variant, seed, ".png"))
        with closing(magical_mj.Engine(task, variant, seed=seed, shifts=shifts, body=body, renderer=renderer)) as env:
            check_writable(path, force)
            picture = Image.fromarray(side_by_side(env, size or 384, views))
    with files.new_file(path, overwrite=force) as unfinished:
        picture.save(unfinished)
    console().print(path, soft_wrap=True)


def export(
    task: option.Task,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    out: Annotated[
        Path | None, Option(help="The MJCF file, or its folder.", show_default="TASK-VARIANT-SEED.xml")
    ] = None,
    shifts: option.Shifts = "",
    body: option.Body = GRIPPER,
    force: option.Force = False,
) -> None:
    """Write a scene as a self-contained MJCF model. It includes shifts of scene and dynamics, but not of pictures."""
    path = output_path(out, file_name(task, variant, seed, ".xml"))
    with closing(magical_mj.Engine(task, variant, seed=seed, shifts=shifts, body=body)) as env:
        check_writable(path, force)
        console().print(magical_mj.export_mjcf(env, path, overwrite=force), soft_wrap=True)


def contact_sheet(seed: int, size: int, renderer: str | None = None) -> Image.Image:
    """The initial scenes of all environments from above, each `size` pixels wide. Rows are tasks, columns variants."""
    pitch = size + GAP
    sheet = Image.new("RGB", (MARGIN + len(VARIANTS) * pitch, MARGIN + len(TASKS) * pitch), PAPER)
    for row, task in enumerate(TASKS):
        for column, variant in enumerate(VARIANTS):
            cell = _scene(task, variant, seed, size, renderer)
            sheet.paste(cell, (MARGIN + column * pitch, MARGIN + row * pitch))
    _label(sheet, VARIANTS, pitch)
    upright = sheet.rotate(-90, expand=True)  # the tasks' names are rotated
    _label(upright, tuple(reversed(TASKS)), pitch, start=GAP)
    return upright.rotate(90, expand=True)


def _scene(task: str, variant: str, seed: int, size: int, renderer: str | None) -> Image.Image:
    if (task, variant) not in ENVIRONMENTS:
        return Image.new("RGB", (size, size), ABSENT)
    with closing(magical_mj.Engine(task, variant, seed=seed, renderer=renderer)) as env:
        return Image.fromarray(env.render("allo", size))


def _label(sheet: Image.Image, names: tuple[str, ...], pitch: int, start: int = MARGIN) -> None:
    """Writes the names above the cells."""
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(TEXT_SIZE)
    for index, name in enumerate(names):
        middle = start + index * pitch + (pitch - GAP) / 2
        draw.text((middle, MARGIN / 2), name, INK, font, anchor="mm")
