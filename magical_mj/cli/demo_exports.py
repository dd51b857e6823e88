"""`magical-mj demos export`: demonstrations for other tools: numpy, Minari, LeRobot, robomimic."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

import magical_mj
from magical_mj.cli.console import Force, Tasks, Variants, check_fits, check_suffix, claim, claim_folder, console
from magical_mj.cli.demos import SUFFIX, Paths, files_of, read_chosen
from magical_mj.errors import SettingsError
from magical_mj.registry import environments

Target = Annotated[
    Literal["npz", "minari", "lerobot", "robomimic"],
    typer.Option(help="A numpy archive, Minari or LeRobot data sets, or robomimic's HDF5."),
]
Name = Annotated[
    str | None,
    typer.Option("--out", help="The file, the data set's id, or the folder.", show_default="by environment and preset"),
]
Preset = Annotated[str | None, typer.Option(help="The observations.", show_default="LoRes4E; State for Minari")]
DropNoop = Annotated[bool, typer.Option(help="For npz: leave out the steps with the no-op action.")]
Video = Annotated[bool, typer.Option("--video", help="For LeRobot: videos, which are lossy, instead of pictures.")]
Fingers = Annotated[bool, typer.Option("--fingers", help="For LeRobot: the fingers' angles, too.")]


def export(
    context: typer.Context,
    paths: Paths = None,
    tasks: Tasks = "all",
    variants: Variants = "all",
    to: Target = "npz",
    out: Name = None,
    preset: Preset = None,
    drop_noop: DropNoop = True,
    video: Video = False,
    fingers: Fingers = False,
    force: Force = False,
) -> None:
    """Export demonstrations for other tools."""
    check_fits(context, to == "lerobot", "with --to lerobot", "video", "fingers")
    check_fits(context, to != "lerobot", "with other data sets: LeRobot's are written into new folders only", "force")
    check_fits(context, to == "npz", "with --to npz: other data sets keep the no-ops", "drop_noop")
    from magical_mj.demos.lerobot import to_lerobot  # which loads the simulator
    from magical_mj.demos.robomimic import to_robomimic

    demos = read_chosen(paths, tasks, variants)
    screen = console()
    names = list(dict.fromkeys(demo.name for demo in demos))
    if to == "npz":
        preset = "LoRes4E" if preset is None else preset
        path = Path(out or f"{names[0] if len(names) == 1 else 'demonstrations'}-{preset or 'views'}{SUFFIX}")
        check_suffix(path, SUFFIX)
        if path.resolve().parent in {file.resolve().parent for file in files_of(paths, environments(tasks, variants))}:
            raise typer.BadParameter(f"{path} would lie among the demonstrations; give --out in another folder.")
        magical_mj.demos.to_npz(demos, claim(path, force), preset, drop_noop=drop_noop, overwrite=force)
        screen.print(path, soft_wrap=True)
        return
    if out is not None and len(names) > 1:
        raise typer.BadParameter(
            f"one data set holds one environment, but these are of {', '.join(names)}: drop --out."
        )
    for name in names:
        some = [demo for demo in demos if demo.name == name]
        if to == "minari":
            preset = "State" if preset is None else preset
            made = magical_mj.demos.to_minari(some, out, preset, overwrite=force)
        elif to == "robomimic":
            views = _views("LoRes4E" if preset is None else preset)
            path = Path(out or f"{name}-{views}.hdf5")
            check_suffix(path, ".hdf5")
            to_robomimic(some, claim(path, force), views=views, overwrite=force)
            made = str(path)
        else:
            views = _views("LoRes4E" if preset is None else preset)
            folder = Path(out or f"{name}-{views}{'-fingers' if fingers else ''}-lerobot")
            claim_folder(folder.parent)
            to_lerobot(some, folder, views=views, fingers=fingers, video=video)
            made = str(folder)
        screen.print(made, soft_wrap=True)


def _views(preset: str) -> str:
    """What policies of LeRobot and robomimic see, which stack frames themselves if they want any."""
    from magical_mj.demos.lerobot import PRESETS  # which loads the simulator

    views = {name: views for views, name in PRESETS.items()}
    if preset not in views:
        raise SettingsError(f"data sets of LeRobot and robomimic are of the presets {', '.join(views)}, not {preset}")
    return views[preset]
