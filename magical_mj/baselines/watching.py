"""What the terminal shows of trainings and experiments: progress bars, or a line per minute where there are none."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Column
from rich.text import Text

from magical_mj.cli.progress import LABEL, MINUTE
from magical_mj.errors import MagicalError

if TYPE_CHECKING:
    from magical_mj.baselines import Progress as Trained


def bars(screen: Console, period: float) -> Progress:
    """Progress bars; the speed is averaged over so many seconds."""
    rate = Rate(Column(no_wrap=True, overflow="ellipsis"))
    columns = LABEL, BarColumn(), rate, TimeElapsedColumn(), TimeRemainingColumn()
    return Progress(*columns, console=screen, speed_estimate_period=period)


@contextmanager
def how_to_continue(screen: Console, how: str) -> Iterator[None]:
    """A context in which Ctrl-C says how to continue."""
    try:
        yield
    except KeyboardInterrupt:
        screen.print(f"stopped; {how}")
        raise


@contextmanager
def each_minute(tell: Callable[[], None]) -> Iterator[None]:
    """A context in which a thread calls a function each minute; what it cannot read is left out."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(MINUTE):
            with suppress(OSError, MagicalError):
                tell()

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
        done = f"{task.completed:.0f}/{task.total or 0:.0f} {task.fields['unit']}"
        speed = f", {task.speed:.1f}/s" if task.speed and task.fields["unit"] == "updates" else ""
        return Text(f"{done}{speed} {task.fields['latest']}")


class Watch:
    """Shows a training: a progress bar with the latest metrics, or a line per minute; and a line per evaluation.

    Attributes:
        bar: the number of its progress bar.
    """

    def __init__(self, screen: Console, progress: Progress, name: str) -> None:
        self._screen, self._progress, self._name = screen, progress, name
        self.bar = progress.add_task(name, total=None, unit="updates", latest="")
        self._started = self._told = time.monotonic()
        self._updates, self._metrics = 0, ""

    def __call__(self, trained: Trained) -> None:
        """Called after each update."""
        self._updates += 1
        self._progress.update(self.bar, completed=trained.update, total=trained.updates)
        if trained.metrics:
            shown = "  ".join(f"{name} {value:.3g}" for name, value in trained.metrics.items())
            self._progress.update(self.bar, latest=shown)
            self._metrics = shown
        if not self._screen.is_terminal and time.monotonic() - self._told >= MINUTE:
            self._tell(trained)
        if trained.scores:
            shown = ", ".join(f"{task} {score:.2f}" for task, score in trained.scores.items())
            self._say(f"after {trained.update} updates: mean score on Demo: {shown}")

    def _tell(self, trained: Trained) -> None:
        self._told = time.monotonic()
        rate = self._updates / (self._told - self._started)
        more = trained.updates - trained.update
        left = timedelta(seconds=round(more / rate)) if more < rate * timedelta.max.total_seconds() else "?"
        done = f"{trained.update}/{trained.updates} updates, {rate:.2g}/s, {left} left"
        self._say(f"{done}  {self._metrics}")

    def _say(self, line: str) -> None:
        self._screen.print(f"{self._name}: {line}", soft_wrap=True)
