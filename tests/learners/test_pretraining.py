"""pretraining.py: what it trains on, and that it continues; the table of its scores; inverse_dynamics.py."""

from __future__ import annotations

import json
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
from tools.research import inverse_dynamics
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


def test_an_encoder_of_inverse_dynamics_declares_its_scenes_and_is_used(shell: Shell, tmp_path: Path) -> None:
    episodes = "--tasks MoveToRegion --variants Demo,Layout --steps 40 --jobs 1 --out episodes"
    assert shell("demos", "rollouts", *episodes.split())[0] == 0
    for batches in (0, 2):
        inverse_dynamics.main(["episodes", "--batches", str(batches), "--out", f"{batches}.safetensors"])
    settings = [load_settings("bc", "FixColour", quick=True, **{"bc.encoder": f"{n}.safetensors"}) for n in (0, 2)]
    random, learnt = (cast("Encoder", load_encoder(one)) for one in settings)
    assert learnt.played_in == random.played_in == "Demo,Layout"
    assert (learnt.tasks, learnt.demonstration_set) == (["MoveToRegion"], 0)
    assert not torch.equal(learnt.weights["0.weight"], random.weights["0.weight"])
    averages = [values for name, values in random.weights.items() if name.endswith("running_mean")]
    assert all(values.any() for values in averages)


def test_inverse_dynamics_learns_which_action_leads_to_the_next_observation() -> None:
    """In one episode. The most frequent action is half of them."""
    episode = {"MoveToRegion": demos.load("MoveToRegion")[:1]}
    changes = {"bc.batches": 60, "bc.batch_size": 16, "bc.learning_rate": 3e-3, "network.first_channels": 8}
    learner = inverse_dynamics.InverseDynamics(
        load_settings("bc", "MoveToRegion", quick=True, augment="none", device="cpu", **changes), episode
    )
    found = [learner.update() for _ in range(learner.updates)]
    assert np.mean([one["accuracy"] for one in found[-20:]]) > 0.75
