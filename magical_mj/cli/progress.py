"""Progress bars; where the output is no terminal that could show them, plain lines instead."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, Final, TypeVar

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Column
from rich.text import Text

Result = TypeVar("Result")

LABEL: Final = TextColumn("{task.description}", markup=False)
"""The first column of progress bars."""
FIRST: Final = 10.0
"""Seconds until the first line where no bar can be shown."""
MINUTE: Final = 60.0
"""Seconds between two such lines."""


class Left(TimeRemainingColumn):
    """The time that is left, in words that are understood beside other times."""

    def render(self, task: Task) -> Text:
        """As text; empty if the amount of work is unknown, or as good as endless."""
        try:
            left = super().render(task)
        except OverflowError:
            return Text()
        return left.append(" left") if left else left


class Bars(Progress):
    """Progress bars, which `update` moves; where none can be shown, a line after some seconds, then one a minute.

    Args:
        screen: where they are shown.
        columns: what is shown between the bar and the time that is left.
        settings: of rich's `Progress`.
    """

    def __init__(self, screen: Console, *columns: ProgressColumn, **settings: Any) -> None:
        left = Left(table_column=Column(no_wrap=True))
        super().__init__(LABEL, BarColumn(), *columns, left, console=screen, **settings)
        self._in_lines = LABEL, *columns, left
        self._next_line = self.get_time() + FIRST

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
