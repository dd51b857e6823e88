"""Tianshou: its offline imitation learning."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch

from tests.helpers.cloning import network
from tests.helpers.libraries import EPISODES, compare, demonstrations

pytest.importorskip("tianshou", reason="tianshou is missing: make integrations-test LIBRARY=tianshou")

from tianshou.algorithm.algorithm_base import policy_within_training_step
from tianshou.algorithm.imitation.imitation_base import ImitationPolicy, OfflineImitationLearning
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Batch, Collector, ReplayBuffer
from tianshou.env import DummyVectorEnv

import magical_mj

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


class Actor(torch.nn.Module):
    """Values of actions and a state, as Tianshou expects."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.layers = network(size)

    def forward(self, obs: object, state: object = None, info: object = None) -> tuple[torch.Tensor, object]:
        return self.layers(torch.as_tensor(obs)), state


def test_offline_imitation_scores_the_same_by_both_paths(record_property: Callable[[str, object], None]) -> None:
    data, space = demonstrations(), magical_mj.MagicalEnv("MoveToRegion", "Demo", "State").action_space
    buffer = ReplayBuffer(len(data["actions"]))
    for row in range(len(data["actions"])):
        step = {name: data[key][row] for name, key in (("obs", "observations"), ("obs_next", "next_observations"))}
        ends = {"terminated": data["terminals"][row], "truncated": data["truncations"][row]}
        buffer.add(Batch(**step, **ends, act=int(data["actions"][row]), rew=0.0, info={}))
    actor = Actor(data["observations"].shape[1])
    policy = ImitationPolicy(actor=actor, action_space=space, action_bound_method=None)
    learner = OfflineImitationLearning(policy=policy, optim=AdamOptimizerFactory(lr=1e-3))
    np.random.seed(0)  # noqa: NPY002  (Tianshou's own draws)
    with policy_within_training_step(policy):
        for _ in range(1500):
            learner.update(buffer, 64)
    compare(
        record_property,
        "`OfflineImitationLearning` on our arrays; scores by `Collector`",
        lambda env: [
            Collector(policy, DummyVectorEnv([lambda: env])).collect(n_episode=1, reset_before_collect=True).returns[0]
            for _ in range(EPISODES)
        ],
        lambda state: int(policy(Batch(obs=state[None], info={})).act[0]),
    )
