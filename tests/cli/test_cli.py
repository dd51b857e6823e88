"""The command line: lists, pictures, exported models, rollouts, videos, and the short tour."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import gymnasium
import imageio_ffmpeg
import mujoco
import numpy as np
import pytest
from PIL import Image

import magical_mj
from magical_mj.cli import environments
from magical_mj.cli.film import Film, film, in_words
from magical_mj.evaluation.scores import read
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError
from tests.helpers.commands import Shell, commands, opened, process

TASK = """
from dataclasses import replace
from magical_mj.tasks.move_to_corner import SPEC as OURS
SPEC = replace(OURS, name="PushToWall")
"""


def test_list_shows_every_environment(shell: Shell) -> None:
    code, out, _ = shell("list")
    lines = out.splitlines()
    assert code == 0
    assert lines[0] == "The benchmark: 8 tasks, 60 environments"
    assert lines[62] == "Not in the benchmark: other suites and installed tasks: 1 task, 6 environments"
    rows = [line.split() for line in (*lines[2:62], *lines[64:])]
    sweep = [("SweepToTop", variant) for variant in ("Demo", "Layout", "Colour", "Shape", "Dynamics", "All")]
    assert [(row[0], row[1]) for row in rows] == [*magical_mj.ENVIRONMENTS, *sweep]
    assert ["FindDupe", "Layout", "100", "layout"] in rows
    assert ["MoveToCorner", "Demo", "80", "nothing"] in rows


def test_an_unknown_variant_is_told_the_benchmarks(shell: Shell) -> None:
    error = shell("view", "FindDupe", "Dem0")[2]
    assert "Did you mean 'Demo'" in error
    assert "Diagnose" not in error


def test_list_ids(shell: Shell) -> None:
    """The registered environments (for SweepToTop those of its suite), or those of the given tasks."""
    _, out, _ = shell("list", "--ids")
    ids = out.split()
    assert ids[:60] == [magical_mj.env_id(task, variant) for task, variant in magical_mj.ENVIRONMENTS]
    assert len(ids) == len(set(ids)) == 60 + 96
    assert set(ids) <= set(gymnasium.registry)
    assert (
        shell("list", "FindDupe,SweepToTop", "--ids")[1].split() == [id_ for id_ in ids if "FindDupe" in id_] + ids[60:]
    )


def test_intents_are_listed_viewed_exported_evaluated_and_demonstrated(shell: Shell, tmp_path: Path) -> None:
    rows = shell("list", "dev,intent:seen", "--intents")[1].splitlines()
    assert len(rows) == 50 + 50
    assert re.search(r"intent:dev/3 +\d+ bits +" + re.escape(f"{magical_mj.intents.SETS['dev'][3]}: "), rows[3])
    assert "[seed=1]: " in rows[50]
    assert "Did you mean 'dev'" in shell("list", "--intents", "deb")[2]
    task = "intent:robot wall(top)"
    name = magical_mj.env_id(task, "Layout").split("/")[1].removesuffix("-v0").replace("Test", "")
    assert shell("view", task, "Layout", "--seed", "3")[1].strip() == f"{name}-3.png"
    assert shell("export", task, "Layout", "--seed", "3")[1].strip() == f"{name}-3.xml"
    mujoco.MjModel.from_xml_path(f"{name}-3.xml")
    run = ("--tasks", f"{task},intent:in(colour=red, region)", "--variants", "Demo", "--episodes", "1", "--out", "run")
    assert shell("evaluate", "--policy", "noop", *run)[0] == 0
    assert [row.task for row in read(tmp_path / "run")] == ["intent:in(colour=red, region)", task]
    assert shell("report", "run")[0] == 0
    assert shell("demos", "generate", "--tasks", task, "--count", "1", "--jobs", "1", "--out", "demos")[0] == 0
    (demo,) = magical_mj.demos.load(task, "demos")
    assert (demo.task, demo.score) == (task, 1.0)
    assert "magical-mj demos generate --tasks 'intent:robot wall(top)'" in error_of(task)


def error_of(task: str) -> str:
    """What the error about missing demonstrations says."""
    with pytest.raises(DemonstrationError) as error:
        magical_mj.demos.load(task)
    return str(error.value)


def test_list_shows_a_task_of_ones_own(shell: Shell) -> None:
    Path("push_to_wall.py").write_text(TASK)
    rows = [line.split() for line in shell("list", "push_to_wall:SPEC")[1].splitlines()[1:]]
    assert [row[:3] for row in rows[:2]] == [["push_to_wall:SPEC", variant, "80"] for variant in ("Demo", "Jitter")]


def test_out_is_a_file_or_its_folder(shell: Shell) -> None:
    """By default, a file has its usual name in the current folder. Evaluations and trainings write to a folder."""
    view, model = ("view", "FindDupe", "--size", 32), ("export", "FindDupe")
    for command, name in ((view, "FindDupe-Demo-0.png"), (model, "FindDupe-Demo-0.xml")):
        for out, path in (([], name), (["--out", "a"], f"a/{name}"), (["--out", f"b{name[-4:]}"], f"b{name[-4:]}")):
            assert shell(*command, *out) == (0, f"{path}\n", "")
            assert Path(path).is_file()
        assert f"must end in {name[-4:]}" in shell.fails(2, *command, "--out", "a.jpg")
    assert "--out must be a folder" in shell.fails(2, "evaluate", "--policy", "noop", "--out", "scores.jsonl")


def test_help_and_version(shell: Shell) -> None:
    for arguments in ((), ("--help",), ("-h",)):
        code, out, _ = shell(*arguments)
        assert code == 0
        assert all(name.split()[0] in out for name in commands())
    assert "verify" in shell("demos")[1]
    assert shell("--version") == (0, f"magical-mj {magical_mj.__version__}\n", "")


def test_the_command_starts_as_a_script_and_as_a_module() -> None:
    script = Path(sys.executable).with_name("magical-mj")
    for command in ([sys.executable, script], [sys.executable, "-m", "magical_mj"]):
        result = subprocess.run([*command, "--version"], capture_output=True, text=True, check=True)
        assert result.stdout == f"magical-mj {magical_mj.__version__}\n"


@pytest.mark.parametrize(("command", "code"), [("list --ids", 0), ("--help", 141)])
def test_a_closed_pipe_ends_quietly(command: str, code: int) -> None:
    """The reader closes the pipe before anything is written."""
    reading, writing = os.pipe()
    os.close(reading)
    full = [sys.executable, "-m", "magical_mj", *command.split()]
    result = subprocess.run(full, stdout=writing, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writing)
    assert (result.returncode, result.stderr) == (code, "")


def test_view(shell: Shell, tmp_path: Path) -> None:
    assert shell("view", "FindDupe", "TestAll", "--seed", 3, "--size", 64) == (0, "FindDupe-All-3.png\n", "")
    assert shell("view", "FindDupe", "All", "--seed", 4, "--size", 64, "--out", "new/a.png")[0] == 0
    pictures = [opened(tmp_path / name) for name in ("FindDupe-All-3.png", "new/a.png")]
    assert {picture.size for picture in pictures} == {(128, 64)}
    assert pictures[0].tobytes() != pictures[1].tobytes()
    env = magical_mj.Engine("FindDupe", "All", seed=3)
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
    assert "scene" in shell.fails(2, "rollout", "FindDupe", "--video", "a.mp4", "--camera", "scenes")


def test_shifts_and_bodies_are_seen_exported_and_played(shell: Shell, tmp_path: Path) -> None:
    shifted = ("MoveToRegion", "--shifts", "texture:5,clutter:2", "--body", "mediumstick")
    assert shell("view", *shifted, "--size", 64, "--out", "a.png", "--renderer", "software")[0] == 0
    options: dict[str, Any] = {"shifts": "texture:5,clutter:2", "body": "mediumstick", "renderer": "software"}
    env = magical_mj.Engine("MoveToRegion", seed=0, **options)
    assert opened(tmp_path / "a.png").crop((0, 0, 64, 64)).tobytes() == env.render("allo", 64).tobytes()
    assert shell("export", *shifted, "--out", "models")[0] == 0
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "models" / "MoveToRegion-Demo-0.xml"))
    assert [model.body(index).name.rstrip("0123456789") for index in range(model.nbody)].count("pebble") == 2
    rollout = ("rollout", *shifted, "--policy", "random", "--preset", "State")
    assert "seed 0: score 0.00 after 40 steps" in shell(*rollout)[1]
    assert "strength" in shell.fails(2, "view", "FindDupe", "--shifts", "camera:1-3")


def test_view_grid(shell: Shell, tmp_path: Path) -> None:
    assert shell("view", "--grid", "--size", 32)[0] == 0
    pitch = 32 + environments.GAP
    size = (environments.MARGIN + len(names) * pitch for names in (magical_mj.VARIANTS, magical_mj.TASKS))
    assert opened(tmp_path / "environments-0.png").size == tuple(size)


def test_a_demo_does_not_touch_the_folder_of_another(shell: Shell, tmp_path: Path) -> None:
    """Another demo is running."""
    command = ("demo", "--tasks", "MoveToRegion", "--episodes", 1, "--jobs", 1, "--out", tmp_path)
    with files.locked(tmp_path):
        assert f"another demo is running in {tmp_path}; wait for it" in shell.fails(1, *command)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_demo(tmp_path: Path) -> None:
    """The main job, on the quickest task, in the folder of a killed run, on a machine without OpenGL."""
    (tmp_path / ".run.0123abcd-4567cdef.part.json").write_text("{")
    (tmp_path / "scores.jsonl").touch()
    settings = {"tasks": "MoveToRegion", "episodes": 1, "jobs": 1, "renderer": "software"}
    magical_mj.evaluate("expert,random,noop", out=tmp_path, **settings)
    broken = tmp_path.parent / "broken libraries"
    broken.mkdir()
    for name in ("libEGL.so.1", "libGL.so.1"):
        (broken / name).write_text("no library")
    command = ("demo", "--tasks", "MoveToRegion", "--episodes", "1", "--jobs", "1", "--out", str(tmp_path))
    result = process(*command, MUJOCO_GL="", DISPLAY="", LD_LIBRARY_PATH=str(broken))
    assert (result.returncode, result.stderr) == (0, "")
    assert {row.gl for row in read(tmp_path)} == {"software"}
    assert "replacing an earlier run" in result.stdout
    assert re.search(r"^ *expert( +1\.000){6} *$", result.stdout, re.MULTILINE)
    page = Path(result.stdout.splitlines()[-1])
    assert page == tmp_path / "report.md"
    linked = re.findall(r"\]\(([^)]+)\)", page.read_text())
    assert {"bars.png", "heat_map.png", "environments.png", "best-expert-MoveToRegion.mp4"} <= set(linked)
    assert all((tmp_path / name).stat().st_size > 0 for name in linked)


def test_rollout_writes_a_video(shell: Shell, tmp_path: Path) -> None:
    code, out, _ = shell(
        "rollout", "MoveToRegion", "Layout", "--episodes", 2, "--video", "a.mp4", "--size", 64, "--renderer", "software"
    )
    assert code == 0
    assert out.splitlines()[0].startswith("seed 0: score ")
    assert "expert: mean score of 2 episodes 1.000" in out
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert frames == 2 * (8 + 40 + 8)  # the first and the last frame of an episode are shown for a second
    assert seconds == pytest.approx(frames / 8, abs=0.2)


def test_rollout_takes_one_environment(shell: Shell) -> None:
    for arguments in (("MoveToRegion", "all"), ("all", "Demo"), ("MoveToRegion,MakeLine", "Demo")):
        assert "unknown" in shell.fails(2, "rollout", *arguments, "--policy", "noop")


def test_rollout_plays_what_evaluate_plays(shell: Shell, tmp_path: Path) -> None:
    """The same seed gives the same actions, for built-in agents and for users' policies."""
    (tmp_path / "watchful.py").write_text("def turn(observation):\n    return int(observation[0, 0, 0]) % 18\n")
    for policy in ("random", "watchful:turn"):
        code, out, _ = shell("rollout", "FixColour", "All", "--policy", policy, "--episodes", 3)
        assert code == 0
        evaluate = ("evaluate", "--policy", policy, "--out", policy.replace(":", ""), "--episodes", 3, "--jobs", 1)
        assert shell(*evaluate, "--tasks", "FixColour", "--variants", "All")[0] == 0
        scores = [score.score for score in read(tmp_path / policy.replace(":", ""))]
        assert [float(line.split()[3]) for line in out.splitlines()[:3]] == [round(score, 2) for score in scores]


def test_a_policy_that_fails_is_told_and_filmed(shell: Shell, tmp_path: Path) -> None:
    """The policy's own message is printed unchanged, although rich's markup could interpret it."""
    (tmp_path / "wrong.py").write_text("def act(observation):\n    raise ValueError('[batch, 12] is not in [/data]')\n")
    policy = "my [red] one=wrong:act"
    code, out, _ = shell("rollout", "MoveToRegion", "--policy", policy, "--video", "a:b.mp4", "--size", 32)
    assert code == 1
    assert "score 0.00 after 0 steps; the policy failed: ValueError: [batch, 12] is not in [/data]" in out
    assert "my [red] one: mean score of 1 episode 0.000" in out


def test_the_expert_begins_no_task_without_a_plan(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "planless.py").write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.find_dupe import SPEC as OURS\n"
        'SPEC = replace(OURS, name="Planless", plan=None)\n'
    )
    assert "no plan" in shell.fails(2, "rollout", "planless:SPEC")
    assert "no plan" in shell.fails(
        2, "evaluate", "--policy", "noop,expert", "--tasks", "planless:SPEC", "--jobs", 1, "--out", "scores"
    )


def test_an_interrupted_rollout_says_what_it_leaves(shell: Shell, tmp_path: Path) -> None:
    (tmp_path / "stopping.py").write_text("def act(observation):\n    raise KeyboardInterrupt\n")
    command = ("rollout", "MoveToRegion", "--policy", "noop,stopping:act", "--episodes", 2, "--size", 32)
    code, out, _ = shell(*command, "--video", "a.mp4")
    assert code == 130
    assert out.splitlines()[-1] == "stopped after 2 of 4 episodes; a.mp4 was not written"
    assert not (tmp_path / "a.mp4").exists()


def test_films_say_what_is_shown() -> None:
    frames: list[np.ndarray] = []
    movie = Film(frames.append, size=96, views=("allo", "ego"), pause=3)
    views = np.zeros((96, 192, 3), np.uint8)
    movie.begin("FindDupe All, seed 3: expert", views, 0.0)
    movie.add(views, 1, 13, 0.0)
    movie.add(views, 2, 13, 0.5)
    movie.end()
    assert len(frames) == 3 + 2 + 3
    assert {frame.shape for frame in frames} == {(movie.height, movie.width, 3)}
    assert movie.height % 2 == 0
    start, first, second, last = frames[0], frames[3], frames[4], frames[-1]
    assert (start[:96] != 0).any()  # the title is drawn over the views
    assert (first[:96] == 0).all()
    assert (first[96:] != second[96:]).any()  # another step and another score
    assert np.array_equal(second, last)


def test_long_titles_fit() -> None:
    frames: list[np.ndarray] = []
    movie = Film(frames.append, size=192, views=("allo",), pause=1)
    movie.begin("FindDupe CountPlus, seed 3: expert", np.zeros((192, 192, 3), np.uint8), 0.0)
    band = frames[0][86:106]
    assert len(np.unique(band)) > 1
    assert len(np.unique(band[:, [0, 1, 2, -3, -2, -1]])) == 1  # no letter is cut off at the sides


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_file_that_appears_under_a_videos_name_is_kept(tmp_path: Path, overwrite: bool) -> None:
    path, picture = tmp_path / "a.mp4", np.zeros((32, 32, 3), np.uint8)
    with (
        nullcontext() if overwrite else pytest.raises(FileExistsError, match="exists already"),
        film(path, 32, views=("allo",), overwrite=overwrite) as movie,
    ):
        movie.begin("", picture, 0.0)
        path.write_bytes(b"mine")
    assert (path.read_bytes() == b"mine") != overwrite
    assert [file.name for file in tmp_path.iterdir()] == ["a.mp4"]


@pytest.mark.parametrize(
    ("action", "words"), [(0, "nothing"), (1, "forward"), (5, "back, left"), (9, "grip"), (16, "forward, right, grip")]
)
def test_actions_in_words(action: int, words: str) -> None:
    assert in_words(action) == words
