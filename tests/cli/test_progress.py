"""Progress where the output is a file or a pipe: plain lines, about one a minute."""

from __future__ import annotations

import io

import pytest
from rich.console import Console
from rich.progress import MofNCompleteColumn

from magical_mj.cli.console import Bars


def short_repr(total: int | None, terminal: bool) -> list[str]:
    """The lines that are printed while 20 results arrive, one every seven seconds."""
    seconds, written = 0.0, io.StringIO()
    screen = Console(file=written, force_terminal=terminal)
    with Bars(screen, MofNCompleteColumn(), auto_refresh=False, transient=True, get_time=lambda: seconds) as progress:
        bar = progress.add_task("[files]", total=total)
        for _ in range(20):
            seconds += 7
            progress.update(bar, advance=1)
    return [line for line in written.getvalue().splitlines() if line.startswith("[files]")]


@pytest.mark.parametrize(("terminal", "kind"), [(False, "xterm"), (True, "dumb")])
def test_a_line_after_some_seconds_then_one_a_minute(
    terminal: bool, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In files and pipes, and on terminals that cannot move the cursor."""
    monkeypatch.setenv("TERM", kind)
    assert short_repr(20, terminal) == [
        "[files]  2/20 0:02:06 left",  # after 14 s
        "[files] 11/20 0:01:03 left",  # after 77 s
        "[files] 20/20 0:00:00 left",  # after 140 s
    ]


def test_the_amount_may_be_unknown() -> None:
    assert short_repr(None, terminal=False)[0] == "[files] 2/?"


def test_terminals_show_the_bar_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    assert short_repr(20, terminal=True) == []


def test_no_bar_is_shown_of_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the work is known, something may be refused; from then on there is a bar."""
    monkeypatch.setenv("TERM", "xterm")
    written = io.StringIO()
    screen = Console(file=written, force_terminal=True)
    with Bars(screen, MofNCompleteColumn(), auto_refresh=False, transient=True) as progress:
        bar = progress.add_task("files", total=0)
        progress.refresh()
        assert "files" not in written.getvalue()
        progress.update(bar, total=2)
        progress.refresh()
        assert "files" in written.getvalue()
        assert "0/2" in written.getvalue()
