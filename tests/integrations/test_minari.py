"""Minari: a policy learns from a data set in its format, and plays in the environment that the data set recovers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj.actions import NOOP
from magical_mj.exports.minari import to_minari
from tests.helpers.cloning import cloned, network
from tests.helpers.libraries import EPISODES, TASK, compare, returns

pytest.importorskip("minari", reason="minari is missing: make integrations-test LIBRARY=minari")

import minari

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


@pytest.mark.weekly
def test_a_policy_learns_from_a_data_set(
    record_property: Callable[[str, object], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    data = minari.load_dataset(to_minari(magical_mj.demos.load(TASK)))
    data.set_seed(0)

    def batches() -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
        for _ in range(1500):
            parts = data.sample_episodes(3)
            states = np.concatenate([episode.observations[:-1] for episode in parts])
            actions = np.concatenate([episode.actions for episode in parts])
            moving = actions != NOOP
            yield torch.from_numpy(states[moving]), torch.from_numpy(actions[moving])

    env: Any = data.recover_environment()
    act = cloned(batches(), network(env.observation_space.shape[0]))
    demonstration = data[0]
    env.reset(seed=next(iter(data.storage.get_episode_metadata([0])))["seed"])
    scored = [env.step(int(action))[1] for action in demonstration.actions]
    np.testing.assert_array_equal(scored, demonstration.rewards)
    compare(
        record_property,
        "a network on sampled episodes; episodes replay in the recovered environment",
        lambda env: [returns(env, act) for _ in range(EPISODES)],
        act,
    )
