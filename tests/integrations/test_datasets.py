"""Hugging Face datasets: it stores our arrays, and a policy learns from them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from tests.helpers.cloning import cloned, network
from tests.helpers.libraries import EPISODES, TASK, compare, returns

pytest.importorskip("datasets", reason="datasets is missing: make integrations-test LIBRARY=datasets")

import datasets

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_a_policy_learns_from_a_saved_data_set(record_property: Callable[[str, object], None], tmp_path: Path) -> None:
    arrays = magical_mj.datasets.load(TASK, folder=tmp_path, preset="State")
    rows = {name: arrays[name] for name in ("observations", "actions")}
    datasets.Dataset.from_dict(rows).save_to_disk(tmp_path / "saved")
    data = datasets.load_from_disk(tmp_path / "saved").with_format("torch")
    states, actions = data["observations"][:], data["actions"][:]
    wanted = magical_mj.demos.transitions(magical_mj.demos.load(TASK), "State")
    np.testing.assert_array_equal(states, wanted.observations)
    np.testing.assert_array_equal(actions, wanted.actions)
    draw = torch.Generator().manual_seed(0)

    def batches() -> Iterator[tuple[Any, Any]]:
        for _ in range(1500):
            chosen = torch.randint(len(states), (64,), generator=draw)
            yield states[chosen], actions[chosen]

    act = cloned(batches(), network(states.shape[1]))
    compare(
        record_property,
        "a network on a saved `Dataset`, whose rows are those of `demos.transitions`",
        lambda env: [returns(env, act) for _ in range(EPISODES)],
        act,
    )
