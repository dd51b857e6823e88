"""All commands under adverse conditions, such as a full disk, and the doctor's report about them."""

from __future__ import annotations

import json
import os
import re
import resource
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from ctypes.util import find_library
from pathlib import Path

import mujoco
import pytest

from magical_mj.cli.doctor import OWN, optional
from magical_mj.evaluation.scores import read
from magical_mj.protocol import PROTOCOL
from tests.helpers.commands import Shell, process
from tests.helpers.commands import commands as all_commands

ROOT = Path(__file__).parents[2]
SHORT = ("--tasks", "MoveToRegion", "--variants", "Demo")
TINY = ("evaluations=0", "checkpoints=1", "demonstrations=2", "bc.batches=2", "bc.batch_size=4", "network.hidden=8")
SETS = [word for setting in TINY for word in ("--set", setting)]
COMMANDS = [
    ["list"],
    ["demos", "info", *SHORT],
    ["demos", "verify", *SHORT, "--jobs", "1"],
    ["demos", "generate", *SHORT, "--count", "1", "--jobs", "1", "--out", "{}/demos"],
    ["demos", "rollouts", *SHORT, "--steps", "1", "--preset", "State", "--jobs", "1", "--out", "{}/rollouts"],
    ["demos", "video", *SHORT, "--count", "1", "--size", "32", "--out", "{}/demos.mp4"],
    ["demos", "intents", "robot in()", "--per-intent", "1", "--jobs", "1", "--folder", "{}/intents"],
    ["demos", "questions", "say", "--scenes", "1", "--limit", "1", "--to", "{}/questions"],
    ["demos", "export", *SHORT, "--preset", "State", "--out", "{}/a.npz"],
    ["view", "MoveToRegion", "--size", "32", "--out", "{}/a/" + "two\nlines" + 237 * "x" + ".png"],
    ["export", "MoveToRegion", "--out", "{}/models"],
    ["rollout", "MoveToRegion", "--preset", "State", "--video", "{}/a.mp4", "--size", "32"],
    ["play", "MoveToRegion", "--size", "32", "--record", "{}/played"],
    ["evaluate", "--policy", "noop", *SHORT, "--episodes", "1", "--jobs", "2", "--preset", "State", "--out", "{}/s"],
    ["verify", "{}/s", "--jobs", "1"],  # the evaluation is incomplete
    ["report", "{}/s"],
    ["compare", "{}/s", "{}/s"],
    ["submit", "{}/s", "--out", "{}/e.json.xz"],
    ["leaderboard", "{}/e.json.xz", "--all", "--jobs", "1", "--out", "{}/board"],
    ["demo", "--tasks", "MoveToRegion", "--episodes", "1", "--jobs", "1", "--out", "{}/demo"],
    ["train", "bc", "--tasks", "MoveToRegion", "--preset", "State", "--device", "cpu", *SETS, "--out", "{}/run"],
    ["demos", "import", "{}/recording.json", "--out", "{}/imported"],
]
"""The commands, each of which writes below a folder {}."""
CODES = [int(command[0] == "verify") for command in COMMANDS]
RUN = """
import json, sys
sys.path.insert(0, {root!r})
from magical_mj.cli import main, play
play.Window.wish = lambda self: "quit"  # a player who opens the window and quits
print([main(command) for command in json.loads({commands!r})], file=sys.stderr)
"""
ONE_OF_MANY = r"1 (?:demonstration|entrie|environment|episode|file|run|scene|step|task|variant)s\b"
WITHOUT = ("XDG_CONFIG_HOME", "XDG_CACHE_HOME", "LANG")


def commands_in(folder: Path) -> list[list[str]]:
    folder.mkdir(parents=True)
    recording = {"format": 1, "protocol": PROTOCOL, "task": "MoveToRegion", "variant": "Demo", "seed": 0}
    (folder / "recording.json").write_text(json.dumps(recording | {"actions": [0] * 40}))
    return [[word.replace("{}", str(folder)) for word in command] for command in COMMANDS]


@pytest.mark.slow
def test_every_command_works(tmp_path: Path) -> None:
    """In a read-only folder, isolated, without HOME and TMPDIR, in the C locale, with unusual file names."""
    run = [f"{' '.join(command)} " for command in COMMANDS]
    missing = [name for name in all_commands() if not any(words.startswith(f"{name} ") for words in run)]
    # Four serve a page or open a window until they are interrupted; the others have tests below and in tests/learners.
    elsewhere = {"doctor", "evaluate-reward", "experiment", "export-policy"}
    assert set(missing) == {"serve", "collect", "guess", "inspect", *elsewhere}
    left = {name: value for name, value in os.environ.items() if name not in WITHOUT}
    folder = tmp_path / f"two\nlines{'x' * 237}.png"
    program = RUN.format(root=str(ROOT), commands=json.dumps(commands_in(folder)))
    result = subprocess.run(
        [sys.executable, "-I", "-c", program],
        cwd="/proc",
        env=left | {"HOME": "/dev/null/home", "TMPDIR": "/dev/null/tmp", "LC_ALL": "C", "SDL_VIDEODRIVER": "dummy"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stderr.splitlines()[-1:] == [str(CODES)], result.stderr
    assert not re.findall(rf"(?<![\d/.,]){ONE_OF_MANY}", result.stdout + result.stderr)


ODD = {
    "PYTHONWARNINGS": "error",
    "NUMBA_NUM_THREADS": "1",
    "MPLBACKEND": "module://matplotlib_of_another_python",
    "TERM": "dumb",
    "NO_COLOR": "1",
    "FORCE_COLOR": "1",  # as in a terminal
    "COLUMNS": "20",
    "LINES": "5",
}
"""Environment variables that a process may inherit from a notebook, a CI system or a window manager."""


@pytest.mark.slow
def test_inherited_variables_do_not_matter(tmp_path: Path) -> None:
    """Includes a missing backend of matplotlib. Long lines are folded, not cut off."""
    chosen = ("list", "view", "evaluate", "report")
    commands = [command for command in commands_in(tmp_path / "o") if command[0] in chosen or "info" in command]
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / "helpers.py").write_text("raise RuntimeError('another project')\n")
    result = subprocess.run(
        [sys.executable, "-c", RUN.format(root=str(ROOT), commands=json.dumps(commands))],
        env=os.environ | ODD | {"PYTHONPATH": str(tmp_path / "modules")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.stderr == f"{[0] * len(commands)}\n"
    assert "…" not in result.stdout
    assert (tmp_path / "o" / "s" / "report" / "bars.png").stat().st_size > 1000


MOST = 1500  # the largest size of a file in bytes, to simulate a full disk
STATE = ("--preset", "State")
TASK = ("--tasks", "MoveToRegion")
FILES = {  # command -> the file that the error names
    ("view", "FindDupe", "--out", "a.png"): "a.png",
    ("export", "FindDupe", "--out", "models"): "models/FindDupe-Demo-0.xml",
    ("rollout", "MoveToRegion", "--policy", "random", *STATE, "--video", "a.mp4", "--size", "64"): "a.mp4",
    ("demos", "video", *TASK, "--out", "a.mp4", "--size", "64"): "a.mp4",
    ("demos", "generate", *TASK, "--count", "1", "--out", "mine"): "mine/MoveToRegion-Demo-000.npz",
    ("demos", "export", *TASK, *STATE, "--out", "a.npz"): "a.npz",
    ("demos", "export", *TASK, "--to", "robomimic", *STATE, "--out", "a.hdf5"): "a.hdf5",
    ("evaluate", "--policy", "noop", *TASK, "--episodes", "3", "--out", "scores"): "scores/scores.jsonl",
}
MAY_STAY = ("scores.jsonl", "run.json", "config.toml", "metrics.csv", "events.*")
"""Files that are written line by line, or that were finished before."""


@contextmanager
def small_files() -> Iterator[None]:
    """Limits the size of all files of this process and its children."""
    before, handler = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (MOST, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)


@pytest.mark.parametrize(("command", "named"), FILES.items(), ids=[" ".join(words[:2]) for words in FILES])
def test_a_full_disk_is_one_line_that_names_the_file(
    command: tuple[str, ...], named: str, shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    with small_files():
        code, out, error = shell(*command)
    assert code == 1, out
    assert error.count("\n") == 1
    assert named in error
    left = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert [path.name for path in left if not any(path.match(pattern) for pattern in MAY_STAY)] == []
    if "evaluate" in command:
        assert len(read(tmp_path / "scores")) > 0  # the episodes that fitted


def test_a_training_on_a_full_disk_is_one_line_too(tmp_path: Path) -> None:
    """Runs in a separate process, because threads of TensorBoard's writer continue after an error."""
    command = f"'{sys.executable}' -m magical_mj train bc {' '.join((*TASK, *STATE))} --set bc.batches=200 --out run"
    limited = f"trap '' XFSZ; ulimit -f 2; PYTHONDONTWRITEBYTECODE=1 exec {command}"
    result = subprocess.run(["bash", "-c", limited], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "run/" in result.stderr
    left = [path.name for path in tmp_path.rglob("*") if path.is_file()]
    assert not {"policy.safetensors", "checkpoint.safetensors"} & set(left)


def test_doctor_says_what_draws_and_names_a_wrong_setting() -> None:
    result = process("doctor", DISPLAY="", MUJOCO_GL="glfw", MAGICAL_MJ_RENDERER="software")
    assert result.returncode == 1
    assert mujoco.__version__ in result.stdout
    assert "Flat views are drawn by software (MAGICAL_MJ_RENDERER is software); the fastest here: " in result.stdout
    assert "MUJOCO_GL=egl" in result.stdout
    assert "software renderer's first frame includes its compilation" in " ".join(result.stdout.split())


def test_every_extra_for_users_is_listed() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    packages = {
        re.split(r"[\[<>=;]", package)[0]: extra
        for extra, requirements in project["optional-dependencies"].items()
        if extra not in OWN
        for package in requirements
        if not package.startswith("magical-mj")
    }
    listed = optional()
    assert packages.keys() == listed.keys()
    assert (listed["torch"], listed["scipy"], listed["distributed"]) == ("il", "eval", "dask")


@pytest.mark.skipif(bool(find_library("OSMesa")), reason="OSMesa can draw without a driver")
def test_doctor_without_opengl_says_what_to_do() -> None:
    result = process("doctor", DISPLAY="", MUJOCO_GL="", __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent")
    assert result.returncode == 0
    assert "Flat views are drawn by software" in result.stdout
    assert "OpenGL does not work. The view `scene`" in result.stdout
    assert "libegl1" in result.stdout
    assert "MUJOCO_GL is 'osmesa'" in " ".join(result.stdout.split())


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_driver_that_hangs_ends_with_the_doctor_who_is_killed(tmp_path: Path) -> None:
    """The module simulates a driver that hangs: the probing process writes its number and waits."""
    number = tmp_path / "number"
    hangs = f"import os, pathlib, time; pathlib.Path({str(number)!r}).write_text(str(os.getpid())); time.sleep(600)"
    (tmp_path / "glfw.py").write_text(hangs)
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    doctor = subprocess.Popen([sys.executable, "-m", "magical_mj", "doctor"], env=os.environ | {"PYTHONPATH": paths})
    while not (number.exists() and number.read_text()):
        assert doctor.poll() is None
        time.sleep(0.1)
    doctor.kill()
    doctor.wait()
    driver, end = Path("/proc", number.read_text()), time.monotonic() + 60
    while driver.exists() and time.monotonic() < end:
        time.sleep(0.1)
    assert not driver.exists()
