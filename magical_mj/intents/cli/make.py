"""`magical-mj demos intents`: demonstrations of intents by the expert, and data sets of them."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Argument, Option

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, console, counting, how_to_continue, with_bar
from magical_mj.exports.cli.export import check_target
from magical_mj.utils.errors import counted
from magical_mj.utils.settings import LARGEST_SETTING


def make_intents(
    context: typer.Context,
    intents: Annotated[str, Argument(help="A set, such as train, or intents; several with commas.")] = "train",
    per_intent: Annotated[
        int, Option(min=1, max=LARGEST_SETTING, help="Demonstrations of each intent in each variant.")
    ] = 5,
    scenes: Annotated[
        int | None,
        Option(min=1, max=8, help="Number of demo scenes in the variant Demo.", show_default="1, or as in INTENTS"),
    ] = None,
    variants: option.Variants = "Demo",
    to: Annotated[
        Literal["npz", "lerobot", "webdataset"] | None,
        Option(
            metavar="FORMAT",
            help="npz (a numpy archive), lerobot or webdataset (an archive).",
            show_default="only the actions are stored",
        ),
    ] = None,
    out: Annotated[Path | None, Option(help="The file or the folder.", show_default="by intents and preset")] = None,
    preset: Annotated[str, Option(help="The observations.", autocompletion=option.COMPLETIONS["preset"])] = "State",
    folder: Annotated[
        Path | None, Option(help="The folder of the stored actions.", show_default="the user's cache folder")
    ] = None,
    jobs: option.Jobs = None,
    force: option.Force = False,
) -> None:
    """Make demonstrations of intents by the expert; --to exports them. Called again, the command continues."""
    from magical_mj.exports.formats import default_target, make_data_set  # imported late: it loads the simulator
    from magical_mj.intents.expert_data import dataset

    check_fits(context, to is not None, "with --to", "out", "preset", "force")
    screen, start = console(), time.monotonic()
    target = "" if to is None else str(out or default_target(to, f"intents-{intents}", [], preset))
    if to is not None:
        check_target(to, target, set(), force and to != "lerobot")
    with how_to_continue(screen, "the same command continues"), counting(screen, "demonstrating") as watch:
        data = dataset(
            intents, per_intent, preset, scenes=scenes, variants=variants, folder=folder, jobs=jobs, watch=watch
        )
    number = len({stored.task for stored in data.stored})
    screen.print(
        f"{counted(len(data), 'demonstration')} of {counted(number, 'intent')} in {data.path}, "
        f"{time.monotonic() - start:.0f} s",
        soft_wrap=True,
    )
    if to is not None:
        replayed = map(data.demonstration, range(len(data)))
        demos = list(with_bar(screen, "replaying", replayed, len(data)))
        make_data_set(to, demos, target, preset, overwrite=force)
        screen.print(target, soft_wrap=True)
