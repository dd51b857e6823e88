"""The demonstrations that `magical-mj demos` reads: in files and folders, or those that come with the tasks."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

import magical_mj
from magical_mj.scene.bodies import GRIPPER
from magical_mj.tasks.registry import Pair, environments, task_spec
from magical_mj.utils.errors import DemonstrationError, UntrustedNameError

if TYPE_CHECKING:  # imported late: it loads the simulator, which help does not need
    from magical_mj.demos import Demonstration
    from magical_mj.demos.shipped import DemonstrationSet

Paths = Annotated[list[Path] | None, Argument(help="Files and folders.", show_default="those that come with the tasks")]
Set = Annotated[
    Literal["1", "2", "graded"],
    Option("--set", help="Of those that come with the tasks: 1, 2 (more varied) or graded (all scores)."),
]


def set_named(which: Set) -> DemonstrationSet:
    """The set with this name on the command line."""
    from magical_mj.demos.shipped import SETS

    return next(number for number in SETS if str(number) == which)


def sources_of(
    paths: Sequence[Path] | None, tasks: str, variants: str, which: Set = "1"
) -> Sequence[Path | Demonstration]:
    """The demonstration files without repetitions, even if a file has several paths. Default: the shipped ones."""
    pairs = environments(tasks, variants)
    if paths and which != "1":
        raise typer.BadParameter("--set chooses among those that come with the tasks: leave out the files.")
    if not paths:
        specs = {task: task_spec(task) for task, _ in pairs}
        bodies = {task: spec.bodies if spec.speeds else (GRIPPER,) for task, spec in specs.items()}
        number = set_named(which)
        shipped = [(task, body) for task in specs for body in bodies[task]]
        return [demo for task, body in shipped for demo in magical_mj.demos.load(task, body=body, set=number)]
    chosen: dict[Path, Path] = {}
    for path in paths:
        if path.is_dir():
            inside = magical_mj.demos.files_in(path)
            if not inside:
                raise DemonstrationError(f"{path} contains no demonstrations")
            chosen |= {file.resolve(): file for file in inside}
        elif path.exists():
            chosen[path.resolve()] = path
        else:
            raise DemonstrationError(
                f"{path} does not exist; for the demonstrations that come with a task: --tasks TASK"
            )
    return list(chosen.values())


def read_chosen(paths: Sequence[Path] | None, tasks: str, variants: str, which: Set = "1") -> list[Demonstration]:
    """The demonstrations of these tasks and variants in files and folders, or by default the shipped ones."""
    wanted = asked_for(tasks, variants)
    demos_and_names = [read_asked(source, wanted) for source in sources_of(paths, tasks, variants, which)]
    chosen = [demo for demo in demos_and_names if not isinstance(demo, str)]
    if not chosen:
        others = sorted({name for name in demos_and_names if isinstance(name, str)})
        raise DemonstrationError(f"no demonstrations of these tasks and variants; the files hold {', '.join(others)}")
    return chosen


def asked_for(tasks: str, variants: str) -> list[Pair] | None:
    """The requested environments. None if tasks and variants are both "all", so that nothing is filtered."""
    return None if (tasks, variants) == ("all", "all") else environments(tasks, variants)


def read_asked(source: Path | Demonstration, wanted: Collection[Pair] | None) -> Demonstration | str:
    """The demonstration, read if it is a file; if it is not wanted, the name of its environment or task instead.

    Only the code of the wanted tasks may run.
    """
    demo = source
    if isinstance(demo, Path):
        try:
            demo = magical_mj.demos.read(demo, trusted=[task for task, _ in wanted or ()])
        except UntrustedNameError as error:
            if wanted is None:
                raise
            return error.reference
    return demo if wanted is None or (demo.task, demo.variant) in wanted else demo.name
