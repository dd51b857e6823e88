"""tools/research/pretraining.py: what it trains on, and that it continues; the table of its scores."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from magical_mj import TASKS
from magical_mj.tasks.registry import SPLITS
from tools import pretraining
from tools.research.pretraining import TRAINED_IN, demonstrations, main, others

BUDGET = ("--scenes", "1", "--pretraining", "3", "--batches", "3", "--variants", "Demo,Layout", "--episodes", "2")


def test_pretraining_goes_on_and_its_scores_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--out", str(tmp_path), "--held-out", "MoveToRegion", "--tasks", "0,1", "--seeds", "1", *BUDGET]
    main(command)
    printed = capsys.readouterr().out
    assert "Demo" in printed
    assert "Layout" in printed
    scores = tmp_path / "scores.jsonl"
    first, second = scores.read_text().splitlines(keepends=True)
    scores.write_text(first)
    main(command)
    assert scores.read_text() == first + second  # the missing run is made again, with equal scores
    rows = [json.loads(line) for line in (first, second)]
    assert [row["tasks"] for row in rows] == [0, 1]
    pretraining.collect(tmp_path, tmp_path / "pretraining.csv")
    kept = pretraining.stored(tmp_path / "pretraining.csv")
    assert len(kept) == 4
    assert np.array_equal(kept[1, "MoveToRegion", "Layout"], [rows[1]["scores"]["Layout"]])


def test_pretraining_sees_every_variant_of_other_tasks_in_dev_scenes_only(tmp_path: Path) -> None:
    for seed in range(5):
        assert len({*others("FixColour", 7, seed), "FixColour"}) == len(TASKS)
        assert others("FixColour", 7, seed)[:3] == others("FixColour", 3, seed)
    found = demonstrations("MoveToRegion", 1, tmp_path / "experts.jsonl")
    assert [demo.variant for demo in found] == ["Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"]
    assert {demo.scene_seed for demo in found} == {SPLITS["dev"] + TRAINED_IN}
    assert {demo.score for demo in found} == {1.0}
