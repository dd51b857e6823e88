"""robomimic: a policy learns from our HDF5 file by its loader. Its algorithms import torchvision."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj.actions import NOOP, to_discrete, to_vector
from magical_mj.exports.robomimic import to_robomimic
from tests.helpers.cloning import cloned, network
from tests.helpers.libraries import EPISODES, TASK, compare, returns

pytest.importorskip("robomimic", reason="robomimic is missing: make integrations-test LIBRARY=robomimic")

from robomimic.utils.dataset import SequenceDataset
from robomimic.utils.obs_utils import initialize_obs_utils_with_obs_specs

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_a_policy_learns_from_our_file_by_its_loader(
    record_property: Callable[[str, object], None], tmp_path: Path
) -> None:
    demonstrations = magical_mj.demos.load(TASK)
    to_robomimic(demonstrations, tmp_path / "data.hdf5", views="state")
    initialize_obs_utils_with_obs_specs({"obs": {"low_dim": ["state"]}})
    data = SequenceDataset(str(tmp_path / "data.hdf5"), ("state",), ("actions",), load_next_obs=False)
    rows = [data[number] for number in range(len(data))]
    states = np.concatenate([row["obs"]["state"] for row in rows])
    actions = np.array([to_discrete(row["actions"][0]) for row in rows])
    wanted: Any = magical_mj.demos.transitions(demonstrations, "State", drop_noop=False).observations
    order = np.lexsort(states.T), np.lexsort(wanted.T)  # its episodes are sorted by name
    np.testing.assert_array_equal(states[order[0]], wanted[order[1]])
    moving = np.flatnonzero(actions != NOOP)
    draw = torch.Generator().manual_seed(0)

    def batches() -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        for _ in range(1500):
            chosen = moving[torch.randint(len(moving), (64,), generator=draw)]
            yield torch.from_numpy(states[chosen]), torch.from_numpy(actions[chosen])

    act = cloned(batches(), network(states.shape[1]))
    compare(
        record_property,
        "a network on its `SequenceDataset` of our file, whose rows are those of `demos.transitions`",
        lambda env: [returns(env, act) for _ in range(EPISODES)],
        act,
    )


def test_its_loader_reads_stacks_and_sequences(tmp_path: Path) -> None:
    two = magical_mj.demos.load("FixColour")[:2]
    to_robomimic(two, tmp_path / "set.hdf5")
    initialize_obs_utils_with_obs_specs({"obs": {"rgb": ["ego_image"]}})
    read = SequenceDataset(
        str(tmp_path / "set.hdf5"), ("ego_image",), ("actions", "rewards", "dones"), frame_stack=4, seq_length=8
    )
    assert len(read) == 120
    item = read[61]  # the second step of the second demonstration
    assert item["obs"]["ego_image"].shape == (11, 96, 96, 3)
    wanted = magical_mj.demos.observations(two[1], "LoResFingers")["ego"]
    np.testing.assert_array_equal(item["obs"]["ego_image"][3], wanted[1])
    np.testing.assert_array_equal(item["actions"][3:], to_vector(two[1].actions[1:9]))
