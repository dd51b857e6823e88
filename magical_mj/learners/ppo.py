"""Stable-baselines3's PPO on our networks, given rewards from outside and advanced one update at a time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples, Schedule
from stable_baselines3.common.utils import obs_as_tensor
from torch import Tensor, nn

from magical_mj.learners.copies import SEEN, TASK
from magical_mj.learners.data import Rollout
from magical_mj.learners.environments import Environments
from magical_mj.learners.learner import restore_optimizer
from magical_mj.learners.network import Actor, Heads, Torso, as_input
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.states import StateTorso


class Features(BaseFeaturesExtractor):
    """The torso's features with the one-hot task appended, so that the heads get it."""

    def __init__(self, observation_space: spaces.Dict, torso: Torso | StateTorso) -> None:
        tasks = observation_space[TASK].shape
        super().__init__(observation_space, torso.features + int(np.prod(tasks or ())))
        self.torso = torso

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Shape (n, features + tasks). Pictures come as floats from 0 to 255 made for this, the channels last."""
        seen = observations[SEEN]
        return torch.cat([self.torso(as_input(seen, seen.device)), observations[TASK]], dim=1)


class ForTasks(nn.Module):
    """Heads for features with the one-hot task appended."""

    def __init__(self, heads: Heads) -> None:
        super().__init__()
        self.heads = heads

    def forward(self, joined: Tensor) -> Tensor:
        """Shape (n, outputs), for shape (n, features + tasks)."""
        inputs = self.heads.weight.shape[2]
        return self.heads(joined[:, :inputs], joined[:, inputs:].argmax(1))


class ActorCritic(ActorCriticPolicy):
    """Stable-baselines3's policy around an `Actor`: action and value share all but the last layer (appendix).

    Args:
        observation_space: the space of the environments.
        action_space: the space of the environments.
        lr_schedule: remaining share of the training -> learning rate.
        actor: the policy.
        critic: the heads that estimate values.
        others: further arguments of stable-baselines3, which are not used.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        actor: Actor,
        critic: Heads,
        **others: Any,
    ) -> None:
        parts = {"features_extractor_class": Features, "features_extractor_kwargs": {"torso": actor.torso}}
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            net_arch=[],
            ortho_init=False,
            normalize_images=False,  # `Features` does it, in place
            **parts,
            **others,
        )
        self.action_net, self.value_net = ForTasks(actor.head), ForTasks(critic)
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), fused=True)  # its eps is 1e-8, as rlpyt's


class EvenBuffer(DictRolloutBuffer):
    """A rollout whose minibatches are split evenly between the tasks, and drawn by the run's own generator.

    Attributes:
        tasks: the numbers of the environments' tasks, ascending; all tasks have the same number of environments.
        generator: draws the minibatches.
    """

    def __init__(self, *sizes: Any, tasks: NDArray[np.int64], generator: torch.Generator, **others: Any) -> None:
        super().__init__(*sizes, **others)
        self.tasks, self.generator = tasks, generator

    def get(self, batch_size: int | None = None) -> Iterator[DictRolloutBufferSamples]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """All samples once, in minibatches in which the tasks' shares differ by one at most."""
        count = int(self.tasks[-1]) + 1
        each = self.buffer_size * self.n_envs // count
        drawn = [torch.randperm(each, generator=self.generator) + task * each for task in range(count)]
        order = torch.stack(drawn, dim=1).flatten()  # one of each task, and again
        for numbers in order.split(batch_size or len(order)):
            copies, steps = np.divmod(numbers.numpy(), self.buffer_size)
            yield DictRolloutBufferSamples(
                observations={key: self.to_torch(seen[steps, copies]) for key, seen in self.observations.items()},
                actions=self.to_torch(self.actions[steps, copies]),
                old_values=self.to_torch(self.values[steps, copies]),
                old_log_prob=self.to_torch(self.log_probs[steps, copies]),
                advantages=self.to_torch(self.advantages[steps, copies]),
                returns=self.to_torch(self.returns[steps, copies]),
            )


class _Scores(BaseCallback):
    """Mean score of the episodes that ended in the last update with finished episodes; 0 before."""

    latest = 0.0

    def _on_rollout_start(self) -> None:
        self._ended = list[float]()

    def _on_step(self) -> bool:
        pairs = zip(self.locals["infos"], self.locals["dones"], strict=True)
        self._ended += [info["eval_score"] for info, done in pairs if done]
        return True

    def _on_rollout_end(self) -> None:
        if self._ended:
            self.latest = float(np.mean(self._ended))


class ExternalRewardPPO(PPO):
    """PPO with external rewards: `collect` a rollout, compute rewards for it, and `improve` the policy with them.

    Where the paper does not say otherwise, this follows its library rlpyt: advantages are not normalised, the clipping
    range falls with the learning rate, Adam's eps is 1e-8, values are not clipped, and their loss is half the squared
    error. Unlike there, the horizon is treated as truncation, not termination: returns are bootstrapped with the value
    of the last state.

    Args:
        settings: the settings of the run.
        environments: the environments.
        actor: the policy.
        critic: heads for the actor's torso that estimate values.
        generator: draws minibatches.
        device: the device of the networks.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        environments: Environments,
        actor: Actor,
        critic: Heads,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        ppo = settings.ppo
        super().__init__(
            ActorCritic,
            environments,
            learning_rate=lambda left: left * ppo.learning_rate,
            n_steps=ppo.steps,
            batch_size=ppo.minibatch,
            n_epochs=ppo.epochs,
            gamma=ppo.discount,
            gae_lambda=ppo.gae_lambda,
            clip_range=(lambda left: left * ppo.clip) if ppo.anneal_clip else ppo.clip,
            normalize_advantage=ppo.normalise_advantages,
            ent_coef=ppo.entropy,
            max_grad_norm=ppo.gradient_norm,
            rollout_buffer_class=EvenBuffer,
            rollout_buffer_kwargs={"tasks": environments.tasks, "generator": generator},
            policy_kwargs={"actor": actor, "critic": critic},
            device=device,
        )
        self._environments = environments
        self._parts = nn.ModuleDict({"actor": actor, "critic": critic})
        self._each = ppo.environments * ppo.steps
        self._updates = ppo.total_steps // self._each
        self._scores = _Scores()
        self.set_logger(Logger(folder=None, output_formats=[]))  # the default one makes a temporary folder
        self._setup_learn(self._updates * self._each, self._scores)

    def collect(self) -> Rollout:
        """Plays the settings' number of steps in each environment, and returns them."""
        self.collect_rollouts(self._environments, self._scores, self.rollout_buffer, self.n_steps)
        buffer = self.rollout_buffer
        return Rollout(buffer.observations[SEEN], buffer.actions[..., 0], self._environments.tasks)

    def improve(self, rewards: NDArray[np.float32]) -> dict[str, float]:
        """One update of the policy, with rewards of shape (steps, environments) for the collected rollout."""
        buffer = self.rollout_buffer
        buffer.rewards += rewards  # in it are, as the environments give 0, the values of states that ended an episode
        with torch.no_grad():
            last = self.policy.predict_values(obs_as_tensor(self._last_obs, self.device))  # pyright: ignore[reportArgumentType]
        buffer.compute_returns_and_advantage(last, self._last_episode_starts)  # pyright: ignore[reportArgumentType]
        self._update_current_progress_remaining(self.num_timesteps - self._each, self._total_timesteps)
        self.train()
        metrics = self.logger.name_to_value
        return {
            "score": self._scores.latest,
            "entropy": -float(metrics["train/entropy_loss"]),
            "kl": float(metrics["train/approx_kl"]),
            "value loss": float(metrics["train/value_loss"]),
        }

    def state(self) -> dict[str, Any]:
        """Weights, and the states of the optimizer, the environments and the training."""
        return {
            "weights": self._parts.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "environments": self._environments.state(),
            "starts": np.array(self._last_episode_starts),
            "steps": self.num_timesteps,
            "epochs": self._n_updates,
            "score": self._scores.latest,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Restores a `state`."""
        self._parts.load_state_dict(state["weights"])
        restore_optimizer(self.policy.optimizer, state["optimizer"])
        self._last_obs = self._environments.restore(state["environments"])
        self._last_episode_starts = state["starts"]
        self.num_timesteps, self._n_updates = state["steps"], state["epochs"]
        self._scores.latest = state["score"]
