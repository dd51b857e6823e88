"""The command line: what it does, what it writes, and one clear line for everything that can go wrong."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from PIL import Image

import magical_mj
from magical_mj.cli import environments, main
from magical_mj.cli.film import Film, in_words
from magical_mj.errors import RenderingError
from magical_mj.evaluation.scores import read
from magical_mj.rendering.backend import osmesa_works

TOP = (
    "list",
    "view",
    "rollout",
    "evaluate",
    "report",
    "compare",
    "verify",
    "submit",
    "export",
    "bench",
    "doctor",
    "demo",
)


class Shell:
    """Runs `magical-mj` in this process and keeps what it printed."""

    def __init__(self, capture: pytest.CaptureFixture[str]) -> None:
        self.capture = capture

    def __call__(self, *arguments: object) -> tuple[int, str, str]:
        """Exit code, standard output and standard error."""
        code = main([str(argument) for argument in arguments])
        printed = self.capture.readouterr()
        return code, printed.out, printed.err

    def fails(self, code: int, *arguments: object) -> str:
        """The one line that the command complains with."""
        found, out, error = self(*arguments)
        assert (found, out) == (code, "")
        assert error.startswith("magical-mj: ")
        assert error.count("\n") == 1
        return error


@pytest.fixture
def shell(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Shell:
    monkeypatch.chdir(tmp_path)
    return Shell(capsys)


def process(*arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "magical_mj", *arguments]
    return subprocess.run(command, env=os.environ | variables, capture_output=True, text=True, check=False)


def opened(path: Path) -> Image.Image:
    with Image.open(path) as picture:
        return picture.convert("RGB")


# list, help, version


def test_list_shows_every_environment(shell: Shell) -> None:
    code, out, _ = shell("list")
    rows = [line.split() for line in out.splitlines()[1:]]
    assert code == 0
    assert [(row[0], row[1]) for row in rows] == list(magical_mj.ENVIRONMENTS)
    assert ["FindDupe", "Layout", "100", "layout"] in rows
    assert ["MoveToCorner", "Demo", "80", "nothing"] in rows


def test_list_ids(shell: Shell) -> None:
    _, out, _ = shell("list", "--ids")
    assert out.split() == [magical_mj.env_id(task, variant) for task, variant in magical_mj.ENVIRONMENTS]


def test_help_and_version(shell: Shell) -> None:
    for arguments in ((), ("--help",), ("-h",)):
        code, out, _ = shell(*arguments)
        assert code == 0
        assert all(name in out for name in TOP)
    for name in TOP:
        assert shell(name, "--help")[0] == 0
    assert shell("--version") == (0, f"magical-mj {magical_mj.__version__}\n", "")


def test_both_ways_to_start_it() -> None:
    script = Path(sys.executable).with_name("magical-mj")
    for command in ([str(script)], [sys.executable, "-m", "magical_mj"]):
        result = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
        assert result.stdout == f"magical-mj {magical_mj.__version__}\n"


def test_closed_pipe_is_no_error() -> None:
    command = f"'{sys.executable}' -m magical_mj list --ids | head -1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=True)
    assert (result.stdout, result.stderr) == ("magical_mj/MoveToCorner-Demo-v0\n", "")


# view, rollout, export


def test_view(shell: Shell, tmp_path: Path) -> None:
    assert shell("view", "FindDupe", "TestAll", "--seed", 3, "--size", 64) == (0, "FindDupe-All-3.png\n", "")
    assert shell("view", "FindDupe", "All", "--seed", 4, "--size", 64, "--out", "new/a.png")[0] == 0
    pictures = [opened(tmp_path / name) for name in ("FindDupe-All-3.png", "new/a.png")]
    assert {picture.size for picture in pictures} == {(128, 64)}
    assert pictures[0].tobytes() != pictures[1].tobytes()
    env = magical_mj.load("FindDupe", "All", seed=3, observations=())
    env.reset()
    left = pictures[0].crop((0, 0, 64, 64))
    assert left.tobytes() == Image.fromarray(env.render("allo", 64)).tobytes()


def test_view_draws_the_cameras_that_are_named(shell: Shell, tmp_path: Path) -> None:
    assert shell("view", "FindDupe", "--camera", "scene", "--size", 64, "--out", "scene.png")[0] == 0
    assert shell("view", "FindDupe", "--camera", "scene,ego,allo", "--size", 64, "--out", "three.png")[0] == 0
    scene, three = opened(tmp_path / "scene.png"), opened(tmp_path / "three.png")
    assert (scene.size, three.size) == ((64, 64), (192, 64))
    assert three.crop((0, 0, 64, 64)).tobytes() == scene.tobytes()
    assert "scene" in shell.fails(2, "view", "FindDupe", "--camera", "scenes")
    assert "scene" in shell.fails(2, "rollout", "FindDupe", "--camera", "scenes")


def test_view_grid(shell: Shell, tmp_path: Path) -> None:
    assert shell("view", "--grid", "--size", 32)[0] == 0
    pitch = 32 + environments.GAP
    size = (environments.MARGIN + len(names) * pitch for names in (magical_mj.VARIANTS, magical_mj.TASKS))
    assert opened(tmp_path / "environments-0.png").size == tuple(size)


def test_rollout_writes_a_video(shell: Shell, tmp_path: Path) -> None:
    code, out, _ = shell("rollout", "MoveToRegion", "Layout", "--episodes", 2, "--video", "a.mp4", "--size", 64)
    assert code == 0
    assert out.splitlines()[0].startswith("seed 0: score ")
    assert "expert: mean of 2 " in out
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert frames == 2 * (8 + 40 + 8)  # the first and the last frame of an episode stand for a second
    assert seconds == pytest.approx(frames / 8, abs=0.2)


def test_rollouts_repeat(shell: Shell) -> None:
    arguments = ("rollout", "MoveToRegion", "All", "--episodes", 3, "--seed", 5)
    assert shell(*arguments) == shell(*arguments)
    assert shell(*arguments, "--policy", "noop")[1].count("score 0.00 after 40 steps") == 3


def test_rollout_plays_what_evaluate_plays(shell: Shell, tmp_path: Path) -> None:
    """The same actions for the same seed, of built-in agents and of one's own, whatever they look at."""
    (tmp_path / "watchful.py").write_text("def turn(observation):\n    return int(observation[0, 0, 0]) % 18\n")
    for policy in ("random", "watchful:turn"):
        code, out, _ = shell("rollout", "FixColour", "All", "--policy", policy, "--episodes", 3)
        assert code == 0
        evaluate = ("evaluate", "--policy", policy, "--out", policy.replace(":", ""), "--episodes", 3, "--jobs", 1)
        assert shell(*evaluate, "--tasks", "FixColour", "--variants", "All")[0] == 0
        scores = [score.score for score in read(tmp_path / policy.replace(":", ""))]
        assert [float(line.split()[3]) for line in out.splitlines()[:3]] == [round(score, 2) for score in scores]


def test_a_policy_that_fails_is_told_and_filmed(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "wrong.py").write_text("def act(observation):\n    return 99\n")
    code, out, _ = shell("rollout", "MoveToRegion", "--policy", "wrong:act", "--video", "a.mp4", "--size", 32)
    assert code == 0
    assert "score 0.00 after 0 steps; the policy failed: InvalidActionError" in out


def test_films_say_what_is_shown() -> None:
    frames: list[np.ndarray] = []
    made = Film(frames.append, size=96, views=("allo", "ego"), pause=3)
    views = np.zeros((96, 192, 3), np.uint8)
    made.begin("FindDupe All, seed 3: expert", views, 0.0)
    made.add(views, 1, 13, 0.0)
    made.add(views, 2, 13, 0.5)
    made.end()
    assert len(frames) == 3 + 2 + 3
    assert {frame.shape for frame in frames} == {(made.height, made.width, 3)}
    assert made.height % 2 == 0
    start, first, second, last = frames[0], frames[3], frames[4], frames[-1]
    assert (start[:96] != 0).any()  # the title lies over the views
    assert (first[:96] == 0).all()
    assert (first[96:] != second[96:]).any()  # another step and another score
    assert np.array_equal(second, last)


@pytest.mark.parametrize(
    ("action", "words"), [(0, "nothing"), (1, "forward"), (5, "back, left"), (9, "grip"), (16, "forward, right, grip")]
)
def test_actions_in_words(action: int, words: str) -> None:
    assert in_words(action) == words


def test_export_loads_in_plain_mujoco(shell: Shell, tmp_path: Path) -> None:
    code, out, _ = shell("export", "FindDupe", "All", "--seed", 3, "--out", "models")
    assert (code, out) == (0, "models/FindDupe-All-3.xml\n")
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "models" / "FindDupe-All-3.xml"))
    assert model.nkey == 1


# demo


@pytest.mark.slow
def test_demo(tmp_path: Path) -> None:
    """The main job, on the quickest task, over what an earlier run left."""
    (tmp_path / "scores.jsonl").write_text("old")
    result = process("demo", "--tasks", "MoveToRegion", "--episodes", "1", "--jobs", "2", "--out", str(tmp_path))
    assert (result.returncode, result.stderr) == (0, "")
    assert "replacing an earlier run" in result.stdout
    assert "expert: mean score 1.000 over 6 environments" in result.stdout
    page = Path(result.stdout.splitlines()[-1])
    assert page == tmp_path / "report.md"
    linked = re.findall(r"\]\(([^)]+)\)", page.read_text())
    assert {"bars.png", "heat_map.png", "environments.png", "best-expert-MoveToRegion.mp4"} <= set(linked)
    assert all((tmp_path / name).stat().st_size > 0 for name in linked)


# wrong use: exit code 2


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("frobnicate", "No such command"),
        ("view", "give TASK"),
        ("view FindDupe --grid", "either TASK or --grid"),
        ("view FindDup", "Did you mean 'FindDupe'"),
        ("view FindDupe Color", "Did you mean 'Colour'"),
        ("view FindDupe TestDemo", "Did you mean 'Demo'"),
        ("view MoveToCorner Layout", "It has: Demo, Jitter"),
        ("view FindDupe --seed -1", "--seed"),
        ("view FindDupe --seed x", "--seed"),
        ("view FindDupe --size 0", "--size"),
        ("view FindDupe --out a.jpg", "must end in .png"),
        ("view FindDupe Demo extra", "extra"),
        ("rollout FindDupe --policy greedy", "unknown policy"),
        ("rollout FindDupe --policy gone.zip", "no file gone.zip"),
        ("rollout FindDupe --agent expert", "--agent"),
        ("rollout FindDupe --episodes 0", "--episodes"),
        ("rollout FindDupe --video a.avi", "must end in .mp4"),
        ("rollout MoveToRegion CountPlus", "It has: Demo, Jitter"),
        ("export FindDupe", "--out"),
        ("export", "TASK"),
        ("export FindDupe Nothing --out x", "unknown variant"),
        ("demo --jobs 0", "--jobs"),
    ],
)
def test_wrong_use(shell: Shell, line: str, hint: str, tmp_path: Path) -> None:
    assert hint.lower() in shell.fails(2, *line.split()).lower()
    assert list(tmp_path.iterdir()) == []


# failures: exit code 1


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
def test_unwritable_path_is_said_before_the_work(shell: Shell, line: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_work(*_: object, **__: object) -> None:
        pytest.fail("the path was not checked first")

    monkeypatch.setattr("magical_mj.environment.Environment.reset", no_work)
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


def test_a_failed_film_leaves_nothing(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RenderingError("OpenGL does not work here")

    monkeypatch.setattr("magical_mj.environment.Environment.render", broken)
    code, _, error = shell("rollout", "MoveToRegion", "--video", "a.mp4")
    assert (code, error) == (1, "magical-mj: OpenGL does not work here\n")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("extra", ["typer", "imageio_ffmpeg"])
def test_missing_extra_is_one_line(extra: str, tmp_path: Path) -> None:
    hide = f"import sys; sys.modules[{extra!r}] = None; from magical_mj.cli import main; sys.exit(main(sys.argv[1:]))"
    command = [sys.executable, "-c", hide, "rollout", "MoveToRegion", "--video", str(tmp_path / "a.mp4")]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 1
    assert 'pip install "magical-mj[' in result.stderr
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("backend", ["glfw", "osmesa"])
def test_no_opengl_is_one_line(backend: str, tmp_path: Path) -> None:
    """Backends that do not work: GLFW without a display, OSMesa where its library is not installed."""
    if backend == "osmesa" and osmesa_works():
        pytest.skip("OSMesa works here")
    variables = {"MUJOCO_GL": backend, "DISPLAY": "", "WAYLAND_DISPLAY": ""}
    result = process("view", "FindDupe", "--out", str(tmp_path / "a.png"), **variables)
    assert result.returncode == 1
    assert "MUJOCO_GL" in result.stderr
    assert result.stderr.count("\n") == 1
    assert process("list", **variables).stderr == ""


def test_mujoco_may_be_imported_first(tmp_path: Path) -> None:
    out = str(tmp_path / "a.png")
    code = f"import mujoco, sys, magical_mj.cli as cli; sys.exit(cli.main(['view', 'FindDupe', '--out', {out!r}]))"
    variables = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    result = subprocess.run([sys.executable, "-c", code], env=variables, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
