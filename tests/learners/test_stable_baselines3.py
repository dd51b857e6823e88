"""Our PPO against stable-baselines3's: the whole of its `learn`, with the same network, rewards and random numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
import pytest
import stable_baselines3
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor

from magical_mj.actions import ACTIONS
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import Actor, Heads
from magical_mj.learners.ppo import PPO, ActorCritic, even_minibatches
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.vector_envs import Step, TrainingEnvs, training_envs
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.interface import HISTORY
from tests.helpers.learners import playing


class TheirPolicy(BasePolicy):
    """Our networks, by the methods that stable-baselines3 calls."""

    def __init__(self, seen: spaces.Space, actions: spaces.Space, rate: Callable[[float], float], **own: Any) -> None:
        super().__init__(seen, actions)
        self.networks = ActorCritic(own["actor"], own["critic"])
        self.optimizer = torch.optim.Adam(self.parameters(), rate(1), fused=True)

    def outputs(self, observations: Mapping[str, Tensor]) -> tuple[Any, Tensor]:
        return self.networks(observations["seen"], observations["task"].long()[:, 0])

    def forward(self, observations: Mapping[str, Tensor], deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        distributions, values = self.outputs(observations)
        actions = distributions.sample()
        return actions, values, distributions.log_prob(actions)

    def evaluate_actions(self, observations: Mapping[str, Tensor], actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        distributions, values = self.outputs(observations)
        return values, distributions.log_prob(actions), distributions.entropy()

    def predict_values(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.outputs(observations)[1]

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        return self(observation)[0]


def breaking(settings: TrainingSettings) -> TrainingEnvs:
    """The environments of a training. Each end of the second task's episodes counts as a broken state."""
    environments = training_envs(settings)
    play = environments.step

    def step(actions: NDArray[np.int64]) -> Step:
        outcome = play(actions)
        return outcome._replace(broken=outcome.ended & (environments.tasks == 1))

    environments.step = step  # type: ignore[method-assign]
    return environments


class TheirEnvs(VecEnv):
    """The environments of a training, with rewards that depend on the number of the step only."""

    render_mode = None

    def __init__(self, environments: TrainingEnvs, rewards: NDArray[np.float32]) -> None:
        self.environments, self.rewards = environments, iter(rewards)
        self.task = environments.tasks[:, None].astype(np.float32)
        histories = spaces.Box(-np.inf, np.inf, (HISTORY, len(STATE_NAMES)))
        super().__init__(
            len(self.task),
            spaces.Dict({"seen": histories, "task": spaces.Box(0, 9, (1,))}),
            spaces.Discrete(len(ACTIONS)),
        )

    def observations(self, seen: NDArray[Any]) -> dict[str, NDArray[Any]]:
        return {"seen": seen, "task": self.task}

    def reset(self) -> Any:
        return self.observations(self.environments.reset())

    def step_async(self, actions: NDArray[np.int64]) -> None:
        self.actions = actions

    def step_wait(self) -> Any:
        step = self.environments.step(self.actions)
        infos: list[dict[str, Any]] = [{} for _ in self.task]
        for n in np.flatnonzero(step.ended):
            last = {"seen": step.last[n], "task": self.task[n]}
            infos[n] = {"terminal_observation": last, "TimeLimit.truncated": not step.broken[n]}
        return self.observations(step.observations), next(self.rewards).copy(), step.ended, infos

    def close(self) -> None:
        self.environments.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [None] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **options: Any) -> list[Any]:
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        return [False] * self.num_envs


@pytest.mark.parametrize(
    "changes",
    [
        {"ppo.normalise_advantages": True, "ppo.anneal_clip": False, "ppo.clip": 0.2},
        {"ppo.normalise_advantages": False, "ppo.anneal_clip": True, "ppo.clip": 0.01},
        {"ppo.normalise_advantages": True, "ppo.minibatch": 16, "ppo.epochs": 3, "ppo.gradient_norm": 0.01},
    ],
)
def test_a_training_equals_that_of_stable_baselines3(changes: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    """To the bit, over eight rollouts in which episodes end: weights, Adam's state, advantages, returns and metrics."""
    changes = {"ppo.total_steps": 128, "ppo.learning_rate": 3e-3, "ppo.entropy": 0.01, **changes}
    settings = playing(tasks="MoveToRegion,FixColour", preset="State", **changes)
    ppo, updates, size = settings.ppo, 8, (settings.ppo.steps, settings.ppo.environments)
    rewards = np.random.default_rng(0).normal(size=(updates, *size)).astype(np.float32)
    with seeded(0):
        actor = Actor(settings.network, 2, states=True)
        critic = Heads(2, actor.torso.features, 1)
    twins: dict[str, Any] = deepcopy({"actor": actor, "critic": critic})

    ours = PPO(settings, breaking(settings), actor, critic, torch.Generator().manual_seed(0))
    truncated, ended = 0, np.zeros(4, int)
    with seeded(1):
        for update in range(updates):
            ours.collect()
            ended += ours.steps.ended.sum(0)
            truncated += np.count_nonzero(ours.steps.bootstrap)
            advantages = ours.advantages(rewards[update])
            metrics = ours.improve(rewards[update])
    assert ended.tolist() == [0, 1, 0, 1]
    assert truncated == 1

    # They draw the order of samples from NumPy's global generator, and number samples environment by environment.
    generator = torch.Generator().manual_seed(0)

    def permutation(count: int) -> NDArray[np.int64]:
        order = torch.cat(list(even_minibatches(ours.environments.tasks, ppo.steps, ppo.minibatch, generator))).numpy()
        assert len(order) == count
        return order % ppo.environments * ppo.steps + order // ppo.environments

    def falling(value: float) -> Callable[[float], float]:
        return lambda left: (left + 1 / updates) * value  # they count the rollout that an update learns from

    theirs = stable_baselines3.PPO(
        TheirPolicy,  # type: ignore[arg-type]
        TheirEnvs(breaking(settings), rewards.reshape(-1, ppo.environments)),
        learning_rate=falling(ppo.learning_rate),
        n_steps=ppo.steps,
        batch_size=ppo.minibatch,
        n_epochs=ppo.epochs,
        gamma=ppo.discount,
        gae_lambda=ppo.gae_lambda,
        clip_range=falling(ppo.clip) if ppo.anneal_clip else ppo.clip,
        normalize_advantage=ppo.normalise_advantages,
        ent_coef=ppo.entropy,
        max_grad_norm=ppo.gradient_norm,
        policy_kwargs=twins,
        device="cpu",
    )
    theirs.set_logger(Logger(folder=None, output_formats=[]))
    monkeypatch.setattr(np.random, "permutation", permutation)
    with seeded(1):
        theirs.learn(settings.ppo.total_steps)

    for name, weights in ours.policy.state_dict().items():
        assert torch.equal(weights, theirs.policy.networks.state_dict()[name]), name
    memories = (ppo.optimizer.state_dict()["state"] for ppo in (ours, theirs.policy))
    for memory, theirs_too in zip(*(states.values() for states in memories), strict=True):
        assert all(torch.equal(value, theirs_too[name]) for name, value in memory.items())
    # their buffer has been flattened environment by environment
    for own, name in ((advantages, "advantages"), (advantages + ours.steps.values, "returns")):
        np.testing.assert_array_equal(own, getattr(theirs.rollout_buffer, name).reshape(size[::-1]).T)
    logged = theirs.logger.name_to_value
    assert metrics["entropy"] == pytest.approx(-logged["train/entropy_loss"], rel=1e-6)
    assert metrics["value loss"] == pytest.approx(logged["train/value_loss"], rel=1e-6)
    assert metrics["kl"] == pytest.approx(logged["train/approx_kl"], rel=1e-4, abs=1e-8)
    ours.environments.close()
    theirs.env.close()
