"""Comparisons of two policies, by hand."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.reports.results import choose, compare
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.tasks.registry import Pair
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.evaluations import TEMPLATE, example, write


def side(folder: Path, values: dict[Pair, list[float]], run: int = 0) -> list[EpisodeResult]:
    return [
        replace(TEMPLATE, policy=folder.name, run=run, task=task, variant=variant, seed=seed, score=value)
        for (task, variant), scores in values.items()
        for seed, value in enumerate(scores)
    ]


def test_comparison_is_paired_by_scene(tmp_path: Path) -> None:
    """By hand: FindDupe differs by 0.5, -0.5, 0.5 and MakeLine by 0, 0.3; the scene that one has alone is left out."""
    a, b = tmp_path / "a", tmp_path / "b"
    write(a, side(a, {("FindDupe", "Demo"): [1.0, 0.0, 0.5, 1.0], ("MakeLine", "Demo"): [0.5, 0.5]}))
    write(b, side(b, {("FindDupe", "Demo"): [0.5, 0.5, 0.0], ("MakeLine", "Demo"): [0.5, 0.2]}))
    demo, every = compare(a, b).to_dict("records")
    assert {**demo, "variant": every["variant"]} == every
    assert demo["variant"] == "Demo"
    assert demo["first"] == pytest.approx((0.5 + 0.5) / 2)
    assert demo["second"] == pytest.approx((1 / 3 + 0.35) / 2)
    assert demo["difference"] == pytest.approx((0.5 / 3 + 0.15) / 2)
    assert demo["low"] < demo["difference"] < demo["high"]
    assert [demo[name] for name in ("better", "worse", "scenes", "environments", "unpaired")] == [3, 1, 5, 2, 1]


def test_comparison_averages_runs_first(tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    runs = [side(a, {("FindDupe", "Demo"): values}, run) for run, values in enumerate(([1.0, 0.0], [0.0, 1.0]))]
    write(a, [*runs[0], *runs[1]])
    write(b, side(b, {("FindDupe", "Demo"): [0.5, 0.25]}))
    row = compare(a, b).iloc[0]
    assert (row["first"], row["second"], row["better"], row["worse"]) == (0.5, 0.375, 1, 0)


def test_means_of_the_same_scores_are_equal(tmp_path: Path) -> None:
    """Whatever the order of the runs does to their last digit."""
    for name, order in (("a", (1 / 3, 1.0, 1.0)), ("b", (1.0, 1.0, 1 / 3))):
        folder = tmp_path / name
        runs = [side(folder, {("FindDupe", "Demo"): [score]}, run) for run, score in enumerate(order)]
        write(folder, [score for run in runs for score in run])
    assert np.mean([1 / 3, 1, 1]) != np.mean([1, 1, 1 / 3])
    assert tuple(compare(tmp_path / "a", tmp_path / "b").iloc[0][["better", "worse"]]) == (0, 0)


def test_equal_policies_do_not_differ(tmp_path: Path) -> None:
    folder = write(tmp_path, example())
    table = compare(f"{folder}:noop", f"{folder}:noop")
    assert (table[["difference", "low", "high"]] == 0).all(axis=None)


def test_names_of_policies_and_folders_may_hold_colons(tmp_path: Path) -> None:
    folder = write(tmp_path / "at:noon", [replace(score, policy=f"{score.policy}:v2") for score in example()])
    assert choose(f"{folder}:noop:v2")[0] == "noop:v2"
    with pytest.raises(SettingsError, match="name one of them"):
        choose(folder)
    with pytest.raises(EvaluationError, match="gone:noop holds no scores"):
        choose("gone:noop")


def test_comparisons_need_names_and_common_scenes(tmp_path: Path) -> None:
    folder = write(tmp_path / "many", example())
    with pytest.raises(SettingsError, match="holds BC_4 & more, noop: name one of them, as in "):
        compare(folder, folder)
    with pytest.raises(SettingsError, match="name one of them"):
        compare(f"{folder}:nobody", folder)
    other = write(tmp_path / "other", [replace(TEMPLATE, seed=99)])
    with pytest.raises(EvaluationError, match="no scene in common"):
        compare(f"{folder}:noop", other)


@pytest.mark.parametrize("different", [{"rules": "released"}, {"worlds": "batched"}])
def test_scores_of_different_kinds_are_not_compared(different: dict[str, Any], tmp_path: Path) -> None:
    """By other rules, or in batched worlds."""
    one = write(tmp_path / "one", example())
    other = write(tmp_path / "other", [replace(score, **different) for score in example()])
    with pytest.raises(EvaluationError, match=f"different {next(iter(different))}"):
        compare(f"{one}:noop", f"{other}:noop")


def test_scores_in_different_worlds_are_not_compared(tmp_path: Path) -> None:
    """A protocol draws other scenes from the same seeds; older files do not say which scenes they were."""
    one, other, older = (
        write(tmp_path / str(scene), [replace(TEMPLATE, policy=str(scene), scene=scene)]) for scene in ("a", "b", None)
    )
    with pytest.raises(EvaluationError, match="different scenes in FindDupe Demo, seed 0: a in a, b in b"):
        compare(one, other)
    assert compare(one, older)["scenes"].tolist() == [1, 1]
    with pytest.raises(EvaluationError, match=r"different scenes in FindDupe Demo, seed 0: a in .*a, b in .*b;"):
        report([one, older, other], tmp_path / "out")
