"""`magical-mj demos export`: demonstrations for other tools: numpy, Minari, LeRobot, robomimic."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

import magical_mj
from magical_mj.cli.console import Force, Tasks, Variants, check_fits, check_suffix, check_writable, console
from magical_mj.cli.demo_files import Paths, files_of, read_chosen
from magical_mj.utils.errors import SettingsError

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
    from magical_mj.demos.export.lerobot import to_lerobot
    from magical_mj.demos.export.minari import check_new, minari_name
    from magical_mj.demos.export.robomimic import to_robomimic
    from magical_mj.demos.files import SUFFIX  # which loads the simulator

    demos = read_chosen(paths, tasks, variants)
    screen = console()
    names = list(dict.fromkeys(demo.name for demo in demos))
    if to == "npz":
        preset = "LoRes4E" if preset is None else preset
        path = Path(out or f"{names[0] if len(names) == 1 else 'demonstrations'}-{preset or 'views'}{SUFFIX}")
        check_suffix(path, SUFFIX)
        if path.resolve().parent in {file.resolve().parent for file in files_of(paths, tasks, variants)}:
            raise typer.BadParameter(f"{path} would lie among the demonstrations; give --out in another folder.")
        magical_mj.demos.to_npz(demos, check_writable(path, force), preset, drop_noop=drop_noop, overwrite=force)
        screen.print(path, soft_wrap=True)
        return
    if out is not None and len(names) > 1:
        raise typer.BadParameter(
            f"one data set holds one environment, but these are of {', '.join(names)}: drop --out."
        )
    chosen = {name: [demo for demo in demos if demo.name == name] for name in names}
    if to == "minari":
        preset = "State" if preset is None else preset
        ids = {name: out or minari_name(some, preset) for name, some in chosen.items()}
        if out is None and not force:
            for made in ids.values():  # before the first one is made
                check_new(made)
        for name, some in chosen.items():
            screen.print(magical_mj.demos.to_minari(some, ids[name], preset, overwrite=force), soft_wrap=True)
        return
    views = _views("LoRes4E" if preset is None else preset)
    ending = ".hdf5" if to == "robomimic" else f"{'-fingers' if fingers else ''}-lerobot"
    made = {name: Path(out or f"{name}-{views}{ending}") for name in names}
    for path in made.values():  # before the first one is made
        if to == "robomimic":
            check_suffix(path, ending)
        elif path.exists():
            raise FileExistsError(f"{path} exists already; give a new folder")
        check_writable(path, force)
    for name, path in made.items():
        if to == "robomimic":
            to_robomimic(chosen[name], path, views=views, overwrite=force)
        else:
            to_lerobot(chosen[name], path, views=views, fingers=fingers, video=video)
        screen.print(path, soft_wrap=True)


def _views(preset: str) -> str:
    """What policies of LeRobot and robomimic see, which stack frames themselves if they want any."""
    from magical_mj.demos.export.lerobot import PRESETS  # which loads the simulator

    views = {name: views for views, name in PRESETS.items()}
    if preset not in views:
        raise SettingsError(f"data sets of LeRobot and robomimic are of the presets {', '.join(views)}, not {preset}")
    return views[preset]
