"""Stable-baselines3's PPO with our networks, and the base class of GAIL, WGAIL-GP and AL, which learn a reward."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, cast

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import DictRolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.type_aliases import DictRolloutBufferSamples, Schedule
from stable_baselines3.common.utils import obs_as_tensor
from torch import Tensor
from torch.distributions import Categorical
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from magical_mj.learners.data import Batch, Dataset, Rollout
from magical_mj.learners.learner import Learner, restore_optimizer, seeded
from magical_mj.learners.networks import Actor, Heads, Torso, as_input, standardise
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.vector_envs import OBSERVATION, TASK, TrainingEnvs, training_envs
from magical_mj.utils.extras import check_extra

Samples = tuple[Tensor, Tensor, Tensor]
"""A batch on the device: observations from `as_input`, actions (n,) and numbers of tasks (n,)."""


class ActorCritic(BasePolicy):
    """An `Actor` and a critic for stable-baselines3. They share all layers except the last (appendix)."""

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        actor: Actor,
        critic: Heads,
        **others: Any,
    ) -> None:
        del others
        super().__init__(observation_space, action_space)
        self.actor, self.critic = actor, critic
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), fused=True)  # its eps is 1e-8, as in rlpyt

    def distribution_and_values(self, observations: Mapping[str, Tensor]) -> tuple[Categorical, Tensor]:
        """The distribution of actions, and values of shape (n, 1). Pictures have the channels last."""
        tasks = observations[TASK].argmax(1)
        features = self.actor.torso(as_input(observations[OBSERVATION], self.device))
        # The rows have space for the one-hot task: rows of another length would change the last bits of trainings'
        # results.
        features = torch.cat([features, observations[TASK]], 1)[:, : self.actor.torso.features]
        return Categorical(logits=self.actor.head(features, tasks)), self.critic(features, tasks)

    def forward(self, observations: Mapping[str, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Drawn actions (n,), values (n, 1) and the actions' log probabilities (n,)."""
        distribution, values = self.distribution_and_values(observations)
        actions = distribution.sample()
        return actions, values, distribution.log_prob(actions)

    def evaluate_actions(self, observations: Mapping[str, Tensor], actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values (n, 1), and the log probabilities of actions and the entropies, (n,) each."""
        distribution, values = self.distribution_and_values(observations)
        return values, distribution.log_prob(actions), distribution.entropy()

    def predict_values(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Values, shape (n, 1)."""
        return self.distribution_and_values(observations)[1]

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        del deterministic
        return self(observation)[0]


class EvenBuffer(DictRolloutBuffer):
    """A rollout whose minibatches are split evenly between the tasks, and drawn by the run's own generator.

    `tasks` are the numbers of the environments' tasks, ascending; all tasks have the same number of environments.
    """

    def __init__(self, *sizes: Any, tasks: NDArray[np.int64], generator: torch.Generator, **others: Any) -> None:
        super().__init__(*sizes, **others)
        self.tasks, self.generator = tasks, generator

    def get(self, batch_size: int | None = None) -> Iterator[DictRolloutBufferSamples]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """All samples once, in minibatches. In each, the tasks' numbers of samples differ by one at most."""
        count = int(self.tasks[-1]) + 1
        each = self.buffer_size * self.n_envs // count
        permutations = [torch.randperm(each, generator=self.generator) + task * each for task in range(count)]
        order = torch.stack(permutations, dim=1).flatten()  # the tasks alternate
        order = order % self.buffer_size * self.n_envs + order // self.buffer_size
        arrays = self.actions, self.values, self.log_probs, self.advantages, self.returns
        observations = {key: torch.as_tensor(values).flatten(0, 1) for key, values in self.observations.items()}
        others = [torch.as_tensor(values).flatten(0, 1) for values in arrays]
        for numbers in order.split(batch_size or len(order)):
            yield DictRolloutBufferSamples(
                {key: values.index_select(0, numbers).to(self.device) for key, values in observations.items()},
                *(values.index_select(0, numbers).to(self.device) for values in others),
            )


class ExternalRewardPPO(PPO):
    """PPO with external rewards: `collect` a rollout, compute rewards for it, and `improve` the policy with them.

    Where the paper gives no detail, this follows its library rlpyt: advantages are not normalised, the clipping
    range falls with the learning rate, Adam's eps is 1e-8, values are not clipped, and their loss is half the squared
    error. Unlike rlpyt, it treats the horizon as truncation, not termination: returns are bootstrapped with the value
    of the last state. The critic's heads use the actor's torso. The generator draws minibatches.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        environments: TrainingEnvs,
        actor: Actor,
        critic: Heads,
        generator: torch.Generator,
        device: torch.device,
    ) -> None:
        ppo = settings.ppo
        super().__init__(
            ActorCritic,  # pyright: ignore[reportArgumentType]  (PPO uses no more of a policy than it has)
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
        self._rollout_size = ppo.environments * ppo.steps
        self.score = 0.0
        """The mean score of the episodes in the last rollout in which episodes ended; 0 before the first one."""
        self.set_logger(Logger(folder=None, output_formats=[]))  # the default one makes a temporary folder
        _, self._callback = self._setup_learn(ppo.total_steps // self._rollout_size * self._rollout_size)

    @staticmethod
    def _wrap_env(env: TrainingEnvs, *_: Any) -> TrainingEnvs:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Returns `env` itself: stable-baselines3 would move the channels of pictures first, which is slow."""
        return env

    def collect(self, *, pairs: bool = False) -> Rollout:
        """Plays `ppo.steps` steps in each environment, and returns them; with `pairs`, with the following states."""
        self._environments.scores.clear()
        self.collect_rollouts(self._environments, self._callback, self.rollout_buffer, self.n_steps)
        if self._environments.scores:
            self.score = float(np.mean(self._environments.scores))
        buffer = self.rollout_buffer
        seen = buffer.observations[OBSERVATION]
        if pairs:
            seen = np.concatenate([seen, self.successors()[..., -1:, :]], -2)
        return Rollout(*map(torch.as_tensor, (seen, buffer.actions[..., 0], self._environments.tasks)))

    def successors(self) -> NDArray[Any]:
        """The observation after each step, (steps, environments, ...). An episode's last step keeps its own."""
        buffer = self.rollout_buffer
        seen, last = buffer.observations[OBSERVATION], cast("dict[str, NDArray[Any]]", self._last_obs)[OBSERVATION]
        ended = np.stack([*buffer.episode_starts[1:], np.asarray(self._last_episode_starts)]).astype(bool)
        return np.where(ended[..., None, None], seen, np.stack([*seen[1:], last]))

    def improve(self, rewards: NDArray[np.float32]) -> dict[str, float]:
        """One update of the policy, with rewards of shape (steps, environments) for the collected rollout."""
        buffer = self.rollout_buffer
        buffer.rewards += rewards  # environments give 0; SB3 has already added gamma * V(last state) at truncations
        with torch.no_grad():
            last = self.policy.predict_values(obs_as_tensor(self._last_obs, self.device))  # pyright: ignore[reportArgumentType]
        buffer.compute_returns_and_advantage(last, self._last_episode_starts)  # pyright: ignore[reportArgumentType]
        self._update_current_progress_remaining(self.num_timesteps - self._rollout_size, self._total_timesteps)
        self.train()
        metrics = self.logger.name_to_value
        return {
            "score": self.score,
            "entropy": -float(metrics["train/entropy_loss"]),
            "kl": float(metrics["train/approx_kl"]),
            "value loss": float(metrics["train/value_loss"]),
        }

    def get_state(self) -> dict[str, Any]:
        """The weights, and the states of the optimizer, the environments and the training."""
        return {
            "weights": self.policy.state_dict(),
            "optimizer": self.policy.optimizer.state_dict(),
            "environments": self._environments.get_state(),
            "starts": np.array(self._last_episode_starts),
            "steps": self.num_timesteps,
            "epochs": self._n_updates,
            "score": self.score,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        self.policy.load_state_dict(state["weights"])
        restore_optimizer(self.policy.optimizer, state["optimizer"])
        self._last_obs = self._environments.set_state(state["environments"])
        self._last_episode_starts = state["starts"]
        self.num_timesteps, self._n_updates = state["steps"], state["epochs"]
        self.score = state["score"]


class RewardLearner(Learner):
    """Plays, computes rewards, and improves the policy by PPO.

    Policy and value receive pictures without augmentation (appendix). Demonstrations keep their no-ops.
    """

    learns_reward = True
    pairs: ClassVar[bool] = False
    """Whether observations in rollouts are histories with the following state, shape (..., HISTORY + 1, names)."""

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        settings.check_reinforcement()  # for every such method
        self.updates = settings.ppo.total_steps // (settings.ppo.environments * settings.ppo.steps)
        self._expert = Dataset(settings, drop_noop=False)
        self._draw = torch.Generator().manual_seed(settings.seed)
        self._environments = training_envs(settings)
        tasks = len(settings.tasks)
        with seeded(settings.seed):
            actor = Actor(settings.network, tasks, states=settings.states).to(self.device)
            if isinstance(actor.torso, Torso):
                first = self._expert.sample(256 // tasks * tasks, torch.Generator().manual_seed(settings.seed))
                standardise(actor.torso, self.on_device(first)[0])
            critic = Heads(tasks, actor.torso.features, 1).to(self.device)
            self._actor = actor
            self._average = AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(settings.ppo.averaging))
            self._ppo = ExternalRewardPPO(settings, self._environments, actor, critic, self._draw, self.device)
        self._normalise = RewardNormaliser(settings.ppo.reward_deviation, self._environments.tasks)
        self.stateful = {"ppo": self._ppo, "average": self._average, "rewards": self._normalise, "draw": self._draw}

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Also checks that batched environments are installed, if they are selected."""
        super().check(settings)
        if settings.ppo.simulator == "warp":
            check_extra("batched environments", "gpu")

    @property
    def actor(self) -> Actor:
        """The moving average of the policies so far. With `ppo.averaging` 0, it is the latest policy."""
        return cast("Actor", self._average.module)

    def update(self) -> Mapping[str, float]:
        """One rollout, its rewards and PPO's step. Restores the global generators, which stable-baselines3 uses."""
        with seeded(int(torch.randint(2**62, (), generator=self._draw))):
            rollout = self.collect()
            metrics = dict(self.learn_reward(rollout))
            with torch.no_grad():
                parts = [self.reward(*self.on_device(batch)) for batch in rollout.batches(self.settings.ppo.minibatch)]
            rewards = torch.cat(parts).double().cpu().numpy().reshape(rollout.actions.shape)
            metrics |= {"reward": float(rewards.mean()), **self._ppo.improve(self._normalise(rewards))}
        self._average.update_parameters(self._actor)
        return metrics

    def collect(self) -> Rollout:
        """Plays a rollout. Rewards are learnt from it and computed for it."""
        return self._ppo.collect(pairs=self.pairs)

    @abstractmethod
    def learn_reward(self, rollout: Rollout) -> Mapping[str, float]:
        """Improves the reward function with the policy's latest rollout, and returns metrics."""

    @abstractmethod
    def reward(self, observations: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The rewards (n,) of samples, before normalisation."""

    @torch.no_grad()
    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        """The rewards (n,) of steps. They do not depend on the following observations."""
        del following
        return self.reward(observations, actions, tasks)

    def on_device(self, batch: Batch) -> Samples:
        """A batch as inputs of networks."""
        return as_input(batch.observations, self.device), batch.actions.to(self.device), batch.tasks.to(self.device)

    def close(self) -> None:
        """Closes the environments."""
        self._environments.close()


class RewardNormaliser:
    """Normalises each task's rewards to mean 0 and a given standard deviation, using its rewards so far.

    The paper normalises rewards (appendix), but does not say whether jointly for several tasks. Joint normalisation
    would let a task whose samples are easy to discriminate determine the scale of the other tasks' rewards. `tasks` has
    the number of each environment's task, ascending from 0, shape (environments,).
    """

    def __init__(self, deviation: float, tasks: NDArray[np.int64]) -> None:
        self._deviation, self._tasks = deviation, tasks
        self._statistics = [RunningMeanStd() for _ in range(int(tasks[-1]) + 1)]

    def __call__(self, rewards: NDArray[np.float64]) -> NDArray[np.float32]:
        """Adds rewards of shape (steps, environments) to the statistics, and returns them normalised."""
        normalised = np.empty(rewards.shape, np.float32)
        for task, statistics in enumerate(self._statistics):
            own = self._tasks == task
            statistics.update(rewards[:, own].ravel())
            spread = np.sqrt(statistics.var + 1e-12)  # equal rewards are normalised to 0
            normalised[:, own] = (rewards[:, own] - statistics.mean) / spread * self._deviation
        return normalised

    def get_state(self) -> dict[str, Any]:
        """The means, variances and numbers of the rewards so far, by task."""
        names = ("mean", "var", "count")
        return {name: [float(getattr(task, name)) for task in self._statistics] for name in names}

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        for task, statistics in enumerate(self._statistics):
            statistics.mean, statistics.var = np.array(state["mean"][task]), np.array(state["var"][task])
            statistics.count = state["count"][task]
