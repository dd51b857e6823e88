"""All methods: a seed decides everything, and a training that went on ends as if it had not been interrupted."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from magical_mj.learners import METHODS, checkpoint, load_settings, redraw
from tests.helpers.learners import PLAYING, RELATIONAL, TINY

TWO = {"tasks": "MoveToRegion,FixColour", "preset": "State"}
TRAININGS: list[tuple[str, dict[str, Any]]] = [
    ("bc", {}),
    ("bc", TWO),
    ("iq-learn", TWO),
    ("gail", {}),
    ("point", {}),
    ("gail", TWO),
    ("airl", TWO),
    ("wgail-gp", TWO),
    ("al", TWO),
    ("relational", {"preset": "State", "relational.assumptions": "egocentric,mirror", "relational.trial": 2}),
    ("redraw", {"relational.assumptions": "egocentric"}),
]


@pytest.fixture(autouse=True)
def small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redraw, "POOL", 16)
    monkeypatch.setattr(redraw, "BATCHES", 2)


def made(method: str, changes: dict[str, Any], seed: int = 0) -> Any:
    """A learner whose training takes a second; also where weights and optimizers differ in their memory layout."""
    changes = {"tasks": "MoveToRegion", **TINY, **PLAYING, **RELATIONAL, "bc.batches": 4, "bc.batch_size": 4, **changes}
    quick = changes.get("preset") != "State"
    return METHODS[method](load_settings(method, seed=seed, quick=quick, **changes))


def weights(learner: Any) -> torch.Tensor:
    return torch.cat([values.detach().flatten() for values in learner.actor.parameters()])


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_resumed_training_ends_like_an_uninterrupted_one(
    method: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    """By way of a file, three updates before the end: in the middle of the episodes that are played.

    Nothing is drawn from global generators; metrics always have the same names, and are numbers.
    """
    whole, resumed = made(method, changes), made(method, changes)
    before = torch.get_rng_state(), np.random.get_state()[1]  # noqa: NPY002
    metrics: list[dict[str, float]] = []
    while len(metrics) < whole.updates:
        checkpoint.write(tmp_path / f"{len(metrics)}.safetensors", whole.get_state())
        metrics.append(whole.update())
    resumed.set_state(checkpoint.read(tmp_path / f"{len(metrics) - 3}.safetensors"))
    assert [resumed.update() for _ in range(3)] == metrics[-3:]
    for learner in (whole, resumed):
        checkpoint.write(tmp_path / f"{learner is whole}.safetensors", learner.get_state())
        learner.close()
    assert (tmp_path / "True.safetensors").read_bytes() == (tmp_path / "False.safetensors").read_bytes()
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
    assert len({tuple(row) for row in metrics}) == 1
    assert all(isinstance(value, float) and math.isfinite(value) for row in metrics for value in row.values())


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_equal_seeds_give_equal_weights(method: str, changes: dict[str, Any]) -> None:
    def trained(seed: int) -> torch.Tensor:
        learner = made(method, changes, seed)
        for _ in range(2):
            learner.update()
        learner.close()
        return weights(learner)

    first = trained(0)
    assert torch.equal(first, trained(0))
    assert not torch.equal(first, trained(1))
