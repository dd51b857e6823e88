"""Output of the command line, such as progress bars, and checks of the arguments of subcommands."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
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

PLAIN_WIDTH: Final = 120  # columns of output to files and pipes
LABEL: Final = TextColumn("{task.description}", markup=False)  # the first column of progress bars
FIRST: Final = 10.0  # seconds until the first progress line, if bars cannot be shown
MINUTE: Final = 60.0  # seconds between two such lines


def check_fits(context: typer.Context, fits: bool, condition: str, *options: str) -> None:
    """Raise `BadParameter` if one of these `options` of a command was given, but they have no effect (`fits`).

    `condition` says when they have one, such as "in a window".
    """
    for name in options:
        source = context.get_parameter_source(name)
        if not fits and source is not None and source.name == "COMMANDLINE":
            (flag,) = [option.opts[0] for option in context.command.params if option.name == name]
            raise typer.BadParameter(f"{flag} has an effect only {condition}.")


class Output(Console):
    """A console that stops printing when the reader of its output has gone. The command continues to its end.

    Control characters in its output, such as in names from other people's files, are escaped.
    """

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Escapes all output, since all of it passes through this method. In narrow terminals, tables are folded."""
        if isinstance(renderable, Table):
            for column in renderable.columns:
                column.overflow = "fold"
        for segment in super().render(renderable, options):
            yield segment if segment.control else segment._replace(text=terminal(segment.text))

    def on_broken_pipe(self) -> None:
        """Discards all further output. Rich itself would end the process."""
        silence(self.file)


@contextmanager
def how_to_continue(screen: Console, how: str) -> Iterator[None]:
    """A context that prints `how` to continue after Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        screen.print(f"stopped; {how}")
        raise


def silence(stream: IO[str]) -> None:
    """Discards all further output to a stream that nobody reads any more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def console() -> Console:
    """Standard output: in colour on a terminal, otherwise plain and wide enough for the tables.

    Rich's markup is off, since names, paths and error messages may contain square brackets.
    """
    out = Output(highlight=False, markup=False)
    if not out.is_terminal:
        out.width = PLAIN_WIDTH
    return out


def complain(message: str) -> None:
    """Prints a message on standard error. Several lines all begin at the left, since one may mark a place above."""
    lines = [terminal(line.rstrip()) for line in message.strip("\n").splitlines()]
    try:
        typer.echo(
            "\n".join(["magical-mj:", *lines] if len(lines) > 1 else [f"magical-mj: {' '.join(lines)}"]), err=True
        )
    except BrokenPipeError:
        silence(sys.stderr)


def file_name(task: str, variant: str, seed: int, suffix: str) -> str:
    """The default name of the file for one scene."""
    return f"{task_spec(task).name}-{variant_name(variant)}-{seed}{suffix}"


def check_suffix(path: Path | None, suffix: str) -> None:
    """Raise `BadParameter` if a path is given but does not end in `suffix`."""
    if path is not None and path.suffix.lower() != suffix:
        raise typer.BadParameter(f"{path} must end in {suffix}.")


def output_path(out: Path | None, name: str) -> Path:
    """The file of an option "--out": one with the suffix of `name`, or `name` in a folder, by default the current."""
    if out is None or out.is_dir() or not out.suffix:
        return (out or Path()) / name
    check_suffix(out, Path(name).suffix)
    return out


def check_writable(path: Path, force: bool) -> Path:
    """Returns `path`, or raises an OSError if no file can be written there, or one exists but `force` is false."""
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give the name of a file")
    if path.exists() and not force:
        raise FileExistsError(f"{path} exists already; --force replaces it")
    make_writable_folder(path.parent)
    return path


def make_writable_folder(folder: Path) -> Path:
    """Makes a folder if it is missing, and returns it. Raises an OSError if files cannot be written in it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise OSError(f"cannot write into {folder}: {error.strerror}") from error


class Left(TimeRemainingColumn):
    """The remaining time, marked "left" to distinguish it from the elapsed time."""

    def render(self, task: Work) -> Text:
        """The time as text. Empty if it is unknown or too large."""
        with suppress(OverflowError):
            if left := super().render(task):
                return left.append(" left")
        return Text()


class Bars(Progress):
    """Progress bars. If bars cannot be shown, it prints a line after some seconds, then one per minute.

    The columns are between the bar and the remaining time. The settings are those of rich's `Progress`.
    """

    def __init__(self, screen: Console, *columns: ProgressColumn, **settings: Any) -> None:
        left = Left(table_column=Column(no_wrap=True))
        super().__init__(LABEL, BarColumn(), *columns, left, console=screen, **settings)
        self._in_lines = LABEL, *columns, left
        self._next_line = self.get_time() + FIRST

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Removes the bars before an expected error, so that only its line remains."""
        self.live.transient |= isinstance(error, MagicalError)
        super().__exit__(kind, error, trace)

    def stop(self) -> None:
        """Ends the bars as rich does, but writes no empty line to a file or a pipe after bars that disappear."""
        (self.live if self.live.transient else super()).stop()

    def make_tasks_table(self, tasks: Iterable[Work]) -> Table:
        """The table of the bars that have work, so that a command that is refused shows none."""
        return super().make_tasks_table([task for task in tasks if task.total != 0])

    def update(self, task_id: TaskID, **changes: Any) -> None:
        """Updates the bar, and prints a line if bars cannot be shown and a line is due."""
        super().update(task_id, **changes)
        if not self.console.is_interactive and self.get_time() >= self._next_line:
            self._next_line = self.get_time() + MINUTE
            (task,) = [task for task in self.tasks if task.id == task_id]
            self.console.print(*filter(None, (column(task) for column in self._in_lines)), soft_wrap=True)


def with_bar(screen: Console, label: str, results: Iterable[Result], total: int) -> Iterator[Result]:
    """The results as they arrive, with a progress bar that counts them and disappears at the end."""
    with Bars(screen, MofNCompleteColumn(), transient=True) as progress:
        bar = progress.add_task(label, total=total)
        for result in results:
            yield result
            progress.update(bar, advance=1)


@contextmanager
def counting(screen: Console, label: str) -> Iterator[Callable[[int, int], None]]:
    """A context with a progress bar, and a function that takes the numbers of finished items and of all."""
    with Bars(screen, MofNCompleteColumn(), transient=True) as progress:
        bar = progress.add_task(label, total=0)
        yield lambda done, number: progress.update(bar, completed=done, total=number)
