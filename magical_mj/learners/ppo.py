"""PPO with external rewards, and the base class of GAIL, WGAIL-GP, AIRL and AL, which learn a reward.

PPO's equations are those of Schulman et al., "Proximal policy optimization algorithms" (arXiv 1707.06347).
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from gymnasium.wrappers.utils import RunningMeanStd
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from magical_mj.learners.data import Batch, Rollout, TrainingData
from magical_mj.learners.learner import Learner, restore_optimizer, seeded
from magical_mj.learners.networks import Actor, Heads, Torso, as_input, standardise
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.vector_envs import TrainingEnvs, training_envs
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.extras import check_extra

Samples = tuple[Tensor, Tensor, Tensor]
"""A batch on the device: observations from `as_input`, actions (n,) and numbers of tasks (n,)."""


class ActorCritic(nn.Module):
    """An `Actor` and a critic. They share all layers except the last (appendix)."""

    def __init__(self, actor: Actor, critic: Heads) -> None:
        super().__init__()
        self.actor, self.critic = actor, critic

    def forward(self, observations: NDArray[Any] | Tensor, tasks: Tensor) -> tuple[Categorical, Tensor]:
        """The distributions of actions and the values (n,), for environments' observations and tasks (n,)."""
        features = self.actor.torso(as_input(observations, tasks.device))
        # Rows have space for a one-hot task: rows of another length would change the last bits of trainings' results.
        size, heads = features.shape[1], self.critic.bias.shape[0]
        features = nn.functional.pad(features, (0, heads))[:, :size]
        return Categorical(logits=self.actor.head(features, tasks)), self.critic(features, tasks)[:, 0]


class Steps(NamedTuple):
    """A rollout with the data that PPO learns from. All shapes are (steps, environments, ...)."""

    observations: NDArray[Any]
    actions: NDArray[np.int64]
    log_probs: NDArray[np.float32]
    values: NDArray[np.float32]
    ended: NDArray[np.bool_]
    """Whether the step ended an episode."""
    bootstrap: NDArray[np.float32]
    """gamma V(s) of the last state s of an episode that the horizon ended, otherwise 0. It is added to the reward."""


class PPO:
    """PPO with external rewards: `collect` a rollout, compute its rewards, and `improve` the policy with them.

    If the paper on MAGICAL does not give a detail, this follows its library rlpyt: advantages are not normalised, the
    clipping range falls with the learning rate, Adam's eps is 1e-8, and values are not clipped. Unlike rlpyt, it treats
    the horizon as truncation, not termination: returns are bootstrapped with the value of the last state.

    With the same rewards and random numbers, trainings equal those of stable-baselines3's PPO to the bit
    (tests/learners/test_stable_baselines3.py). stable-baselines3 accepts only the environments' rewards.

    Attributes:
        steps: the latest rollout.
        score: the mean score of the episodes that ended in the latest rollout with such episodes; 0 before.
    """

    steps: Steps

    def __init__(
        self,
        settings: TrainingSettings,
        environments: TrainingEnvs,
        actor: Actor,
        critic: Heads,
        generator: torch.Generator,
    ) -> None:
        """The critic uses the actor's torso. `generator` draws minibatches; PyTorch's global one draws actions."""
        self.settings = settings.ppo
        self.policy = ActorCritic(actor, critic)
        self.optimizer = torch.optim.Adam(self.policy.parameters(), self.settings.learning_rate, fused=True)
        self.score = 0.0
        self._generator, self.environments = generator, environments
        self._tasks = torch.as_tensor(environments.tasks, device=critic.bias.device)
        self._rollout_size = self.settings.environments * self.settings.steps
        self._total = self.settings.total_steps // self._rollout_size * self._rollout_size
        self._played = 0
        self.observations = environments.reset()

    @torch.no_grad()
    def collect(self, *, pairs: bool = False) -> Rollout:
        """Plays and returns `ppo.steps` steps in each environment. With `pairs`, also returns the following states."""
        rows, scores = [], list[float]()
        for _ in range(self.settings.steps):
            seen = self.observations
            distributions, values = self.policy(seen, self._tasks)
            drawn = distributions.sample()
            actions = drawn.cpu().numpy()
            step = self.environments.step(actions)
            bootstrap = np.zeros(len(actions), np.float32)
            for env in np.flatnonzero(step.ended & ~step.broken):  # a broken state is a termination
                _, value = self.policy(step.last[env : env + 1], self._tasks[env : env + 1])
                bootstrap[env] = (self.settings.discount * value).item()
            log_probs = distributions.log_prob(drawn).cpu().numpy()
            rows.append((seen, actions, log_probs, values.cpu().numpy(), step.ended, bootstrap))
            scores += step.scores[step.ended].tolist()
            self.observations = step.observations
        self.steps = Steps(*map(np.stack, zip(*rows, strict=True)))
        self._played += self._rollout_size
        if scores:
            self.score = float(np.mean(scores))
        seen = self.steps.observations
        if pairs:
            seen = np.concatenate([seen, self.successors()[..., -1:, :]], -2)
        return Rollout(*map(torch.as_tensor, (seen, self.steps.actions, self.environments.tasks)))

    def successors(self) -> NDArray[Any]:
        """The observation after each step, (steps, environments, ...). After an episode's last step, it is repeated."""
        seen, ended = self.steps.observations, self.steps.ended
        return np.where(ended[..., None, None], seen, np.stack([*seen[1:], self.observations]))

    def advantages(self, rewards: NDArray[np.float32]) -> NDArray[np.float32]:
        """Generalised advantage estimation (equations 11 and 12) of the latest rollout.

        With delta_t = r_t + gamma V(s_t+1) - V(s_t), the advantage is A_t = delta_t + gamma lambda A_t+1. After the
        last step of an episode, V(s_t+1) and A_t+1 are 0. All shapes are (steps, environments).
        """
        gamma, gae_lambda = self.settings.discount, self.settings.gae_lambda
        rewards = rewards + self.steps.bootstrap
        with torch.no_grad():
            next_values = self.policy(self.observations, self._tasks)[1].cpu().numpy()
        advantages, next_advantages = np.empty_like(rewards), np.zeros_like(next_values)
        for t in reversed(range(len(rewards))):
            values, continues = self.steps.values[t], 1.0 - self.steps.ended[t].astype(np.float32)
            delta = rewards[t] + gamma * next_values * continues - values
            advantages[t] = next_advantages = delta + gamma * gae_lambda * continues * next_advantages
            next_values = values
        return advantages

    def improve(self, rewards: NDArray[np.float32]) -> dict[str, float]:
        """One update of the policy and the critic: `ppo.epochs` passes through the latest rollout.

        It maximises equation 9, L_CLIP - c1 L_VF + c2 S. With r = pi(a | s) / pi_old(a | s), clipped to 1 +- eps:

        - L_CLIP = mean of min(r A, clip(r) A) (equation 7); A is the advantage,
        - L_VF = mean of (V(s) - return)^2, with c1 = 1 / 2; the return is A + V_old(s),
        - S = mean entropy of the policy, with c2 = `ppo.entropy`.

        Args:
            rewards: the rewards of all steps of the rollout, shape (steps, environments).

        Returns:
            The score, the means of the entropy and L_VF over all minibatches, and the last epoch's mean estimate of
            KL(pi_old, pi).
        """
        ppo, steps = self.settings, self.steps
        remaining = 1.0 - (self._played - self._rollout_size) / self._total  # the share of the training
        clip = remaining * ppo.clip if ppo.anneal_clip else ppo.clip
        self.optimizer.param_groups[0]["lr"] = remaining * ppo.learning_rate
        advantages = self.advantages(rewards)
        tasks = np.broadcast_to(self.environments.tasks, rewards.shape)
        columns = (steps.actions, tasks, steps.log_probs, advantages, advantages + steps.values)
        columns = [torch.as_tensor(column.reshape(-1)) for column in columns]
        observations = torch.as_tensor(steps.observations).flatten(0, 1)
        entropies, value_losses, divergences = list[float](), list[float](), list[float]()
        for _ in range(ppo.epochs):
            divergences.clear()
            for rows in even_minibatches(self.environments.tasks, ppo.steps, ppo.minibatch, self._generator):
                batch = (column[rows].to(self._tasks.device) for column in columns)
                actions, numbers, old_log_probs, gains, returns = batch
                if ppo.normalise_advantages:
                    gains = (gains - gains.mean()) / (gains.std() + 1e-8)
                distributions, values = self.policy(observations.index_select(0, rows), numbers)
                log_ratios = distributions.log_prob(actions) - old_log_probs
                ratios = log_ratios.exp()
                objective = torch.min(gains * ratios, gains * ratios.clamp(1 - clip, 1 + clip)).mean()
                value_loss = nn.functional.mse_loss(values, returns)
                entropy = distributions.entropy().mean()
                loss = -objective - ppo.entropy * entropy + 0.5 * value_loss
                self.optimizer.zero_grad()
                loss.backward()
                nn.utils.clip_grad_norm_(self.policy.parameters(), ppo.gradient_norm)
                self.optimizer.step()
                entropies.append(entropy.item())
                value_losses.append(value_loss.item())
                divergences.append((ratios - 1 - log_ratios).mean().item())  # http://joschu.net/blog/kl-approx.html
        means = {"entropy": entropies, "kl": divergences, "value loss": value_losses}
        return {"score": self.score, **{name: float(np.mean(values)) for name, values in means.items()}}

    def get_state(self) -> dict[str, Any]:
        """The weights, and the states of the optimizer, the environments and the training."""
        return {
            "weights": self.policy.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "environments": self.environments.get_state(),
            "steps": self._played,
            "score": self.score,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        self.policy.load_state_dict(state["weights"])
        restore_optimizer(self.optimizer, state["optimizer"])
        self.observations = self.environments.set_state(state["environments"])
        self._played, self.score = state["steps"], state["score"]


def even_minibatches(tasks: NDArray[np.int64], steps: int, size: int, generator: torch.Generator) -> Iterator[Tensor]:
    """The numbers of all samples of a rollout, once each, in minibatches that are split evenly between the tasks.

    Args:
        tasks: the numbers of the environments' tasks, ascending; all tasks have the same number of environments.
        steps: the number of steps in each environment. Samples are numbered step by step.
        size: the number of samples in a minibatch.
        generator: draws the order.
    """
    count = int(tasks[-1]) + 1
    each = steps * len(tasks) // count
    permutations = [torch.randperm(each, generator=generator) + task * each for task in range(count)]
    order = torch.stack(permutations, dim=1).flatten()  # the tasks alternate
    yield from (order % steps * len(tasks) + order // steps).split(size)


class RewardLearner(Learner):
    """Plays, computes rewards, and improves the policy by PPO.

    Policy and value receive pictures without augmentation (appendix). Demonstrations keep their no-ops.

    Attributes:
        actor: the moving average of the policies so far. With `ppo.averaging` 0, it is the latest policy.
        expert: the demonstrations.
        environments: the environments that it plays in.
        ppo: trains the policy.
        rng: draws batches and seeds.
    """

    parts: ClassVar[tuple[str, ...]] = ("network", "ppo")
    unused: ClassVar[tuple[str, ...]] = ("precision", "augment")
    learns_reward = True
    pairs: ClassVar[bool] = False
    """Whether observations in rollouts are histories with the following state, shape (..., HISTORY + 1, names)."""

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        self.updates = settings.ppo.total_steps // (settings.ppo.environments * settings.ppo.steps)
        self.expert = TrainingData(settings, drop_noop=False)
        self.rng = torch.Generator().manual_seed(settings.seed)
        self.environments = training_envs(settings)
        tasks = len(settings.tasks)
        with seeded(settings.seed):
            actor = Actor(settings.network, tasks, states=settings.states).to(self.device)
            if isinstance(actor.torso, Torso):
                first = self.expert.sample(256 // tasks * tasks, torch.Generator().manual_seed(settings.seed))
                standardise(actor.torso, self.on_device(first)[0])
            critic = Heads(tasks, actor.torso.features, 1).to(self.device)
            self._actor = actor
            self._average = AveragedModel(actor, multi_avg_fn=get_ema_multi_avg_fn(settings.ppo.averaging))
            self.actor = cast("Actor", self._average.module)
            self.ppo = PPO(settings, self.environments, actor, critic, self.rng)
        self._normalise = RewardNormaliser(settings.ppo.reward_deviation, self.environments.tasks)
        self.stateful = {"ppo": self.ppo, "average": self._average, "rewards": self._normalise, "draw": self.rng}

    @classmethod
    def check_values(cls, settings: TrainingSettings) -> None:
        """Raises a `SettingsError` if environments, rollouts, minibatches and samples cannot be split evenly."""
        ppo, tasks = settings.ppo, len(settings.tasks)
        rollout = ppo.environments * ppo.steps
        if ppo.environments % tasks:
            raise SettingsError(
                f"the environments must be split evenly between tasks: ppo.environments={ppo.environments} "
                f"must be a multiple of {tasks}"
            )
        if rollout % ppo.minibatch:
            raise SettingsError(
                f"minibatches must have the same size: ppo.minibatch={ppo.minibatch} does not divide "
                f"ppo.environments x ppo.steps = {rollout}"
            )
        if ppo.total_steps < rollout:
            raise SettingsError(f"ppo.total_steps={ppo.total_steps} is less than one rollout of {rollout} steps")
        if settings.features.samples < tasks:
            raise SettingsError(
                f"features.samples={settings.features.samples} must be at least the number of tasks, {tasks}"
            )

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Also checks that batched environments are installed, if they are selected."""
        super().check(settings)
        if settings.ppo.simulator == "warp":
            check_extra("batched environments", "gpu")

    def update(self) -> Mapping[str, float]:
        """One rollout, its rewards and PPO's update. Restores the global generators, which draw the actions."""
        with seeded(int(torch.randint(2**62, (), generator=self.rng))):
            rollout = self.collect()
            metrics = dict(self.learn_reward(rollout))
            with torch.no_grad():
                parts = [self.reward(*self.on_device(batch)) for batch in rollout.batches(self.settings.ppo.minibatch)]
            rewards = torch.cat(parts).double().cpu().numpy().reshape(rollout.actions.shape)
            metrics |= {"reward": float(rewards.mean()), **self.ppo.improve(self._normalise(rewards))}
        self._average.update_parameters(self._actor)
        return metrics

    def collect(self) -> Rollout:
        """Plays a rollout, for learning the reward and improving the policy."""
        return self.ppo.collect(pairs=self.pairs)

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
        self.environments.close()


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
