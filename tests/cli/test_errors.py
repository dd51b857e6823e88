"""The command line prints one clear line for every expected error. Exit code 2 for wrong use, 1 for failures."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.helpers.commands import Shell, process


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("frobnicate", "No such command"),
        ("view", "give TASK"),
        ("view FindDupe --grid", "either TASK or --grid"),
        ("view FindDup", "Did you mean 'FindDupe'"),
        ("view FindDupe TestDemo", "Did you mean 'Demo'"),
        ("view MoveToCorner Layout", "It has: Demo, Jitter"),
        ("view FindDupe --seed -1", "--seed"),
        ("view FindDupe --out a.jpg", "must end in .png"),
        ("view FindDupe Demo extra", "extra"),
        ("rollout FindDupe --policy greedy", "unknown policy"),
        ("rollout FindDupe --policy gone.zip", "the file gone.zip does not exist"),
        ("rollout FindDupe --policy gone.pt", "the file gone.pt does not exist"),
        ("rollout FindDupe --policy BC=runs/gone", "the file or folder runs/gone does not exist"),
        ("view FindDupe --body stick", "unknown body 'stick'. Did you mean 'longstick'?"),
        ("evaluate --policy noop --tasks FindDupe --out s --body shortstik", "unknown body 'shortstik'. Did you mean"),
        ("rollout FindDupe --episodes 1000000000", "less than or equal to 1000000"),
        ("rollout FindDupe --video a.avi", "must end in .mp4"),
        ("rollout MoveToRegion CountPlus", "It has: Demo, Jitter"),
        ("export FindDupe --out a.png", "must end in .xml"),
        ("view magical_mj/FindDupe-TestAll-LoRes4E-v0", "its task is 'FindDupe' and its variant 'All'"),
        ("list FindDupe-Demo", "its task is 'FindDupe' and its variant 'Demo'"),
        ("view magical_mj/SweepToTop-Longstick-State-Allo-TestColor-v0", "'SweepToTop' and its variant 'Colour'"),
        ("evaluate --policy noop --tasks finddupe --out s", "Did you mean 'FindDupe'?"),
        ("train BC --tasks FindDupe --out run", "Did you mean 'bc'?"),
        ("evaluate --policy =noop --out scores", "name of a method"),
        ("serve findupe", "Did you mean 'FindDupe'"),
        ("serve --origin study.example.org", "such as https://"),
        ("collect out --origin https://study.example.org/page", "without a path"),
        ("view --grid --camera ego", "--camera"),
        ("rollout FindDupe --camera ego", "only with --video"),
        ("demos export --to npz --video", "only with --to lerobot"),
        ("demos export --to minari --no-drop-noop", "only with --to npz"),
        ("demos video --out a.mp4 --speed 1000", "--speed"),
    ],
)
def test_wrong_use(shell: Shell, line: str, hint: str, tmp_path: Path) -> None:
    assert hint.lower() in shell.fails(2, *line.split()).lower()
    assert list(tmp_path.iterdir()) == []


TASK = "from magical_mj.tasks.move_to_corner import SPEC as OURS\n"


@pytest.mark.parametrize(
    ("line", "meant"),
    [
        ("view push_to_wall", "push_to_wall:SPEC"),
        ("evaluate --policy noop --tasks push_to_wall.py --out s", "push_to_wall:SPEC"),
        ("view push_to_wall.py:SPEC", "push_to_wall:SPEC"),
        ("view push_to_wall:spec", "SPEC"),
        ("view FindDupe --shifts salt:3", "salt:Salt"),
        ("evaluate --policy noop --tasks FindDupe --shifts salt --out s", "salt:Salt"),
        ("view FindDupe --shifts salt:salt:3", "Salt"),
        ("evaluate --policy mine --tasks FindDupe --out s", "mine:MyPolicy"),
        ("rollout FindDupe --policy BC=mine.py", "mine:MyPolicy"),
    ],
)
def test_files_in_the_folder_are_meant(shell: Shell, line: str, meant: str) -> None:
    """Their code does not run, unless the command names the module."""
    fails = "1 / 0\n" if ":" in meant else ""
    Path("push_to_wall.py").write_text(f"{fails}from dataclasses import replace\n{TASK}SPEC = replace(OURS)\n")
    Path("salt.py").write_text(f"{fails}from magical_mj.shifts import Shift\n\nclass Salt(Shift):\n    name = 'salt'\n")
    Path("mine.py").write_text("1 / 0\nclass Network: ...\n\n\nclass MyPolicy: ...\n")
    assert f"Did you mean {meant!r}?" in shell.fails(2, *line.split())


@pytest.mark.parametrize(
    ("line", "refusal"),
    [
        ("demos export --to hdf5", "'--to': 'hdf5' is not one of 'npz', 'minari', 'lerobot', "),
        ("view FindDupe --renderer gl", "'--renderer': 'gl' is not one of 'opengl', 'software'; see "),
        ("evaluate --policy noop --out s --rules old", "'--rules': 'old' is not one of 'paper', 'released'; see "),
        ("experiment e.toml --out x --backend ray", "'--backend': 'ray' is not one of 'local', 'dask'; see "),
    ],
)
def test_a_value_error_of_the_parser_is_not_shown_as_one(shell: Shell, line: str, refusal: str) -> None:
    """Click puts "Value error, " before the choices, which does not help users. `Shell.fails` checks it as well."""
    assert shell.fails(2, *line.split()).startswith(f"magical-mj: Invalid value for {refusal}")


@pytest.mark.parametrize(
    "line",
    [
        "view FindDupe --out {}/a.png",
        "view --grid --out {}/a.png",
        "rollout FindDupe --video {}/a.mp4",
        "export FindDupe --out {}",
        "demo --out {}",
    ],
)
def test_an_unwritable_path_is_an_error_before_the_work(
    shell: Shell, line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_work(*_: object, **__: object) -> None:
        pytest.fail("the path was not checked first")

    for work in ("render", "step"):
        monkeypatch.setattr(f"magical_mj.engine.Engine.{work}", no_work)
    assert "cannot write into /dev/null/folder" in shell.fails(1, *line.format("/dev/null/folder").split())


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("view MoveToRegion --out a.png --size 16", "a.png"),
        ("rollout MoveToRegion --video a.mp4 --size 16", "a.mp4"),
        ("export MoveToRegion --out .", "MoveToRegion-Demo-0.xml"),
    ],
)
def test_nothing_is_overwritten_unless_forced(shell: Shell, line: str, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("precious")
    assert "--force" in shell.fails(1, *line.split())
    assert (tmp_path / name).read_text() == "precious"
    assert shell(*line.split(), "--force")[0] == 0
    assert (tmp_path / name).read_bytes() != b"precious"


@pytest.mark.parametrize("broken", ["raise ValueError('no [red] blocks')", "import sys; sys.exit(3)", "SPEC = ("])
def test_a_task_whose_module_fails_is_one_line(shell: Shell, broken: str, tmp_path: Path) -> None:
    name = f"broken_{abs(hash(broken))}"
    (tmp_path / f"{name}.py").write_text(broken)
    error = shell.fails(2, "view", f"{name}:SPEC")
    assert f"the task '{name}:SPEC' cannot be imported: " in error
    assert "line 1)" in error


def test_the_tour_replaces_only_what_it_has_made(shell: Shell, tmp_path: Path) -> None:
    """It replaces its own earlier run, but not other evaluations, which may have taken days."""
    few = ("--tasks", "MoveToRegion", "--episodes", 1, "--jobs", 1)
    assert shell("evaluate", "--policy", "expert,random,noop", "--preset", "State", "--out", "states", *few)[0] == 0
    assert "give another folder" in shell.fails(1, "demo", *few, "--out", "states")
    evaluate = ("evaluate", "--policy", "expert,random,noop", "--variants", "Demo", "--out", "mine")
    assert shell(*evaluate, *few)[0] == 0
    scores = (tmp_path / "mine" / "scores.jsonl").read_bytes()
    assert "give another folder" in shell.fails(1, "demo", *few, "--out", "mine")
    (tmp_path / "mine" / "environments.png").write_text("precious")
    assert "give another folder" in shell.fails(1, "demo", *few, "--out", "mine")
    assert (tmp_path / "mine" / "scores.jsonl").read_bytes() == scores


@pytest.mark.parametrize("name", ["report.md", "notes.txt", "scores.jsonl"])
def test_the_tour_keeps_out_of_folders_with_other_files(shell: Shell, name: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text("precious")
    error = shell.fails(1, "demo", "--tasks", "MoveToRegion", "--episodes", 1, "--jobs", 1, "--out", tmp_path)
    assert "holds files that this command did not make" in error
    assert (tmp_path / name).read_text() == "precious"
    assert len(list(tmp_path.iterdir())) == 1


def test_nothing_is_written_without_the_extra_for_videos(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    played = tmp_path / "noop"
    shell("evaluate", "--policy", "noop", "--tasks", "MoveToRegion", "--episodes", 1, "--jobs", 1, "--out", played)
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    for command in (("report", played, "--videos"), ("demo", "--out", tmp_path / "tour")):
        assert '[video]"' in shell.fails(1, *command)
    assert sorted(tmp_path.rglob("*")) == before


def test_an_export_that_cannot_be_finished_is_not_begun(shell: Shell, tmp_path: Path) -> None:
    taken = tmp_path / "FixColour-Demo-ego.hdf5"
    taken.write_text("precious")
    command = ("demos", "export", "--tasks", "MoveToRegion,FixColour", "--to", "robomimic")
    assert "FixColour-Demo-ego.hdf5 exists already" in shell.fails(1, *command)
    assert [path.name for path in tmp_path.iterdir()] == [taken.name]


@pytest.mark.parametrize("backend", ["glfw", "mesa"])
def test_no_opengl_is_one_line(backend: str, tmp_path: Path) -> None:
    """Backends that do not work: GLFW without a display, and an unknown one."""
    variables = {
        "MUJOCO_GL": backend,
        "DISPLAY": "",
        "WAYLAND_DISPLAY": "",
        "PYOPENGL_PLATFORM": "",
        "MAGICAL_MJ_RENDERER": "opengl",
    }
    result = process("view", "FindDupe", "--out", str(tmp_path / "a.png"), **variables)
    assert result.returncode == 1
    assert "MUJOCO_GL" in result.stderr
    assert result.stderr.count("\n") == 1


def test_mujoco_may_be_imported_first(tmp_path: Path) -> None:
    out = str(tmp_path / "a.png")
    code = f"import mujoco, sys, magical_mj.cli as cli; sys.exit(cli.main(['view', 'FindDupe', '--out', {out!r}]))"
    variables = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    result = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
