"""Stable-baselines3's PPO, given rewards from outside and advanced one update at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.utils import obs_as_tensor
from torch import nn

from magical_mj.baselines.actor_critic import ActorCritic
from magical_mj.baselines.environments import IMAGES, Environments
from magical_mj.baselines.learner import restore_optimizer
from magical_mj.baselines.network import Actor, Heads
from magical_mj.baselines.rollout import EvenBuffer, Rollout
from magical_mj.baselines.settings import Settings


class _Scores(BaseCallback):
    """Mean score of the episodes that ended in the last update in which any did; 0 before."""

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


class Improver(PPO):
    """PPO in three strokes: `collect` a rollout, think of rewards, `improve` the policy by them.

    Where the paper says nothing, this follows stable-baselines3: advantages are normalised in each minibatch, values
    are not clipped, and their loss has the weight 0.5 (which makes it rlpyt's, the paper's PPO). Unlike rlpyt's, the
    clipping range stays as it is while the learning rate falls.

    Args:
        settings: of the run.
        environments: to be played in.
        actor: the policy that is improved.
        critic: heads for the actor's torso that estimate values.
        generator: draws minibatches.
        device: of the networks.
    """

    def __init__(
        self,
        settings: Settings,
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
            clip_range=ppo.clip,
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
        """Plays on for the settings' number of steps in each environment."""
        self.collect_rollouts(self._environments, self._scores, self.rollout_buffer, self.n_steps)
        buffer = self.rollout_buffer
        return Rollout(buffer.observations[IMAGES], buffer.actions[..., 0], self._environments.tasks)

    def improve(self, rewards: NDArray[np.float32]) -> dict[str, float]:
        """One update of the policy, by rewards of shape (steps, environments) for what was collected."""
        buffer = self.rollout_buffer
        buffer.rewards += rewards  # in it are, as the environments give 0, the values of states that ended an episode
        with torch.no_grad():
            last = self.policy.predict_values(obs_as_tensor(self._last_obs, self.device))  # pyright: ignore[reportArgumentType]
        buffer.compute_returns_and_advantage(last, self._last_episode_starts)  # pyright: ignore[reportArgumentType]
        self._update_current_progress_remaining(self.num_timesteps - self._each, self._total_timesteps)
        self.train()
        figures = self.logger.name_to_value
        return {
            "score": self._scores.latest,
            "entropy": -float(figures["train/entropy_loss"]),
            "kl": float(figures["train/approx_kl"]),
            "value loss": float(figures["train/value_loss"]),
        }

    def state(self) -> dict[str, Any]:
        """Weights, the optimizer's memory, and where the environments and the training are."""
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
        """Takes up a `state`."""
        self._parts.load_state_dict(state["weights"])
        restore_optimizer(self.policy.optimizer, state["optimizer"])
        self._last_obs = self._environments.restore(state["environments"])
        self._last_episode_starts = state["starts"]
        self.num_timesteps, self._n_updates = state["steps"], state["epochs"]
        self._scores.latest = state["score"]
