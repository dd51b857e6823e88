"""Evaluations with shifts, compared with strength 0 in the same scenes; and splits, which are kept apart."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation.folder import read_settings
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.reports.results import compare, gather
from magical_mj.evaluation.reports.statistics import area, by_shift, curve, half_lost
from magical_mj.evaluation.scores import EpisodeResult, read
from magical_mj.leaderboard import submit, verify
from magical_mj.tasks.registry import ENVIRONMENTS, SPLITS, environment_axes, sample_scene
from magical_mj.utils.errors import EvaluationError, SettingsError, UnknownNameError, UntrustedNameError
from tests.helpers import agents
from tests.helpers.commands import Shell
from tests.helpers.evaluations import SMALL, TEMPLATE, evaluate, rows, write
from tests.xmagical.test_xmagical import WEDGE  # noqa: F401

SHIFTED: dict[str, Any] = {"variants": "Demo", "shifts": "latency:4-5,camera:2+latency:1"}
LABELS = ["", "latency:4", "latency:5", "camera:2+latency:1"]


def test_strength_0_is_played_beside_shifts_and_is_as_without_them() -> None:
    shifted = evaluate("random", **SHIFTED)
    assert sorted(set(shifted["shift"])) == sorted(LABELS)
    assert {tuple(group["seed"]) for _, group in shifted.groupby("shift")} == {(0, 1, 2)}
    plain = shifted[shifted["shift"] == ""].reset_index(drop=True)
    pd.testing.assert_frame_equal(plain, evaluate("random", variants="Demo"), check_dtype=False)
    assert shifted.groupby("seed")["actions"].nunique().eq(1).all()  # a policy without observations acts the same


def test_shifted_scores_do_not_depend_on_how_they_are_played() -> None:
    seen: dict[str, Any] = {**SHIFTED, "preset": "LoRes4E", "renderer": "software"}
    alone = evaluate({"look": agents.look}, jobs=1, **seen)
    assert alone.groupby("seed")["actions"].nunique().eq(len(LABELS)).all()  # who looks sees each of them
    for jobs in (1, 2):
        pd.testing.assert_frame_equal(alone, evaluate({"look": agents.Batch}, jobs=jobs, **seen))


def test_an_evaluation_grows_by_shifts_and_is_replayed(tmp_path: Path) -> None:
    evaluate("random", out=tmp_path, jobs=1, variants="Demo")
    played: list[EpisodeResult] = []
    evaluate("random", out=tmp_path, resume=True, watch=played.append, jobs=1, **SHIFTED)
    assert {score.shift for score in played} == set(LABELS) - {""}
    assert len(rows(tmp_path)) == 3 * len(LABELS)
    assert read_settings(tmp_path)["shifts"] == LABELS
    findings = verify(tmp_path, jobs=1)
    assert (findings.episodes, findings.differing) == (12, [])
    with pytest.raises(SettingsError, match="holds shifts that are left out here, or have changed: latency:4, "):
        evaluate("random", out=tmp_path, resume=True, variants="Demo")


def test_other_bodies_stand_beside_the_first_one_and_are_replayed(shell: Shell, tmp_path: Path) -> None:
    own = f"body:{__name__}:WEDGE"  # no other test names this module
    options = ("--tasks", "MoveToRegion", "--variants", "Demo", "--preset", "State", "--episodes", "2")
    shell("evaluate", "--policy", "random", *options, "--shifts", f"body,{own}", "--out", "out")
    assert Counter(score.shift for score in read(tmp_path / "out")) == dict.fromkeys(
        ["", "body:shortstick", "body:mediumstick", own], 2
    )
    shell("report", "out", "--out", "page")
    assert "| random | body:mediumstick | " in (tmp_path / "page" / "report.md").read_text()
    with pytest.raises(UntrustedNameError):
        verify(tmp_path / "out", jobs=1)
    assert verify(tmp_path / "out", jobs=1, trusted=[own.removeprefix("body:")]).differing == []


def test_comparisons_pair_shifts(tmp_path: Path) -> None:
    for name, value in (("a", 1.0), ("b", 0.25)):
        scores = [replace(TEMPLATE, policy=name, seed=seed, score=value) for seed in range(3)]
        write(tmp_path / name, [replace(score, shift=shift) for score in scores for shift in LABELS])
    table = compare(tmp_path / "a", tmp_path / "b").set_index("variant")
    assert list(table.index) == ["Demo", "Demo camera:2+latency:1", "Demo latency:4", "Demo latency:5", "all of them"]
    assert set(table["scenes"]) == {3}
    assert set(table["difference"]) == {0.75}


def test_reports_show_what_shifts_do(tmp_path: Path) -> None:
    """By hand: without a shift, two scenes score 1 and 0.5, and one of another task 0. Only run 1 plays the first."""
    scenes = {("FindDupe", 0): 1.0, ("FindDupe", 1): 0.5, ("MakeLine", 0): 0.0}
    kept = {0: 1.0, 1: 1.0, 2: 0.8, 3: 0.5, 4: 0.16, 5: 0.0}
    scores = [
        replace(TEMPLATE, task=task, seed=seed, score=score * share, shift=f"camera:{strength}" if strength else "")
        for (task, seed), score in scenes.items()
        for strength, share in kept.items()
    ]
    once = replace(TEMPLATE, run=1, seed=0, shift="", score=0.5)
    scores += [once, replace(once, shift="camera:3", score=0.0), replace(once, seed=7, shift="camera:3", score=1.0)]
    scores += [replace(TEMPLATE, task="FindDupe", seed=0, shift="camera:1+latency:2", score=0.25)]
    folder = write(tmp_path / "scores", scores)
    table = by_shift(gather([folder])).set_index("shift")
    assert table.loc["camera:2", ["without", "mean", "scenes", "environments"]].tolist() == pytest.approx(
        [0.375, 0.3, 3, 2]
    )
    assert table.loc["camera:3", ["without", "mean"]].tolist() == pytest.approx([0.3125, 0.09375])
    assert table.loc["camera:3", "scenes"] == 3  # the scene that was not played without the shift has no pair
    points = curve(table[table["axis"] == "camera"].reset_index())
    assert list(points) == [1, 2, 3, 4, 5]  # strength 3 was played in another run, too
    assert area({0: 1.0, 1: 1.0, 2: 0.5, 3: 0.5, 4: 0.0, 5: 0.0}) == pytest.approx(0.5)
    assert half_lost({0: 0.8, 1: 0.5, 2: 0.4, 3: 0.1}) == 2
    assert half_lost({0: 0.0, 1: 0.0}) is None
    page = report([folder], tmp_path / "out")
    text = page.read_text()
    assert "![Scores over the strength of each shift](shifts.png)" in text
    assert "| BC_4 & more | – | 0.38 | 0.30 | 0.09 | 0.06 | 0.00 | – | – |" in text  # noqa: RUF001
    assert "No value at strength 0: the strengths have different scenes." in text
    assert "| BC_4 & more | camera:1+latency:2 | 1.00 | 0.25 | -0.75 |" in text
    assert (tmp_path / "out" / "shifts.png").stat().st_size > 5000
    same = write(tmp_path / "same", [score for score in scores if score.run == 0])
    text = report([same], tmp_path / "whole").read_text()
    assert "| BC_4 & more | 0.38 | 0.38 | 0.30 | 0.19 | 0.06 | 0.00 | 0.22 | 3 |" in text
    assert "No value at strength 0" not in text
    write(tmp_path / "only", [score for score in scores if score.shift])
    with pytest.raises(EvaluationError, match="all episodes are shifted"):
        report([tmp_path / "only"], tmp_path / "none")


@pytest.mark.parametrize(
    ("shifts", "problem"),
    [
        ("camra", "Did you mean 'camera'"),
        ("camera:6", "from 0 .* to 5, not"),
        ("camera:-1", "from 0 .* to 5, not"),
        ("camera:2.5", "from 0 .* to 5, not"),
        ("camera:3-1", "contains no strengths"),
        ("camera:1+camera:2", "given twice"),
    ],
)
def test_wrong_shifts_are_explained(shifts: str, problem: str, shell: Shell, tmp_path: Path) -> None:
    with pytest.raises((SettingsError, UnknownNameError), match=problem):
        evaluate("noop", shifts=shifts)
    shell.fails(2, "evaluate", "--policy", "noop", "--out", "o", "--shifts", shifts)
    assert not (tmp_path / "o").exists()


def test_batched_worlds_refuse_them() -> None:
    with pytest.raises(SettingsError, match="batched environments support no shifts, wrappers"):
        evaluate("noop", simulator="warp", shifts="camera")


CONTINUOUS = {"jitter", "layout", "dynamics"}


def test_no_scene_of_another_split_is_one_of_test() -> None:
    """In all environments with continuous draws. Variants of only colours or shapes have few different scenes."""
    drawn = {}
    for task, variant in ENVIRONMENTS:
        if CONTINUOUS & set(environment_axes(task, variant)):
            digests = {
                name: {sample_scene(task, variant, first + number).digest() for number in range(count)}
                for (name, first), count in zip(SPLITS.items(), (100, 5, 5), strict=True)
            }
            drawn[task, variant] = digests
            assert not digests["test"] & (digests["dev"] | digests["fresh"]), (task, variant)
    assert {variant for _, variant in drawn} == {"Jitter", "Layout", "CountPlus", "Dynamics", "All"}


def test_every_row_of_the_dev_split_says_so(tmp_path: Path) -> None:
    frame = magical_mj.evaluate("noop", out=tmp_path / "dev", split="dev", first_seed=5, **SMALL)
    first = SPLITS["dev"] + 5
    assert sorted(set(frame["seed"])) == [first, first + 1, first + 2]
    assert {score.split for score in read(tmp_path / "dev")} == {"dev"}
    magical_mj.evaluate("noop", out=tmp_path / "test", **SMALL)
    assert "split" not in (tmp_path / "test" / "scores.jsonl").read_text()


def test_splits_are_not_mixed(tmp_path: Path) -> None:
    test = write(tmp_path / "test", [TEMPLATE])
    dev = write(tmp_path / "dev", [replace(TEMPLATE, policy="dev", split="dev", seed=SPLITS["dev"])])
    for mix in (lambda: report([test, dev], tmp_path / "out"), lambda: compare(test, dev)):
        with pytest.raises(EvaluationError, match=r"different split: test in .*, dev in "):
            mix()
    with pytest.raises(EvaluationError, match="played on the split dev, but entries must be played on test"):
        submit([dev], tmp_path / "entry.json.xz")
    magical_mj.evaluate("noop", out=tmp_path / "grown", split="dev", **SMALL)
    with pytest.raises(SettingsError, match='split was "dev" and is "test"'):
        magical_mj.evaluate("noop", out=tmp_path / "grown", resume=True, **SMALL)


RANDOM = """
import random
import numpy as np
from magical_mj.shifts import Shift

class Wheels(Shift):
    name = "wheels"
    def action(self, commands, step):
        return 0 if np.random.random() < 0.3 else commands[-1]

class Noise(Shift):
    name = "noise"
    def picture(self, picture, frame):
        return np.roll(picture, random.randrange(1, 9), axis=0)

class Count(Shift):
    name = "count"
    episodes = 0
    def scene(self, scene, rules):
        Count.episodes += 1
        return scene.moved(robot=(0, 0, Count.episodes))

class Steady(Shift):
    name = "steady"
    def action(self, commands, step):
        return 0 if self.uniform(step) < 0.3 else commands[-1]
"""


def test_shifts_that_use_global_randomness_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "drawn_at_random.py").write_text(RANDOM)
    play = partial(magical_mj.evaluate, tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1, split="dev")
    for shift, what in {"Wheels": "states", "Count": "initial scene"}.items():
        with pytest.raises(SettingsError, match=rf"{shift} is not repeatable: .* two episodes differ in their {what}"):
            play("noop", shifts=f"drawn_at_random:{shift}:2")
    with pytest.raises(SettingsError, match="differ in their pictures"):
        play(agents.look, preset="LoRes4E", renderer="software", shifts="drawn_at_random:Noise:2")
    play("noop", shifts="drawn_at_random:Steady:1-2")
