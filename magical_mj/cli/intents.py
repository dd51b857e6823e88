"""`magical-mj demos intents`: a data set of many intents, made by the expert."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import typer

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, check_suffix, console, counting, how_to_continue, with_bar
from magical_mj.utils.errors import counted
from magical_mj.utils.settings import LARGEST_SETTING

Intents = Annotated[str, typer.Argument(help="A set, such as train, or intents; several with commas.")]
PerIntent = Annotated[
    int, typer.Option(min=1, max=LARGEST_SETTING, help="Demonstrations of each intent in each variant.")
]
Scenes = Annotated[
    int | None,
    typer.Option(min=1, max=8, help="Number of demo scenes in the variant Demo.", show_default="1, or as in INTENTS"),
]
Variants = Annotated[
    str, typer.Option(help="Variants, separated by commas.", autocompletion=option.COMPLETIONS["variants"])
]
Target = Annotated[
    Literal["npz", "lerobot", "webdataset"] | None,
    typer.Option(
        metavar="FORMAT",
        help="npz (a numpy archive), lerobot or webdataset (an archive).",
        show_default="only the actions are stored",
    ),
]
Out = Annotated[Path | None, typer.Option(help="The file or the folder.", show_default="by intents and preset")]
Preset = Annotated[str, typer.Option(help="The observations.", autocompletion=option.COMPLETIONS["preset"])]
Folder = Annotated[
    Path | None, typer.Option(help="The folder of the stored actions.", show_default="the user's cache folder")
]


def intents(
    context: typer.Context,
    chosen: Intents = "train",
    per_intent: PerIntent = 5,
    scenes: Scenes = None,
    variants: Variants = "Demo",
    to: Target = None,
    out: Out = None,
    preset: Preset = "State",
    folder: Folder = None,
    jobs: option.Jobs = None,
    force: option.Force = False,
) -> None:
    """Make demonstrations of intents by the expert; --to exports them. Called again, the command continues."""
    from magical_mj.demos.export import SUFFIXES, default_target, make_data_set
    from magical_mj.intents.expert_data import dataset

    check_fits(context, to is not None, "with --to", "out", "preset", "force")
    screen, start = console(), time.monotonic()
    target = None if to is None else out or Path(default_target(to, f"intents-{chosen}", [], preset))
    if target is not None:
        if to in SUFFIXES:
            check_suffix(target, SUFFIXES[to])
        if target.exists() and not (force and to != "lerobot"):
            raise FileExistsError(
                f"{target} exists already; choose another --out{'' if to == 'lerobot' else ' or --force'}"
            )
    with (
        how_to_continue(screen, "the same command continues"),
        counting(screen, "demonstrating") as watch,
    ):
        data = dataset(
            chosen, per_intent, preset, scenes=scenes, variants=variants, folder=folder, jobs=jobs, watch=watch
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
        make_data_set(to, demos, str(target), preset, overwrite=force)
        screen.print(target, soft_wrap=True)
