"""`magical-mj demos export`: demonstrations for other tools: numpy, Minari, LeRobot, robomimic."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from magical_mj.cli.console import Force, Tasks, Variants, check_fits, check_suffix, check_writable, console
from magical_mj.cli.demos import Paths, files_of, read_chosen

if TYPE_CHECKING:  # imported late: it loads the simulator, which help does not need
    from magical_mj.demos.export import Exporter

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
    from magical_mj.demos.export import EXPORTERS

    exporter = EXPORTERS[to]
    given = {"drop_noop": drop_noop, "video": video, "fingers": fingers}
    for option in given:
        takers = [name for name, other in EXPORTERS.items() if option in other.options]
        check_fits(context, to in takers, f"with --to {' or '.join(takers)}", option)
    check_fits(context, exporter.replaces, "with other data sets: these are written into new folders only", "force")
    options = {option: given[option] for option in exporter.options}
    demos = read_chosen(paths, tasks, variants)
    preset = exporter.preset if preset is None else preset
    names = list(dict.fromkeys(demo.name for demo in demos))
    groups = {name: [demo for demo in demos if demo.name == name] for name in names}
    if exporter.of_many:
        groups = {names[0] if len(names) == 1 else "demonstrations": demos}
    elif out is not None and len(names) > 1:
        raise typer.BadParameter(
            f"one data set holds one environment, but these are of {', '.join(names)}: drop --out."
        )
    targets = {name: out or exporter.target(name, group, preset, options) for name, group in groups.items()}
    for target in targets.values():  # before the first one is made
        _check_target(target, exporter, {file.resolve().parent for file in files_of(paths, tasks, variants)}, force)
    for name, target in targets.items():
        exporter.write(groups[name], target, preset, overwrite=force, **options)
        console().print(target, soft_wrap=True)


def _check_target(target: str, exporter: Exporter, sources: set[Path], force: bool) -> None:
    """Raises an error unless a data set can be made there, whose demonstrations lie in the folders `sources`."""
    from magical_mj.demos.export.minari import check_new, to_minari
    from magical_mj.demos.files import SUFFIX

    path = Path(target)
    if exporter.write is to_minari:
        if not force:
            check_new(target)
    elif exporter.suffix:
        check_suffix(path, exporter.suffix)
        if exporter.suffix == SUFFIX and path.resolve().parent in sources:
            raise typer.BadParameter(f"{path} would lie among the demonstrations; give --out in another folder.")
        check_writable(path, force)
    elif path.exists():
        raise FileExistsError(f"{path} exists already; give a new folder")
