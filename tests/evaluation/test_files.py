"""What an evaluation leaves in its folder: resumed, killed, corrupted, changed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation import Episode, Score
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import SCORES, ScoreFile, read
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers import agents
from tests.helpers.evaluations import SMALL, rows

TESTS = Path(__file__).parent


def test_file_holds_everything(tmp_path: Path) -> None:
    frame = magical_mj.evaluate("random", out=tmp_path, **SMALL)
    assert len(read(tmp_path)) == len(frame) == 6
    entry = json.loads((tmp_path / SCORES).read_text().splitlines()[0])
    assert set(entry) == set(frame.columns)
    assert entry["version"] == magical_mj.__version__
    assert entry["rules"] == "paper"
    assert entry["preset"] is None  # random looks at nothing
    assert entry["steps"] == len(entry["actions"]) == 40


def test_resume_does_only_what_is_left(tmp_path: Path) -> None:
    whole = magical_mj.evaluate("random", out=tmp_path / "whole", **SMALL)
    magical_mj.evaluate("random", out=tmp_path / "part", **SMALL)
    path = tmp_path / "part" / SCORES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:3]))
    played: list[Score] = []
    again = magical_mj.evaluate("random", out=tmp_path / "part", resume=True, watch=played.append, **SMALL)
    assert len(played) == 3
    assert path.read_text().startswith("".join(lines[:3]))
    pd.testing.assert_frame_equal(again.drop(columns="seconds"), whole.drop(columns="seconds"))
    magical_mj.evaluate("random", out=tmp_path / "part", resume=True, watch=played.append, **SMALL)
    assert len(played) == 3


def test_a_policy_whose_code_has_changed_is_another_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("still.py").write_text("def policy(observation):\n    return 0\n")
    magical_mj.evaluate("still:policy", out="scores", **SMALL)
    Path("still.py").write_text("def policy(observation):\n    return 1\n")
    with pytest.raises(SettingsError, match="was started with other settings: policies was"):
        magical_mj.evaluate("still:policy", out="scores", resume=True, **SMALL)


def test_a_task_whose_code_has_changed_is_another_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("short_task.py").write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.move_to_region import SPEC as OLD\n"
        'SPEC = replace(OLD, name="Short", steps=4)\n'
    )
    chosen = {**SMALL, "tasks": "short_task:SPEC", "variants": "Demo", "out": "scores"}
    magical_mj.evaluate("noop", **chosen)
    assert len(magical_mj.evaluate("noop", resume=True, **chosen)) == SMALL["episodes"]
    Path("short_task.py").write_text(Path("short_task.py").read_text().replace("steps=4", "steps=5"))
    with pytest.raises(SettingsError, match=r'code of short_task:SPEC was "\w+" and is "\w+"'):
        magical_mj.evaluate("noop", resume=True, **chosen)


class Misnamed:
    """Misses a file in the scene of seed 1, whose name is not UTF-8: so Python shows the bytes of such names."""

    blind = True

    def reset(self, episode: Episode) -> None:
        if episode.seed == 1:
            raise FileNotFoundError("weights-\udce9.npy")

    def __call__(self, observation: Any) -> int:
        return 0


def test_reasons_that_cannot_be_encoded_are_kept(tmp_path: Path) -> None:
    magical_mj.evaluate(Misnamed(), out=tmp_path, **SMALL)
    assert {score.failure for score in read(tmp_path)} == {None, r"FileNotFoundError: weights-\udce9.npy"}


@pytest.mark.parametrize("cut", [1, 20, -2, -1])
def test_a_half_written_last_line_is_repaired(tmp_path: Path, cut: int) -> None:
    """At any place: what is whole but for its end is kept; all else is played again; the neighbours stay."""
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    before = rows(tmp_path)
    path = tmp_path / SCORES
    *kept, last = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(kept) + last[:cut])
    assert len(read(tmp_path)) == (6 if cut == -1 else 5)  # reports need no repair
    played: list[Score] = []
    magical_mj.evaluate("random", out=tmp_path, resume=True, watch=played.append, **SMALL)
    assert len(played) == (0 if cut == -1 else 1)
    assert rows(tmp_path) == before
    assert path.read_bytes().startswith(b"".join(kept))


@pytest.mark.parametrize(
    ("before", "after", "hint"),
    [
        (b"\n", b" ", "line 1: more than one episode; each must have a line of its own"),
        (b"}\n", b"", "line 1: "),
        (b'}\n{"policy": ', b'\n{"policy": ', "line 1: "),
        (b'single"}\n', b'single"}\nmy notes', "line 2: "),
    ],
)
def test_nothing_but_a_half_written_line_is_dropped(tmp_path: Path, before: bytes, after: bytes, hint: str) -> None:
    """Where ends of lines were lost, or something was added, nothing is changed."""
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    path = tmp_path / SCORES
    path.write_bytes(path.read_bytes().replace(before, after))
    damaged = path.read_bytes()
    for reading in (lambda: read(tmp_path), lambda: magical_mj.evaluate("random", out=tmp_path, resume=True, **SMALL)):
        with pytest.raises(EvaluationError) as caught:
            reading()
        assert hint in str(caught.value)
        assert path.read_bytes() == damaged


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("{half", "line 3"),
        ("[]", "line 3: it must be an object with the keys policy"),
        ("same", "line 3: the same episode as line 2"),
        ("score", "line 3: the score 1.5 is not in [0, 1]"),
        ("steps", "line 3: steps must not be 'many'"),
        ("\x00\x00", "line 3"),
        ("policy", r"line 3: policy must be a text of printable characters, not 'a\x00b'"),
        ("task", "line 3: task must be a text of printable characters"),
        ("gl", "line 3: gl must be a text of printable characters"),
        ("failure", "line 3: failure must be a text of printable characters"),
        ("[" * 100_000, "line 3: lists in lists without end"),
    ],
)
def test_corrupted_lines_are_named(tmp_path: Path, line: str, hint: str) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    path = tmp_path / SCORES
    lines = path.read_text().splitlines()
    wrong = {"score": 1.5, "steps": "many", "policy": "a\0b", "task": "a\nb", "gl": "\ud800", "failure": "\ud800"}
    lines[2] = lines[1] if line == "same" else line
    if line in wrong:
        lines[2] = json.dumps(json.loads(lines[1]) | {line: wrong[line]})
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(EvaluationError) as caught:
        read(tmp_path)
    assert hint in str(caught.value)
    with pytest.raises(EvaluationError, match="line 3"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)


@pytest.mark.parametrize(
    ("policy", "change", "difference"),
    [
        ("noop", {"episodes": 4}, "episodes was 3 and is 4"),
        ("noop", {"rules": "released"}, 'rules was "paper" and is "released"'),
        ("noop", {"preset": "LoRes4A"}, 'preset was "LoRes4E" and is "LoRes4A"'),
        ("noop", {"variants": "Demo"}, "environments was"),
        ("random", {}, "policies was"),
    ],
)
def test_changed_settings_are_refused(tmp_path: Path, policy: str, change: dict[str, Any], difference: str) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    before = (tmp_path / SCORES).read_bytes()
    with pytest.raises(SettingsError) as caught:
        magical_mj.evaluate(policy, out=tmp_path, resume=True, **{**SMALL, **change})
    assert difference in str(caught.value)
    assert (tmp_path / SCORES).read_bytes() == before


def test_a_changed_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.policies.loading.LOADERS", {".toy": lambda path, trust: agents.look})
    model = tmp_path / "model.toy"
    model.write_text("one")
    settings = {**SMALL, "episodes": 1, "variants": "Demo"}
    magical_mj.evaluate(str(model), out=tmp_path / "out", **settings)
    model.write_text("two")
    with pytest.raises(SettingsError, match="sha256"):
        magical_mj.evaluate(str(model), out=tmp_path / "out", resume=True, **settings)


def test_folders_are_not_mixed_up(tmp_path: Path) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    with pytest.raises(EvaluationError, match="--resume"):
        magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    with ScoreFile(tmp_path), pytest.raises(EvaluationError, match="another evaluation"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)
    with pytest.raises(EvaluationError, match="cannot write into /dev/null/folder"):
        magical_mj.evaluate("noop", out="/dev/null/folder", **SMALL)


def test_an_evaluation_without_a_finished_episode_can_be_started_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With other settings, too, as long as no other process plays into the folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("failing.py").write_text("def act(observation):\n    raise KeyError('position')\n")
    with pytest.raises(EvaluationError, match="failed, so none of them is kept"):
        magical_mj.evaluate("failing:act", out="out", **SMALL)
    with ScoreFile(Path("out")), pytest.raises(EvaluationError, match="another evaluation"):
        magical_mj.evaluate("noop", out="out", **SMALL)
    assert len(magical_mj.evaluate("noop", out="out", **SMALL)) == len(read(Path("out"))) == 6
    assert len(magical_mj.evaluate("noop", out="out", resume=True, **SMALL)) == 6


def test_settings_are_those_of_the_evaluation_that_plays(tmp_path: Path) -> None:
    """Not of one that was prepared in the same folder meanwhile."""
    first, second = (
        Evaluation("noop", EvaluationSettings(out=tmp_path, **{**SMALL, "episodes": count})) for count in (1, 2)
    )
    list(first.play())
    with pytest.raises(SettingsError, match="episodes was 1 and is 2"):
        list(second.play())
    assert len(read(tmp_path)) == 2


def test_a_file_of_settings_that_is_not_ours_is_kept(tmp_path: Path) -> None:
    (tmp_path / SETTINGS).write_text('{"mine": 1}')
    with pytest.raises(EvaluationError, match=r"run\.json is not of an evaluation"):
        magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['{"mine": 1}']


def killed_and_resumed(folder: Path, kills: int, jobs: int) -> set[tuple[Any, ...]]:
    """The rows of an evaluation that was killed so many times at random moments, each time with work left."""
    command = [sys.executable, "-m", "magical_mj", "evaluate", "--policy", "random,agents:Slow", "--out", str(folder)]
    command += [
        "--tasks",
        "MoveToRegion",
        "--variants",
        "Demo,Layout",
        "--episodes",
        "60",
        "--jobs",
        str(jobs),
        "--resume",
    ]
    rng = random.Random(jobs)
    for _ in range(kills):
        process = subprocess.Popen(command, cwd=TESTS, stdout=subprocess.DEVNULL, start_new_session=True)
        size = lambda: (folder / SCORES).stat().st_size if (folder / SCORES).exists() else 0  # noqa: E731
        before, start = size(), time.monotonic()
        while size() == before and time.monotonic() - start < 60:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
        assert process.poll() is None, "it ended before it could be killed"
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(command, cwd=TESTS, stdout=subprocess.DEVNULL, check=True)
    return rows(folder)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_killed_runs_end_with_the_same_rows(tmp_path: Path, jobs: int) -> None:
    settings = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 60}
    whole = magical_mj.evaluate("random,Slow=noop", out=tmp_path / "whole", **settings)  # does the same, but faster
    found = killed_and_resumed(tmp_path / "killed", kills=2, jobs=jobs)
    assert len(found) == len(whole) == 240
    assert found == rows(tmp_path / "whole")
