"""Splits: the scenes of "dev" are not those of "test", and results of both are kept apart."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

import magical_mj
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.reports.results import compare
from magical_mj.evaluation.scores import read
from magical_mj.leaderboard import submit
from magical_mj.tasks.registry import ENVIRONMENTS, SPLITS, environment_axes, sample_scene
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.evaluations import SMALL, TEMPLATE, write

CONTINUOUS = {"jitter", "layout", "dynamics"}


def test_no_scene_of_dev_is_one_of_test() -> None:
    """In all environments whose scenes are drawn from a continuum; colours and shapes alone are few."""
    drawn = {}
    for task, variant in ENVIRONMENTS:
        if CONTINUOUS & set(environment_axes(task, variant)):
            digests = {
                name: {sample_scene(task, variant, first + number).digest() for number in range(count)}
                for (name, first), count in zip(SPLITS.items(), (100, 20), strict=True)
            }
            drawn[task, variant] = digests
            assert not digests["test"] & digests["dev"], (task, variant)
    assert {variant for _, variant in drawn} == {"Jitter", "Layout", "CountPlus", "Dynamics", "All"}


def test_dev_is_said_in_every_row_and_test_in_none(tmp_path: Path) -> None:
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
    with pytest.raises(EvaluationError, match="played on the split dev, and entries are of test"):
        submit([dev], tmp_path / "entry.json.xz")
    magical_mj.evaluate("noop", out=tmp_path / "grown", split="dev", **SMALL)
    with pytest.raises(SettingsError, match='split was "dev" and is "test"'):
        magical_mj.evaluate("noop", out=tmp_path / "grown", resume=True, **SMALL)
