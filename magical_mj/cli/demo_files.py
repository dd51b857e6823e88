"""The files of demonstrations that subcommands of `magical-mj demos` are given."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import magical_mj
from magical_mj.tasks.registry import Pair, environments
from magical_mj.utils.errors import DemonstrationError, UntrustedNameError

if TYPE_CHECKING:  # imported late: it loads the simulator, which help does not need
    from magical_mj.demos import Demonstration

Paths = Annotated[
    list[Path] | None,
    typer.Argument(help="Files and folders.", show_default="those that come with the tasks"),
]


def files_of(paths: Sequence[Path] | None, tasks: str, variants: str) -> list[Path]:
    """The files, each once, even if it is given in several ways; by default those that come with the tasks."""
    pairs = environments(tasks, variants)
    if not paths:
        return [path for task in dict.fromkeys(task for task, _ in pairs) for path in magical_mj.demos.paths_of(task)]
    found: dict[Path, Path] = {}
    for path in paths:
        if path.is_dir():
            inside = magical_mj.demos.files_in_or_below(path)
            if not inside:
                raise DemonstrationError(f"there are no demonstrations in {path}")
            found |= {file.resolve(): file for file in inside}
        elif path.exists():
            found[path.resolve()] = path
        else:
            raise DemonstrationError(
                f"there is no {path}; for those of a task that come with the package: --tasks TASK"
            )
    return list(found.values())


def read_chosen(paths: Sequence[Path] | None, tasks: str, variants: str) -> list[Demonstration]:
    """The demonstrations of these tasks and variants in files and folders, by default those that come with tasks."""
    wanted = asked_for(tasks, variants)
    found = [read_asked(path, wanted) for path in files_of(paths, tasks, variants)]
    chosen = [demo for demo in found if not isinstance(demo, str)]
    if not chosen:
        others = sorted({name for name in found if isinstance(name, str)})
        raise DemonstrationError(f"there are none of these tasks and variants; there are {', '.join(others)}")
    return chosen


def asked_for(tasks: str, variants: str) -> list[Pair] | None:
    """The environments that were asked for; None if none was in particular."""
    return None if (tasks, variants) == ("all", "all") else environments(tasks, variants)


def read_asked(path: Path, wanted: Collection[Pair] | None) -> Demonstration | str:
    """The demonstration in a file; the name of its environment or task if others were asked for.

    Args:
        path: the file.
        wanted: as `asked_for` returns it; only the code of these tasks may run.

    Raises:
        DemonstrationError: if the file is damaged.
        UntrustedNameError: if reading it runs the code of a task, and nothing in particular was asked for.
    """
    try:
        demo = magical_mj.demos.read(path, trusted=[task for task, _ in wanted or ()])
    except UntrustedNameError as error:
        if wanted is None:
            raise
        return error.reference
    return demo if wanted is None or (demo.task, demo.variant) in wanted else demo.name
