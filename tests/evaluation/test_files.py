"""The folder of an evaluation when it is resumed, killed, corrupted or changed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation import Episode, EpisodeResult
from magical_mj.evaluation.folder import SETTINGS, read_settings
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.run import Evaluation
from magical_mj.evaluation.scores import SCORES, open_scores, read
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers import agents
from tests.helpers.evaluations import SMALL, TEMPLATE, rows, write

ROOT = Path(__file__).parents[2]


def test_file_holds_everything(tmp_path: Path) -> None:
    frame = magical_mj.evaluate("random", out=tmp_path, **SMALL)
    assert len(read(tmp_path)) == len(frame) == 6
    entry = json.loads((tmp_path / SCORES).read_text().splitlines()[0])
    optional = {"given", "demonstrations", "other", "other_score", "others_moved"}
    unwritten = {"split", "shift", "wrap", "body", "retry", *optional}  # left out if they have default values
    assert set(entry) == set(frame.columns) - unwritten
    assert entry["version"] == magical_mj.__version__
    assert entry["rules"] == "paper"
    assert entry["preset"] is None  # the random agent uses no observations
    assert entry["steps"] == len(entry["actions"]) == 40


@pytest.mark.parametrize("name", [SCORES, SETTINGS])
def test_a_pipe_in_the_place_of_a_file_is_refused(name: str, tmp_path: Path) -> None:
    """It must not wait for a writer."""
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(EvaluationError, match=f"{name} is not a plain file"):
        magical_mj.evaluate("random", out=tmp_path, resume=True, **SMALL)


def test_resume_does_only_what_is_left(tmp_path: Path) -> None:
    whole = magical_mj.evaluate("random", out=tmp_path / "whole", **SMALL)
    magical_mj.evaluate("random", out=tmp_path / "part", **SMALL)
    path = tmp_path / "part" / SCORES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:3]))
    played: list[EpisodeResult] = []
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
    with pytest.raises(SettingsError, match="holds policies that are left out here, or have changed: policy"):
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


@pytest.mark.parametrize(("setting", "name"), [("shifts", "own_parts:Heavy"), ("body", "own_parts:DISC")])
def test_a_shift_or_a_body_whose_code_has_changed_is_another_one(
    setting: str, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is neither continued nor replayed."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("own_parts.py").write_text(
        "from magical_mj.scene.bodies import Body\nfrom magical_mj.shifts import Shift\nDISC = Body(mass=0.5)\n"
        "class Heavy(Shift):\n    name = 'heavy'\n    def model(self, model):\n        model.body_mass[:] *= 2\n"
    )
    chosen: dict[str, Any] = {**SMALL, "out": "scores", setting: f"{name}:1" if setting == "shifts" else name}
    magical_mj.evaluate("noop", **chosen)
    *_, last = read(Path("scores"))
    assert obstacle(last, read_settings(Path("scores")), [name]) is None
    assert len(magical_mj.evaluate("noop", **{**chosen, "resume": True})) == len(read(Path("scores")))
    Path("own_parts.py").write_text(Path("own_parts.py").read_text() + "# changed\n")
    with pytest.raises(SettingsError, match=rf'code of {name} was "\w+" and is "\w+"'):
        magical_mj.evaluate("noop", **{**chosen, "resume": True})
    assert (
        obstacle(last, read_settings(Path("scores")), [name]) == f"the code of {name} has changed since it was played"
    )


def miss_a_file(episode: Episode) -> None:
    """A missing file in the scene of seed 1. Its name is not UTF-8, and Python represents such names by surrogates."""
    if episode.seed == 1:
        raise FileNotFoundError("weights-\udce9.npy")


def test_reasons_that_cannot_be_encoded_are_kept(tmp_path: Path) -> None:
    magical_mj.evaluate(agents.Acting(reset=miss_a_file), out=tmp_path, **SMALL)
    reasons = {score.failure for score in read(tmp_path)} - {None}
    assert all(reason.startswith(r"FileNotFoundError: weights-\udce9.npy (") for reason in reasons if reason)
    assert len(reasons) == 1


@pytest.mark.parametrize("cut", [1, 20, -1])
def test_a_half_written_last_line_is_played_again(tmp_path: Path, cut: int) -> None:
    """At whatever byte the line was cut. The other lines are kept."""
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    before = rows(tmp_path)
    path = tmp_path / SCORES
    *whole, last = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(whole) + last[:cut])
    assert len(read(tmp_path)) == 5  # reports do not need a repaired file
    played: list[EpisodeResult] = []
    magical_mj.evaluate("random", out=tmp_path, resume=True, watch=played.append, **SMALL)
    assert len(played) == 1
    assert rows(tmp_path) == before
    assert path.read_bytes().startswith(b"".join(whole))


def test_lines_that_have_lost_their_ends_are_kept(tmp_path: Path) -> None:
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    path = tmp_path / SCORES
    path.write_bytes(damaged := path.read_bytes().replace(b"\n", b" "))
    with pytest.raises(EvaluationError, match="line 1"):
        read(tmp_path)
    with pytest.raises(EvaluationError, match="line 1"):
        magical_mj.evaluate("random", out=tmp_path, resume=True, **SMALL)
    assert path.read_bytes() == damaged


def test_corrupted_lines_are_named(tmp_path: Path) -> None:
    write(tmp_path, [replace(TEMPLATE, seed=seed) for seed in range(3)])
    path = tmp_path / SCORES
    lines = path.read_text().splitlines()
    whole = json.loads(lines[2])
    wrong = {"score": 1.5, "steps": "many", "run": True, "policy": "a\0b", "task": "a\nb", "gl": "\ud800", "mine": 1}
    wrong |= {"variant": "Foo", "seed": 2**63}
    changed = [json.dumps(whole | {name: value}) for name, value in wrong.items()]
    less = json.dumps({name: value for name, value in whole.items() if name != "actions"})
    for line in (*changed, less, lines[1], "{half", "[]", "", "\x00\x00", "[" * 100_000, f"{lines[2]} {lines[2]}"):
        path.write_text("\n".join([*lines[:2], line]) + "\n")
        with pytest.raises(EvaluationError, match="line 3"):
            read(tmp_path)


def test_files_of_older_versions_are_read(tmp_path: Path) -> None:
    old = json.loads(TEMPLATE.line())
    del old["scene"], old["worlds"]
    (tmp_path / SCORES).write_text(json.dumps(old) + "\n")
    assert read(tmp_path) == [TEMPLATE]


@pytest.mark.parametrize(
    ("policy", "change", "difference"),
    [
        ("noop", {"episodes": 2}, "holds the scenes 0 to 2 of its split, but 0 to 1 are requested"),
        ("noop", {"first_seed": 1}, "holds the scenes 0 to 2 of its split, but 1 to 3 are requested"),
        ("noop", {"rules": "released"}, 'rules was "paper" and is "released"'),
        ("noop", {"preset": "LoRes4A"}, 'preset was "State" and is "LoRes4A"'),
        ("noop", {"variants": "Demo"}, "environments that are left out here, or have changed: MoveToRegion-Layout."),
        ("random", {}, "policies that are left out here, or have changed: noop."),
    ],
)
def test_changed_settings_are_refused(tmp_path: Path, policy: str, change: dict[str, Any], difference: str) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    before = (tmp_path / SCORES).read_bytes()
    with pytest.raises(SettingsError) as caught:
        magical_mj.evaluate(policy, out=tmp_path, resume=True, **{**SMALL, **change})
    assert difference in str(caught.value)
    assert (tmp_path / SCORES).read_bytes() == before


@pytest.mark.parametrize(
    ("name", "value"), [("episodes", None), ("first_seed", "0"), ("environments", "all"), ("shifts", 3)]
)
def test_a_damaged_file_of_settings_is_no_evaluation_that_can_go_on(tmp_path: Path, name: str, value: Any) -> None:
    """Found by fuzzing: it was taken for the settings of a smaller evaluation, and overwritten."""
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    damaged = json.dumps(read_settings(tmp_path) | {name: value})
    (tmp_path / SETTINGS).write_text(damaged)
    with pytest.raises(EvaluationError, match=rf"does not belong to an evaluation.*\.{name}"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)
    assert (tmp_path / SETTINGS).read_text() == damaged


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
    with open_scores(tmp_path), pytest.raises(EvaluationError, match="another evaluation"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)
    with pytest.raises(EvaluationError, match="cannot write into /dev/null/folder"):
        magical_mj.evaluate("noop", out="/dev/null/folder", **SMALL)


def test_an_evaluation_without_a_finished_episode_can_be_started_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even with other settings, as long as no other process is writing to the folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("failing.py").write_text("def act(observation):\n    raise KeyError('position')\n")
    with pytest.raises(EvaluationError, match="failed, so no result is kept"):
        magical_mj.evaluate("failing:act", out="out", **SMALL)
    with open_scores(Path("out")), pytest.raises(EvaluationError, match="another evaluation"):
        magical_mj.evaluate("noop", out="out", **SMALL)
    assert len(magical_mj.evaluate("noop", out="out", **SMALL)) == len(read(Path("out"))) == 6
    assert len(magical_mj.evaluate("noop", out="out", resume=True, **SMALL)) == 6


def test_settings_are_those_of_the_evaluation_that_plays(tmp_path: Path) -> None:
    """It must not use the settings of another evaluation that was prepared in the folder meanwhile."""
    first, second = (
        Evaluation("noop", EvaluationSettings(out=tmp_path, **{**SMALL, "episodes": count})) for count in (2, 1)
    )
    list(first.play())
    with pytest.raises(SettingsError, match="holds the scenes 0 to 1 of its split, but 0 to 0 are requested"):
        list(second.play())
    assert len(read(tmp_path)) == 4
    assert read_settings(tmp_path)["episodes"] == 2


def test_an_evaluation_grows_in_every_direction(tmp_path: Path) -> None:
    """Adds episodes, tasks, variants and policies. The result is that of a single evaluation."""
    grown = {**SMALL, "tasks": "MoveToRegion,FixColour", "variants": "Demo,Layout,Jitter", "episodes": 4}
    magical_mj.evaluate("random", out=tmp_path / "grown", first_seed=1, **SMALL)
    played: list[EpisodeResult] = []
    magical_mj.evaluate("random,still=noop", out=tmp_path / "grown", resume=True, watch=played.append, **grown)
    magical_mj.evaluate("random,still=noop", out=tmp_path / "whole", **grown)
    assert rows(tmp_path / "grown") == rows(tmp_path / "whole")
    assert len(played) == len(rows(tmp_path / "whole")) - 6
    assert read_settings(tmp_path / "grown") == read_settings(tmp_path / "whole")


class Away(agents.Acting):
    """Fails in the scenes of odd seeds, like a client of a server that is sometimes unavailable."""

    def __init__(self) -> None:
        super().__init__(reset=self._ask)
        self.away = True

    def _ask(self, episode: Episode) -> None:
        if self.away and episode.seed % 2:
            raise ConnectionRefusedError("away")


def test_failed_episodes_are_played_again(tmp_path: Path) -> None:
    """If requested. The failed rows stay in the file, and the new rows count the retries."""
    policy, settings = Away(), {**SMALL, "variants": "Demo", "episodes": 4, "jobs": 1}
    magical_mj.evaluate({"P": policy}, out=tmp_path, **settings)
    first = (tmp_path / SCORES).read_bytes()
    assert [score.seed for score in read(tmp_path) if score.failure] == [1, 3]
    again = {"out": tmp_path, "resume": True, "retry_failed": True, **settings}
    magical_mj.evaluate({"P": policy}, **again)
    assert sorted((score.seed, score.retry) for score in read(tmp_path)) == [(0, 0), (1, 1), (2, 0), (3, 1)]
    policy.away = False
    frame = magical_mj.evaluate({"P": policy}, **again)
    assert frame["retry"].tolist() == [0, 2, 0, 2]
    assert frame["failure"].isna().all()
    assert (tmp_path / SCORES).read_bytes().startswith(first)
    assert sorted(read(tmp_path), key=lambda score: score.key) == sorted(
        (score for score in Evaluation({"P": policy}, EvaluationSettings(**again)).scores), key=lambda score: score.key
    )
    count = (tmp_path / SCORES).read_bytes().count(b"\n")
    magical_mj.evaluate({"P": policy}, **again)
    assert (tmp_path / SCORES).read_bytes().count(b"\n") == count == 8


def test_only_failed_episodes_can_be_replaced(tmp_path: Path) -> None:
    done, failed = replace(TEMPLATE, seed=0), replace(TEMPLATE, seed=1, failure="no")
    write(tmp_path, [done, failed, replace(failed, retry=1), replace(failed, retry=2, failure=None)])
    assert read(tmp_path) == [done, replace(failed, retry=2, failure=None)]
    for wrong, problem in (
        (replace(done, retry=1), "line 1: the episode did not fail, so no line can replace it"),
        (failed, "line 4: the same episode as line 2"),
        (replace(failed, retry=2), "line 4: the same episode as line 3"),
    ):
        write(tmp_path, [done, failed, replace(failed, retry=2), wrong])
        with pytest.raises(EvaluationError, match=problem):
            read(tmp_path)


def test_a_file_of_settings_that_is_not_ours_is_kept(tmp_path: Path) -> None:
    (tmp_path / SETTINGS).write_text('{"mine": 1}')
    with pytest.raises(EvaluationError, match=r"run\.json does not belong to an evaluation"):
        magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    assert [path.read_text() for path in tmp_path.iterdir()] == ['{"mine": 1}']


def killed_and_resumed(folder: Path) -> set[tuple[Any, ...]]:
    """The rows of an evaluation by two processes that was killed at a random moment before its end."""
    command = [sys.executable, "-m", "magical_mj", "evaluate", "--policy", "random,tests.helpers.agents:Slow"]
    command += ["--tasks", "MoveToRegion", "--variants", "Demo,Layout", "--episodes", "15", "--jobs", "2", "--resume"]
    command += ["--out", str(folder)]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, start_new_session=True)
    start = time.monotonic()
    while not ((folder / SCORES).exists() and (folder / SCORES).stat().st_size) and time.monotonic() - start < 60:
        time.sleep(0.01)
    time.sleep(random.uniform(0, 0.3))
    assert process.poll() is None, "it ended before it could be killed"
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=True)
    return rows(folder)


def test_finished_episodes_of_a_terminated_run_are_stored(tmp_path: Path) -> None:
    """Each result is written when it is finished, without waiting for the others of its worker."""
    command = [sys.executable, "-m", "magical_mj", "evaluate", "--policy", "tests.helpers.agents:Slower", "--jobs", "2"]
    command += ["--tasks", "MoveToRegion", "--variants", "Demo", "--episodes", "60", "--out", str(tmp_path)]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        start = time.monotonic()
        while not (tmp_path / SCORES).exists() or (tmp_path / SCORES).read_bytes().count(b"\n") < 4:
            assert time.monotonic() - start < 60
            assert process.poll() is None
            time.sleep(0.01)
        process.terminate()
    assert 4 <= len(read(tmp_path)) < 12
    assert {score.steps for score in read(tmp_path)} == {40}


@pytest.mark.slow
def test_killed_runs_end_with_the_same_rows(tmp_path: Path) -> None:
    settings = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 15, "jobs": 1}
    whole = magical_mj.evaluate("random,Slow=noop", out=tmp_path / "whole", **settings)  # acts the same, but faster
    resumed = killed_and_resumed(tmp_path / "killed")
    assert len(resumed) == len(whole) == 60
    assert resumed == rows(tmp_path / "whole")


class Drawn:
    """A policy whose actions are random, and that cannot be copied."""

    def __init__(self, **offsets: int) -> None:
        self.offsets, self.lock = offsets, threading.Lock()

    def reset(self, episode: Episode) -> None:
        self.rng, self.offset = episode.rng(), self.offsets.get(episode.variant, 0)

    def __call__(self, _: Any) -> int:
        return (int(self.rng.integers(18)) + self.offset) % 18


def test_an_object_continues_only_the_evaluation_of_an_equal_one(tmp_path: Path) -> None:
    """Otherwise one name would have the scores of two policies; or, if nothing is left to play, those of the other."""
    few: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Jitter", "out": tmp_path, "jobs": 1}
    first = magical_mj.evaluate(Drawn(), episodes=2, **few)
    for other, episodes in product((Drawn(Demo=1, Jitter=1), Drawn(Jitter=1)), (2, 3)):
        with pytest.raises(SettingsError, match="holds episodes of another policy named Drawn"):
            magical_mj.evaluate(other, episodes=episodes, resume=True, **few)
    assert len(read(tmp_path)) == 4
    assert magical_mj.evaluate(Drawn(), episodes=2, resume=True, **few).equals(first)
    assert len(magical_mj.evaluate(Drawn(), episodes=3, resume=True, **few)) == 6
    plain: Any = lambda _: 4  # noqa: E731
    magical_mj.evaluate({"A": plain}, episodes=1, **{**few, "out": tmp_path / "plain"})
    others: list[Any] = [lambda _: 5, lambda _: int(np.random.default_rng().integers(18))]
    for other in others:
        with pytest.raises(SettingsError, match="another policy named A"):
            magical_mj.evaluate({"A": other}, episodes=1, resume=True, **{**few, "out": tmp_path / "plain"})
