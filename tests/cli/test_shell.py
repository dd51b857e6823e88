"""The command line in different shells: completion, pipes, terminals, encodings, signals, plug-ins, progress."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import MofNCompleteColumn

from magical_mj.cli import main
from magical_mj.cli.console import Bars
from magical_mj.tasks.registry import ENVIRONMENTS, task_spec
from tests.helpers.commands import Shell, process
from tests.helpers.commands import commands as all_commands


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("view Fi", ["FindDupe", "FixColour"]),
        ("rollout FindDupe Co", ["Colour", "CountPlus"]),
        ("evaluate --tasks FindDupe,ClusterS", ["FindDupe,ClusterShape"]),
        ("demos info --variants Demo,Dy", ["Demo,Dynamics"]),
        ("demos ve", ["verify"]),
        ("do", ["doctor"]),
    ],
)
def test_the_shell_completes(line: str, offered: list[str], shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    words = f"magical-mj {line}"
    asked = {"_MAGICAL_MJ_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    for name, value in asked.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SystemExit):
        main([])
    assert shell.capture.readouterr().out.split() == offered


def test_wrong_options_are_one_line_that_names_the_commands_own_help(shell: Shell) -> None:
    for command in all_commands():
        assert f"; see magical-mj {command} --help" in shell.fails(2, *command.split(), "--no-such-option")


def test_help_fits_a_narrow_terminal(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    for command in all_commands():
        code, out, _ = shell(*command.split(), "--help")
        assert code == 0
        assert max(map(len, out.splitlines())) <= 40


@pytest.mark.parametrize(("columns", "most"), [(40, 6), (300, 32)])
def test_help_can_be_read(columns: int, most: int, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a second column, it has at least 40 columns. On narrow terminals, it is below the options."""
    monkeypatch.setenv("COLUMNS", str(columns))
    _, out, _ = shell("evaluate", "--help")
    (row,) = (line for line in out.splitlines() if "Continue the evaluation in OUT." in line)
    assert row.index("Continue") <= most
    assert max(map(len, out.splitlines())) <= columns


def test_terminals_that_cannot_show_every_sign(monkeypatch: pytest.MonkeyPatch) -> None:
    for command, code in ((("demos", "info", "--tasks", "MoveToRegion"), 0), (("view", "Größe"), 2)):
        for name in ("stdout", "stderr"):
            monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
        assert main(command) == code


def test_a_command_continues_when_its_output_is_closed(tmp_path: Path) -> None:
    """The work is done as usual, and the exit code reports its result."""
    (tmp_path / "bad.npz").write_bytes(b"no demonstration")
    commands = "rollout MoveToRegion --video v.mp4 --size 32", "demos verify bad.npz"
    for command, code in zip(commands, (0, 1), strict=True):
        line = f"'{sys.executable}' -m magical_mj {command} 2>&1 | true; exit ${{PIPESTATUS[0]}}"
        assert subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False).returncode == code
    assert (tmp_path / "v.mp4").stat().st_size > 1000


def test_too_much_for_the_memory_is_one_line(tmp_path: Path) -> None:
    command = "demos generate --out d --variants all --count 1000000"
    limited = f"ulimit -v 1100000; exec '{sys.executable}' -m magical_mj {command}"
    result = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode in (1, 2)
    assert "memory" in result.stderr
    assert result.stderr.count("\n") == 1


INTERRUPTED = "import os, signal, time; os.kill(os.getpid(), signal.SIGINT); time.sleep(60)"
AS_COMPILED = f"""
try:
    {INTERRUPTED}
except KeyboardInterrupt as error:
    raise ImportError("initialization failed") from error
"""
AT_THE_COMMAND_LINE = f"""
import sys
class Finder:
    def find_spec(self, name, *_):
        if name == "magical_mj.cli":
            {INTERRUPTED}
sys.meta_path.insert(0, Finder())
"""


@pytest.mark.parametrize(
    ("module", "code", "text"),
    [
        ("sitecustomize", 130, AT_THE_COMMAND_LINE),
        ("typer", -2, INTERRUPTED),
        ("rich", 130, INTERRUPTED),
        ("rich", 130, AS_COMPILED),
    ],
    ids=["the command line's own", "of all commands", "of this command", "compiled"],
)
def test_ctrl_c_while_modules_are_loaded_is_no_traceback(module: str, code: int, text: str, tmp_path: Path) -> None:
    """In the first module, in one that all commands import, in one that this command imports, and in a compiled one."""
    (tmp_path / f"{module}.py").write_text(text)
    result = process("list", PYTHONPATH=f"{tmp_path}:{Path(__file__).parents[2]}")
    assert (result.returncode, result.stdout, result.stderr) == (code, "", "")


def test_the_table_of_demonstrations_fits_a_terminal(shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """A terminal of 80 columns does not shorten the environments' names."""
    monkeypatch.setattr("magical_mj.cli.console.PLAIN_WIDTH", 80)
    code, out, _ = shell("demos", "info", "--tasks", "ClusterColour")
    assert code == 0
    assert max(map(len, out.splitlines())) <= 80
    assert any(line.startswith("ClusterColour-Demo ") for line in out.splitlines())


def test_broken_plug_ins_take_nothing_else_away(tmp_path: Path) -> None:
    """Tasks of other packages: in a module that cannot be imported, and with invalid names."""
    (tmp_path / "broken.py").write_text("raise ValueError('[broken]')")
    about = tmp_path / "broken-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: broken\nVersion: 1\n")
    tasks = "FindDupe = broken:SPEC\nPush Out = broken:SPEC\nNoObject = broken\nBroken = broken : SPEC\n"
    (about / "entry_points.txt").write_text(f"[magical_mj.tasks]\n{tasks}")
    result = process("list", PYTHONPATH=str(tmp_path))
    assert result.returncode == 0
    assert len(result.stdout.splitlines()) == 4 + len(ENVIRONMENTS) + len(task_spec("SweepToTop").variants)
    told = result.stderr
    assert "the task 'FindDupe' (broken:SPEC) is ignored: another task has this name" in told
    assert "the task 'Push Out' (broken:SPEC) is ignored: the name of a task must consist of letters" in told
    assert "the task 'NoObject' (broken) is ignored: it must refer to an object in a module" in told
    assert "the task 'Broken' cannot be imported: ValueError: [broken]" in told.splitlines()[-1]


def printed_lines(total: int | None, terminal: bool) -> list[str]:
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
    assert printed_lines(20, terminal) == [
        "[files]  2/20 0:02:06 left",  # after 14 s
        "[files] 11/20 0:01:03 left",  # after 77 s
        "[files] 20/20 0:00:00 left",  # after 140 s
    ]


def test_the_amount_may_be_unknown() -> None:
    assert printed_lines(None, terminal=False)[0] == "[files] 2/?"


def test_terminals_show_the_bar_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    assert printed_lines(20, terminal=True) == []


def test_no_bar_is_shown_of_no_work(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command may be refused before its amount of work is known. Afterwards, there is a bar."""
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
