"""Output of the command line, progress bars among it, and checks of what subcommands are given."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Final, TypeVar

import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.progress import Task as Work
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from magical_mj.tasks.registry import task_spec, variant_name
from magical_mj.utils.errors import MagicalError
from magical_mj.utils.escape import terminal

Result = TypeVar("Result")

PLAIN_WIDTH: Final = 120  # columns where the output is a file or a pipe
LABEL: Final = TextColumn("{task.description}", markup=False)  # the first column of progress bars
FIRST: Final = 10.0  # seconds until the first line where no bar can be shown
MINUTE: Final = 60.0  # seconds between two such lines


def check_fits(context: typer.Context, fits: bool, condition: str, *options: str) -> None:
    """Raise `BadParameter` if one of these options was given, by the names of their parameters, and has no effect.

    They have one only if `fits`, which `condition` says in words, such as "in a window".
    """
    for name in options:
        source = context.get_parameter_source(name)
        if not fits and source is not None and source.name == "COMMANDLINE":
            (flag,) = [option.opts[0] for option in context.command.params if option.name == name]
            raise typer.BadParameter(f"{flag} has an effect only {condition}.")


class Output(Console):
    """A console that goes quiet when the reader of its output is gone: the work behind it goes on to its end.

    Control characters in what it prints, such as names from other people's files, are shown and not obeyed.
    """

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """As rich's, through which everything passes that is printed. Narrow terminals fold tables, and cut nothing."""
        if isinstance(renderable, Table):
            for column in renderable.columns:
                column.overflow = "fold"
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=terminal(segment.text))

    def on_broken_pipe(self) -> None:
        """Send all further output nowhere; rich would end the process."""
        silence(self.file)


@contextmanager
def how_to_continue(screen: Console, how: str) -> Iterator[None]:
    """A context in which Ctrl-C says how to continue."""
    try:
        yield
    except KeyboardInterrupt:
        screen.print(f"stopped; {how}")
        raise


def silence(stream: IO[str]) -> None:
    """Sends what is written to a stream, whose reader is gone, nowhere."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def console() -> Console:
    """Standard output: in colour on a terminal; elsewhere plain and wide enough for the tables.

    Text is printed as it is: rich's markup is off, since names, paths and error messages may hold square brackets.
    """
    out = Output(highlight=False, markup=False)
    if not out.is_terminal:
        out.width = PLAIN_WIDTH
    return out


def complain(message: str) -> None:
    """One line on standard error."""
    try:
        typer.echo(f"magical-mj: {terminal(' '.join(message.split()))}", err=True)
    except BrokenPipeError:
        silence(sys.stderr)


def file_name(task: str, variant: str, seed: int, suffix: str) -> str:
    """The default name of a file about one scene."""
    return f"{task_spec(task).name}-{variant_name(variant)}-{seed}{suffix}"


def check_suffix(path: Path | None, suffix: str) -> None:
    """Raise `BadParameter` if a path is given that does not end in `suffix`."""
    if path is not None and path.suffix.lower() != suffix:
        raise typer.BadParameter(f"{path} must end in {suffix}.")


def check_writable(path: Path, force: bool) -> Path:
    """Returns `path` if a file can be written there, and none is replaced without `force`; before the work is done."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give the name of a file")
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists already; --force replaces it")
    make_writable_folder(path.parent)
    return path


def make_writable_folder(folder: Path) -> Path:
    """Returns `folder`, which is made if missing, if files can be written in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise OSError(f"cannot write into {folder}: {error.strerror}") from error


class Left(TimeRemainingColumn):
    """The time that is left, in words that are understood beside other times."""

    def render(self, task: Work) -> Text:
        """The time as text; empty if the amount of work is unknown, or as good as endless."""
        with suppress(OverflowError):
            if left := super().render(task):
                return left.append(" left")
        return Text()


class Bars(Progress):
    """Progress bars, which `update` moves; where none can be shown, a line after some seconds, then one a minute.

    The columns stand between the bar and the time that is left; the settings are those of rich's `Progress`.
    """

    def __init__(self, screen: Console, *columns: ProgressColumn, **settings: Any) -> None:
        left = Left(table_column=Column(no_wrap=True))
        super().__init__(LABEL, BarColumn(), *columns, left, console=screen, **settings)
        self._in_lines = LABEL, *columns, left
        self._next_line = self.get_time() + FIRST

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Take the bars away where an error follows: they would stand above its one line."""
        self.live.transient |= isinstance(error, MagicalError)
        super().__exit__(kind, error, trace)

    def make_tasks_table(self, tasks: Iterable[Work]) -> Table:
        """The bars, without those of no work or of work that is not known yet: a refusal may follow."""
        return super().make_tasks_table([task for task in tasks if task.total != 0])

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """As rich's, which moves the bar; prints a line if it is time for one."""
        super().update(task_id, **changes)
        if not self.console.is_interactive and self.get_time() >= self._next_line:
            self._next_line = self.get_time() + MINUTE
            (task,) = [task for task in self.tasks if task.id == task_id]
            self.console.print(*filter(None, (column(task) for column in self._in_lines)), soft_wrap=True)


def with_bar(screen: Console, label: str, results: Iterable[Result], total: int) -> Iterator[Result]:
    """The results as they arrive, with a progress bar that counts them, and vanishes at the end."""
    with Bars(screen, MofNCompleteColumn(), transient=True) as progress:
        bar = progress.add_task(label, total=total)
        for result in results:
            yield result
            progress.update(bar, advance=1)
