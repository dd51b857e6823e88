"""What the terminal shows of trainings and experiments: progress bars, and a line per evaluation."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from rich.console import Console
from rich.progress import ProgressColumn, Task, TimeElapsedColumn
from rich.table import Column
from rich.text import Text

from magical_mj.cli.progress import Bars
from magical_mj.utils.errors import MagicalError

if TYPE_CHECKING:
    from magical_mj.learners import Progress

DAY: Final = 86400.0
"""Seconds over which speeds are averaged, or over the last thousand updates: a run of an experiment may take hours."""
PAUSE: Final = 10.0
"""Seconds between two looks at what other processes have done."""


def bars(screen: Console) -> Bars:
    """Progress bars of trainings; or of an experiment, which counts runs."""
    rate = Rate(Column(no_wrap=True, overflow="ellipsis"))
    return Bars(screen, rate, TimeElapsedColumn(Column(no_wrap=True)), speed_estimate_period=DAY)


@contextmanager
def how_to_continue(screen: Console, how: str) -> Iterator[None]:
    """A context in which Ctrl-C says how to continue."""
    try:
        yield
    except KeyboardInterrupt:
        screen.print(f"stopped; {how}")
        raise


@contextmanager
def repeating(look: Callable[[], None]) -> Iterator[None]:
    """A context in which a thread calls a function every few seconds; what it cannot read is left out."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(PAUSE):
            with suppress(OSError, MagicalError):
                look()

    thread = threading.Thread(target=repeat, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


class Rate(ProgressColumn):
    """Finished updates of the total, updates per second, and the latest metrics; or finished runs."""

    def render(self, task: Task) -> Text:
        """As text."""
        done = f"{task.completed}/{task.total or 0} {task.fields['unit']}"
        speed = f", {task.speed:.2f}/s" if task.speed and task.fields["unit"] == "updates" else ""
        return Text(f"{done}{speed} {task.fields['latest']}".rstrip())


class Watch:
    """Shows a training: a progress bar with the latest metrics, and a line per evaluation.

    Attributes:
        bar: the number of its progress bar.
    """

    def __init__(self, progress: Bars, name: str) -> None:
        self._progress, self._name = progress, name
        self.bar = progress.add_task(name, total=None, unit="updates", latest="")

    def __call__(self, trained: Progress) -> None:
        """Called after each update."""
        shown = "  ".join(f"{name} {value:.3g}" for name, value in trained.metrics.items())
        latest = {"latest": shown} if shown else {}  # metrics come with some updates only
        self._progress.update(self.bar, completed=trained.update, total=trained.updates, **latest)
        if trained.scores:
            scores = ", ".join(f"{task} {score:.2f}" for task, score in trained.scores.items())
            line = f"{self._name}: after {trained.update} updates: mean score on Demo: {scores}"
            self._progress.console.print(line, soft_wrap=True)
