"""The command line in shells that differ: completion, pipes, narrow terminals, other encodings, missing packages."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from magical_mj.cli import main
from magical_mj.tasks.registry import ENVIRONMENTS
from tests.helpers.commands import COMMANDS, process


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("view Fi", ["FindDupe", "FixColour"]),
        ("rollout FindDupe Co", ["Colour", "CountPlus"]),
        ("evaluate --tasks FindDupe,ClusterS", ["FindDupe,ClusterShape"]),
        ("demos info --variants Demo,Dy", ["Demo,Dynamics"]),
        ("demos ve", ["verify"]),
    ],
)
def test_the_shell_completes(line: str, offered: list[str]) -> None:
    words = f"magical-mj {line}"
    asked = {"_MAGICAL_MJ_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(words.count(" "))}
    script = Path(sys.executable).with_name("magical-mj")
    result = subprocess.run([script], env=os.environ | asked, capture_output=True, text=True, check=False)
    assert sorted(result.stdout.split()) == sorted(offered)


@pytest.mark.parametrize("command", COMMANDS)
def test_wrong_options_are_one_line_that_names_the_commands_own_help(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), "--no-such-option"]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert error.count("\n") == 1
    assert f"; see magical-mj {command} --help" in error


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize("columns", ["20", "300"])
def test_help_fits_any_terminal(
    command: str, columns: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", columns)
    assert main([*command.split(), "--help"]) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= int(columns)


def test_demos_alone_prints_its_commands(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["demos"]) == 0
    assert "verify" in capsys.readouterr().out


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_terminals_that_cannot_show_every_sign(encoding: str) -> None:
    for command in (("demos", "info", "--tasks", "MoveToRegion"), ("evaluate", "--help"), ("view", "Größe")):
        result = subprocess.run(
            [sys.executable, "-m", "magical_mj", *command],
            env=os.environ | {"PYTHONIOENCODING": encoding},
            capture_output=True,
            check=False,
        )
        assert b"Traceback" not in result.stderr
        assert result.returncode == (2 if "Größe" in command else 0)


@pytest.mark.parametrize("command", ["list", "demos info --tasks MoveToRegion"])
def test_a_reader_that_has_seen_enough_is_no_error(command: str) -> None:
    command = f"'{sys.executable}' -m magical_mj {command} | true; exit ${{PIPESTATUS[0]}}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stderr) == (0, "")


def test_work_goes_on_when_nobody_reads_its_output(tmp_path: Path) -> None:
    """It is done as it would be otherwise, and its exit code says how it went."""
    (tmp_path / "bad.npz").write_bytes(b"no demonstration")
    commands = "rollout MoveToRegion --video v.mp4 --size 32", "demos verify bad.npz"
    for command, code in zip(commands, (0, 1), strict=True):
        line = f"'{sys.executable}' -m magical_mj {command} 2>&1 | true; exit ${{PIPESTATUS[0]}}"
        assert subprocess.run(["bash", "-c", line], cwd=tmp_path, capture_output=True, check=False).returncode == code
    assert (tmp_path / "v.mp4").stat().st_size > 1000


@pytest.mark.parametrize(
    ("limit", "command", "hint"),
    [
        (1_500_000, "demos generate --out d --variants all --count 1000000", "the memory is not enough: ask for fewer"),
        (
            3_000_000,
            "rollout FindDupe --policy still:act --preset State --episodes 1000000000",
            "less than or equal to 1000000",
        ),
        (
            3_000_000,
            "evaluate --out o --policy still:act --preset State --jobs 1 --envs 1000000",
            "Could not allocate memory",
        ),
    ],
)
def test_too_much_for_the_memory_is_one_line(limit: int, command: str, hint: str, tmp_path: Path) -> None:
    (tmp_path / "still.py").write_text("def act(observation):\n    return 0\n")
    limited = f"ulimit -v {limit}; exec '{sys.executable}' -m magical_mj {command}"
    result = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode in (1, 2)
    assert hint in result.stderr
    assert result.stderr.count("\n") == 1


def test_ctrl_c_while_modules_are_loaded_is_no_traceback() -> None:
    """A module that every command needs is interrupted where it begins."""
    code = (
        "import builtins, sys; known = builtins.__import__\n"
        "def interrupted(name, *rest):\n"
        "    if name == 'typer': raise KeyboardInterrupt\n"
        "    return known(name, *rest)\n"
        "builtins.__import__ = interrupted\n"
        "from magical_mj.cli import main; sys.exit(main(['list']))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (result.returncode, result.stdout, result.stderr) == (130, "", "")


def test_the_table_of_demonstrations_fits_a_terminal(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 80 columns, without shortening the environments' names."""
    monkeypatch.setattr("magical_mj.cli.console.PLAIN_WIDTH", 80)
    assert main(["demos", "info"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("ClusterColour-Demo ") for line in lines)


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
    assert len(result.stdout.splitlines()) == 1 + len(ENVIRONMENTS)
    told = result.stderr
    assert "the task 'FindDupe' (broken:SPEC) is ignored: another task has that name" in told
    assert "the task 'Push Out' (broken:SPEC) is ignored: the name of a task must be made of letters" in told
    assert "the task 'NoObject' (broken) is ignored: announce an object in a module" in told
    assert "the task 'Broken' cannot be imported: ValueError: [broken]" in told.splitlines()[-1]


def test_without_a_home(tmp_path: Path) -> None:
    hidden = {name: value for name, value in os.environ.items() if name not in ("HOME", "XDG_CONFIG_HOME")}
    for command in (("list",), ("view", "FindDupe", "--size", "32"), ("rollout", "MoveToRegion")):
        call = [sys.executable, "-m", "magical_mj", *command]
        result = subprocess.run(call, env=hidden, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert (result.returncode, result.stderr) == (0, "")


@pytest.mark.parametrize("command", ["doctor", "rollout MoveToRegion", "demos info"])
def test_without_dm_control_it_says_what_to_install(command: str) -> None:
    """As under Python 3.13, where pip cannot install it without being told how."""
    code = (
        "import sys, importlib.metadata as m; sys.modules['dm_control'] = None; known = m.version\n"
        "def version(name):\n"
        "    if name == 'dm_control': raise m.PackageNotFoundError(name)\n"
        "    return known(name)\n"
        "m.version = version\n"
        "from magical_mj.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    result = subprocess.run([sys.executable, "-c", code, *command.split()], capture_output=True, text=True, check=False)
    said = " ".join((result.stdout + result.stderr).split())
    assert result.returncode == 1
    assert "pip install --no-deps dm_control" in said
    assert "Traceback" not in said
