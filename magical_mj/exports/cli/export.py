"""`magical-mj demos export`: data sets for other tools."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Option

from magical_mj.cli import option
from magical_mj.cli.console import (
    check_fits,
    check_suffix,
    check_writable,
    console,
    make_writable_folder,
)
from magical_mj.cli.stored_demos import Paths, Set, read_chosen, set_named, sources_of

if TYPE_CHECKING:  # imported late: it loads the simulator, which help does not need
    from magical_mj.demos import Demonstration


def export_demos(
    context: typer.Context,
    paths: Paths = None,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    which: Set = "1",
    to: Annotated[
        Literal["npz", "minari", "lerobot", "robomimic", "webdataset", "xirl"],
        Option(
            metavar="FORMAT",  # the list of names is wider than narrow terminals
            help="npz (a numpy archive), minari, lerobot, robomimic (HDF5), webdataset (an archive) or xirl (folders).",
        ),
    ] = "npz",
    out: Annotated[
        str | None, Option(help="The file, the data set's id, or the folder.", show_default="by environment and preset")
    ] = None,
    preset: Annotated[str | None, Option(help="The observations.", show_default="LoRes4E; State for Minari")] = None,
    drop_noop: Annotated[bool, Option(help="For npz: leave out the steps with the no-op action.")] = True,
    video: Annotated[
        bool, Option("--video", help="For LeRobot: videos, which are lossy, instead of pictures.")
    ] = False,
    fingers: Annotated[bool, Option("--fingers", help="For LeRobot: add the angles of the fingers.")] = False,
    force: option.Force = False,
) -> None:
    """Export demonstrations for other tools."""
    from magical_mj.demos.shipped import set_suffix
    from magical_mj.exports.formats import default_target, make_data_set
    from magical_mj.exports.minari import dataset_path

    check_fits(context, to == "npz", "with --to npz", "drop_noop")
    check_fits(context, to == "lerobot", "with --to lerobot", "video", "fingers")
    check_fits(context, to != "lerobot", "with other formats: LeRobot data sets need a new folder", "force")
    check_fits(context, to != "xirl", "with other formats: XIRL has pictures of its own", "preset")
    demos = read_chosen(paths, tasks, variants, which)
    if preset is None:
        preset = "State" if to == "minari" else "LoRes4E"
    groups: dict[str, list[Demonstration]] = defaultdict(list)
    for demo in demos:
        groups[demo.name].append(demo)
    if to in ("npz", "xirl"):  # these can hold several environments
        groups = {next(iter(groups)) if len(groups) == 1 else "demonstrations": demos}
    if suffix := set_suffix(set_named(which)):
        groups = {f"{name}{suffix}": group for name, group in groups.items()}
    if out is not None and len(groups) > 1:
        raise typer.BadParameter(
            f"a data set holds one environment, but these demonstrations are of {', '.join(groups)}: leave out --out."
        )
    targets = {
        name: out or default_target(to, name, group, preset, fingers=fingers, tag=_tag(to, paths, group))
        for name, group in groups.items()
    }
    sources = sources_of(paths, tasks, variants) if paths else ()
    folders = {source.resolve().parent for source in sources if isinstance(source, Path)}
    for target in targets.values():  # all, before the first one is made
        check_target(to, target, folders, force)
    for name, target in targets.items():
        options = {"drop_noop": drop_noop, "video": video, "fingers": fingers, "overwrite": force}
        make_data_set(to, groups[name], target, preset, **options)
        console().print(target, soft_wrap=True)
        if to == "minari":
            console().print(f"in {dataset_path(target)}; to load it: minari.load_dataset({target!r})", soft_wrap=True)


def _tag(to: str, paths: Paths, demos: list[Demonstration]) -> str:
    """The tag of a data set of recordings in Minari's folder, where all data sets of this user are."""
    from magical_mj.exports.formats import digest_tag

    return digest_tag(demos) if paths and to == "minari" else ""


def check_target(to: str, target: str, sources: set[Path], force: bool) -> None:
    """Raises an error unless a data set can be made at `target`. `sources` are the folders of its demonstrations."""
    from magical_mj.exports.formats import SUFFIXES
    from magical_mj.exports.lerobot import require_lerobot
    from magical_mj.exports.minari import dataset_path

    if to in SUFFIXES:
        path = Path(target)
        check_suffix(path, SUFFIXES[to])
        if to == "npz" and path.resolve().parent in sources:
            raise typer.BadParameter(
                f"{path} would be in the folder of the demonstrations; give --out in another folder."
            )
        check_writable(path, force)
        return
    path = dataset_path(target) if to == "minari" else Path(target)
    if path.exists() and not force:
        other = "another id, or replace it with --force" if to == "minari" else "a new folder"
        raise FileExistsError(f"the data set {path} exists already; give {other}")
    make_writable_folder(path.parent)
    if to == "lerobot":
        require_lerobot()
