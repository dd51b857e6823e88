"""pretraining.py: what it trains on, and that it continues; the table of its scores; encoders.py."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path
from typing import cast

import numpy as np
import pytest
import torch

from magical_mj import TASKS, demos
from magical_mj.learners import load_settings
from magical_mj.learners.encoder import Encoder, load_encoder
from magical_mj.tasks.registry import SPLITS
from tests.helpers.commands import Shell
from tools import pretraining
from tools.research import encoders
from tools.research.pretraining import TRAINED_IN, Run, demonstrations, main, others, started

BUDGET = ("--seeds", "1", "--scenes", "1", "--batches", "3", "--variants", "Demo,Layout", "--episodes", "2")


def test_pretraining_goes_on_and_its_scores_are_kept(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["--out", str(tmp_path), "--held-out", "MoveToRegion", "--tasks", "0,1", *BUDGET]
    main(command)
    printed = capsys.readouterr().out
    assert "Demo" in printed
    assert "Layout" in printed
    scores = tmp_path / "scores.jsonl"
    *first, last = scores.read_text().splitlines(keepends=True)
    scores.write_text("".join(first))
    main(command)
    assert scores.read_text() == "".join([*first, last])  # the missing run is made again, with equal scores
    rows = [json.loads(line) for line in (*first, last)]
    assert [(row["start"], row["tasks"], row["pretraining"], row["batches"]) for row in rows] == [
        ("scratch", 0, 0, 3),
        ("scratch", 0, 0, 9),  # the control
        ("cloning", 1, 6, 3),
    ]
    pretraining.collect([tmp_path], tmp_path / "pretraining.csv")
    kept = pretraining.stored(tmp_path / "pretraining.csv")
    assert len(kept) == 3
    start = pretraining.Start("State", "cloning", 1, 3)
    assert np.array_equal(kept[start]["MoveToRegion", "Layout"], [rows[2]["scores"]["Layout"]])
    with pytest.raises(ValueError, match="has a run twice"):
        pretraining.collect([tmp_path, tmp_path], tmp_path / "again.csv")
    scores.write_text("".join([*first, last.replace('"seed": 0', '"seed": 1')]))
    with pytest.raises(ValueError, match="lacks the runs"):
        pretraining.collect([tmp_path], tmp_path / "again.csv")


def test_pretraining_sees_every_variant_of_other_tasks_in_dev_scenes_only(tmp_path: Path) -> None:
    for seed in range(5):
        assert len({*others("FixColour", 7, seed), "FixColour"}) == len(TASKS)
        assert others("FixColour", 7, seed)[:3] == others("FixColour", 3, seed)
    found = demonstrations("MoveToRegion", 1, tmp_path / "experts.jsonl")
    assert [demo.variant for demo in found] == ["Demo", "Jitter", "Layout", "Colour", "Dynamics", "All"]
    assert {demo.scene_seed for demo in found} == {SPLITS["dev"] + TRAINED_IN}
    assert {demo.score for demo in found} == {1.0}


@pytest.mark.weekly
def test_an_encoder_declares_its_scenes_and_is_used(
    shell: Shell, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    played = "--tasks MoveToRegion,FixColour --variants Demo,Layout --steps 40 --jobs 1 --out episodes"
    assert shell("demos", "rollouts", *played.split())[0] == 0
    learnt_from = ["episodes", "--without", "FixColour", "--objective", "next"]
    paths = [tmp_path / f"{batches}.safetensors" for batches in (0, 2)]
    for path in paths:
        encoders.main([*learnt_from, "--batches", path.stem, "--out", str(path)])
    settings = [load_settings("bc", "FixColour", quick=True, **{"bc.encoder": path}) for path in paths]
    random, learnt = (cast("Encoder", load_encoder(one)) for one in settings)
    assert learnt.played_in == random.played_in == "Demo,Layout"
    assert (learnt.tasks, learnt.demonstration_set) == (["MoveToRegion"], 0)
    assert not torch.equal(learnt.weights["0.weight"], random.weights["0.weight"])
    averages = [values for name, values in random.weights.items() if name.endswith("running_mean")]
    assert all(values.any() for values in averages)
    assert encoders.description(paths[0])["start"] == "untrained"

    command = ["--out", str(tmp_path), "--preset", "LoRes4E", "--encoder", str(paths[1]), *BUDGET]
    main([*command, "--held-out", "FixColour"])
    row = json.loads((tmp_path / "scores.jsonl").read_text())
    assert (row["start"], row["tasks"], row["pretraining"]) == ("next-random", 1, 2)
    assert row["learnt"] == encoders.description(paths[1])["explained"]
    with pytest.raises(SystemExit):
        main([*command, "--held-out", "FixColour,MoveToRegion"])
    assert "learnt from episodes of MoveToRegion" in capsys.readouterr().err


def test_pretraining_is_the_start_of_a_policy_from_pictures(tmp_path: Path) -> None:
    options = argparse.Namespace(preset="LoRes4E", encoder=None, scenes=1, out=tmp_path)
    runs = [Run("MoveToRegion", "scratch", 0, 0, 3, 0), Run("MoveToRegion", "cloning", 1, 3, 3, 0)]
    (new, nothing), (pretrained, accuracy) = (started(run, options) for run in runs)
    assert nothing is None
    assert accuracy is not None
    norms = [learner.actor.torso.state_dict()["convolutions.1.running_mean"] for learner in (new, pretrained)]
    assert not norms[0].any()
    assert norms[1].any()


def test_inverse_dynamics_learns_which_action_leads_to_the_next_observation() -> None:
    """In one episode. The most frequent action is half of them."""
    assert np.mean([one["accuracy"] for one in learnt_in_one_episode("inverse", 60)]) > 0.75


@pytest.mark.weekly
def test_the_next_frame_is_predicted_better_than_by_the_last_one() -> None:
    """In one episode."""
    assert np.mean([one["explained"] for one in learnt_in_one_episode("next", 150)]) > 0.2


def learnt_in_one_episode(objective: str, batches: int) -> list[Mapping[str, float]]:
    """The metrics of the last 20 batches."""
    changes = {"bc.batch_size": 16, "bc.learning_rate": 3e-3, "network.first_channels": 8}
    settings = load_settings(
        "bc", "MoveToRegion", quick=True, augment="none", device="cpu", **changes, **{"bc.batches": batches}
    )
    learner = encoders.OBJECTIVES[objective](settings, {"MoveToRegion": demos.load("MoveToRegion")[:1]})
    return [learner.update() for _ in range(batches)][-20:]
