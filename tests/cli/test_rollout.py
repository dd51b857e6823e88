"""`magical-mj rollout`: the episodes that it plays, and the films of them."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import pytest

from magical_mj.cli.film import Film, film, in_words
from magical_mj.evaluation.scores import read
from magical_mj.utils.errors import RenderingError
from tests.helpers.commands import Shell


def test_rollout_writes_a_video(shell: Shell, tmp_path: Path) -> None:
    code, out, _ = shell(
        "rollout", "MoveToRegion", "Layout", "--episodes", 2, "--video", "a.mp4", "--size", 64, "--renderer", "software"
    )
    assert code == 0
    assert out.splitlines()[0].startswith("seed 0: score ")
    assert "expert: mean of 2 " in out
    assert [path.name for path in tmp_path.iterdir()] == ["a.mp4"]
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "a.mp4"))
    assert frames == 2 * (8 + 40 + 8)  # the first and the last frame of an episode stand for a second
    assert seconds == pytest.approx(frames / 8, abs=0.2)


def test_rollout_takes_one_environment(shell: Shell) -> None:
    for arguments in (("MoveToRegion", "all"), ("all", "Demo"), ("MoveToRegion,MakeLine", "Demo")):
        code, _, error = shell("rollout", *arguments, "--policy", "noop")
        assert code == 2
        assert "unknown" in error


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
    """In its own words, which rich's markup would change."""
    (tmp_path / "wrong.py").write_text("def act(observation):\n    raise ValueError('[batch, 12] is not in [/data]')\n")
    policy = "my [red] one=wrong:act"
    code, out, _ = shell("rollout", "MoveToRegion", "--policy", policy, "--video", "a:b.mp4", "--size", 32)
    assert code == 1
    assert "score 0.00 after 0 steps; the policy failed: ValueError: [batch, 12] is not in [/data]" in out
    assert "my [red] one: mean of 1 0.000" in out


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
    assert (start[:96] != 0).any()  # the title lies over the views
    assert (first[:96] == 0).all()
    assert (first[96:] != second[96:]).any()  # another step and another score
    assert np.array_equal(second, last)


def test_long_titles_fit() -> None:
    frames: list[np.ndarray] = []
    movie = Film(frames.append, size=192, views=("allo",), pause=1)
    movie.begin("FindDupe CountPlus, seed 3: expert", np.zeros((192, 192, 3), np.uint8), 0.0)
    band = frames[0][86:106]
    assert len(np.unique(band)) > 1
    assert len(np.unique(band[:, [0, 1, 2, -3, -2, -1]])) == 1  # no letter is cut at the sides


@pytest.mark.parametrize("overwrite", [False, True])
def test_what_appears_under_a_videos_name_meanwhile_is_kept(tmp_path: Path, overwrite: bool) -> None:
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


def test_a_failed_film_leaves_nothing(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise RenderingError("OpenGL does not work here")

    monkeypatch.setattr("magical_mj.engine.Engine.render", broken)
    code, _, error = shell("rollout", "MoveToRegion", "--video", "a.mp4")
    assert (code, error) == (1, "magical-mj: OpenGL does not work here\n")
    assert list(tmp_path.iterdir()) == []
