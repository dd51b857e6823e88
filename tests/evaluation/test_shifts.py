"""Evaluations with shifts: strength 0 beside them in the same scenes, equal however they are played, and replayed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from magical_mj.evaluation.reports.results import compare
from magical_mj.evaluation.scores import EpisodeResult, read_settings
from magical_mj.leaderboard import verify
from magical_mj.utils.errors import SettingsError, UnknownNameError
from tests.helpers import agents
from tests.helpers.commands import Shell
from tests.helpers.evaluations import TEMPLATE, evaluate, rows, write

SHIFTED: dict[str, Any] = {"variants": "Demo", "shifts": "latency:4-5,camera:2+latency:1"}
LABELS = ["", "latency:4", "latency:5", "camera:2+latency:1"]


def test_strength_0_is_played_beside_shifts_and_is_as_without_them() -> None:
    shifted = evaluate("random", **SHIFTED)
    assert sorted(set(shifted["shift"])) == sorted(LABELS)
    assert {tuple(group["seed"]) for _, group in shifted.groupby("shift")} == {(0, 1, 2)}
    plain = shifted[shifted["shift"] == ""].reset_index(drop=True)
    pd.testing.assert_frame_equal(plain, evaluate("random", variants="Demo"), check_dtype=False)
    assert shifted.groupby("seed")["actions"].nunique().eq(1).all()  # who looks at nothing does the same


@pytest.mark.parametrize("how", [{"envs": 3, "jobs": 1}, {"jobs": 2}])
def test_shifted_scores_do_not_depend_on_how_they_are_played(how: dict[str, int]) -> None:
    alone = evaluate(agents.Counting, jobs=1, **SHIFTED)
    pd.testing.assert_frame_equal(alone, evaluate(agents.Counting, **how, **SHIFTED))


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


def test_comparisons_pair_shifts(tmp_path: Path) -> None:
    for name, value in (("a", 1.0), ("b", 0.25)):
        scores = [replace(TEMPLATE, policy=name, seed=seed, score=value) for seed in range(3)]
        write(tmp_path / name, [replace(score, shift=shift) for score in scores for shift in LABELS])
    table = compare(tmp_path / "a", tmp_path / "b").set_index("variant")
    assert list(table.index) == ["Demo", "Demo camera:2+latency:1", "Demo latency:4", "Demo latency:5", "all of them"]
    assert set(table["scenes"]) == {3}
    assert set(table["difference"]) == {0.75}


@pytest.mark.parametrize(
    ("shifts", "problem"),
    [
        ("camra", "Did you mean 'camera'"),
        ("camera:6", "from 0 .* to 5, not"),
        ("camera:-1", "from 0 .* to 5, not"),
        ("camera:2.5", "from 0 .* to 5, not"),
        ("camera:3-1", "has no strengths"),
        ("camera:1+camera:2", "given twice"),
    ],
)
def test_wrong_shifts_are_explained(shifts: str, problem: str, shell: Shell, tmp_path: Path) -> None:
    with pytest.raises((SettingsError, UnknownNameError), match=problem):
        evaluate("noop", shifts=shifts)
    shell.fails(2, "evaluate", "--policy", "noop", "--out", "o", "--shifts", shifts)
    assert not (tmp_path / "o").exists()


def test_batched_worlds_refuse_them() -> None:
    with pytest.raises(SettingsError, match="batched worlds have neither shifts nor wrappers"):
        evaluate("noop", simulator="warp", shifts="camera")
