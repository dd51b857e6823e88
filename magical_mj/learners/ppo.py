"""PPO with rewards from outside, and the base class of GAIL, WGAIL-GP, AIRL and AL, which learn a reward."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.running_mean_std import RunningMeanStd
from torch import Tensor, nn
from torch.distributions import Categorical
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from magical_mj.learners.data import Batch, Dataset, Rollout
from magical_mj.learners.learner import Learner, restore_optimizer, seeded
from magical_mj.learners.networks import Actor, Heads, Torso, as_input, standardise
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.vector_envs import TrainingEnvs, training_envs
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
        # Rows with space for the one-hot task: rows of another length would change the last bits of the results.
        size, spare = features.shape[1], self.critic.bias.shape[0]
        features = nn.functional.pad(features, (0, spare))[:, :size]
        return Categorical(logits=self.actor.head(features, tasks)), self.critic(features, tasks)[:, 0]


class Played(NamedTuple):
    """A rollout, with what PPO needs to learn from it. Shapes (steps, environments, ...)."""

    observations: NDArray[Any]
    actions: NDArray[np.int64]
    log_probs: NDArray[np.float32]
    values: NDArray[np.float32]
    ended: NDArray[np.bool_]
    """Whether the step ended an episode."""
    bootstrap: NDArray[np.float32]
    """The discounted value of the state in which the horizon ended an episode, otherwise 0."""


class PPO:
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
    ) -> None:
        self.settings = settings.ppo
        self.policy = ActorCritic(actor, critic)
        self.optimizer = torch.optim.Adam(self.policy.parameters(), self.settings.learning_rate, fused=True)
        self.score = 0.0
        """The mean score of the episodes that ended in the last rollout with finished episodes; 0 before the first."""
        self._generator, self._environments = generator, environments
        self._tasks = torch.as_tensor(environments.tasks, device=critic.bias.device)
        self._rollout_size = self.settings.environments * self.settings.steps
        self._total = self.settings.total_steps // self._rollout_size * self._rollout_size
        self._steps = 0
        self._observations = environments.reset()

    @torch.no_grad()
    def collect(self, *, pairs: bool = False) -> Rollout:
        """Plays `ppo.steps` steps in each environment, and returns them; with `pairs`, with the following states."""
        steps, scores = [], []
        for _ in range(self.settings.steps):
            seen = self._observations
            distributions, values = self.policy(seen, self._tasks)
            actions = distributions.sample()
            log_probs = distributions.log_prob(actions)
            numbers = actions.cpu().numpy()
            self._observations, ended, last, score, broken = self._environments.step(numbers)
            bootstrap = np.zeros(len(numbers), np.float32)
            for env in np.flatnonzero(ended & ~broken):
                _, value = self.policy(last[env : env + 1], self._tasks[env : env + 1])
                bootstrap[env] = (self.settings.discount * value).item()
            scores += score[ended].tolist()
            steps.append((seen, numbers, log_probs.cpu().numpy(), values.cpu().numpy(), ended, bootstrap))
        self.played = Played(*map(np.stack, zip(*steps, strict=True)))
        self._steps += self._rollout_size
        if scores:
            self.score = float(np.mean(scores))
        seen = self.played.observations
        if pairs:
            seen = np.concatenate([seen, self.successors()[..., -1:, :]], -2)
        return Rollout(*map(torch.as_tensor, (seen, self.played.actions, self._environments.tasks)))

    def successors(self) -> NDArray[Any]:
        """The observation after each step, (steps, environments, ...). An episode's last step keeps its own."""
        seen = self.played.observations
        return np.where(self.played.ended[..., None, None], seen, np.stack([*seen[1:], self._observations]))

    def advantages(self, rewards: NDArray[np.float32]) -> NDArray[np.float32]:
        """The generalised advantages of the collected rollout. All shapes are (steps, environments)."""
        ppo, played = self.settings, self.played
        with torch.no_grad():
            following = self.policy(self._observations, self._tasks)[1].cpu().numpy()
        rewards = played.bootstrap + rewards
        advantages, later = np.empty_like(rewards), np.zeros_like(following)
        for step in reversed(range(ppo.steps)):
            continues = 1.0 - played.ended[step].astype(np.float32)
            error = rewards[step] + ppo.discount * following * continues - played.values[step]
            advantages[step] = later = error + ppo.discount * ppo.gae_lambda * continues * later
            following = played.values[step]
        return advantages

    def improve(self, rewards: NDArray[np.float32]) -> dict[str, float]:
        """One update of the policy, with rewards of shape (steps, environments) for the collected rollout."""
        ppo, played = self.settings, self.played
        left = 1.0 - (self._steps - self._rollout_size) / self._total
        clip = left * ppo.clip if ppo.anneal_clip else ppo.clip
        self.optimizer.param_groups[0]["lr"] = left * ppo.learning_rate
        advantages = self.advantages(rewards)
        tasks = np.broadcast_to(self._environments.tasks, advantages.shape)
        arrays = (played.actions, tasks, played.log_probs, advantages, advantages + played.values)
        columns = [torch.as_tensor(array.reshape(-1)) for array in arrays]
        observations = torch.as_tensor(played.observations).flatten(0, 1)
        entropies, kls, value_losses = list[float](), list[float](), list[float]()
        for _ in range(ppo.epochs):
            kls.clear()  # those of the last epoch are reported
            for rows in even_minibatches(self._environments.tasks, ppo.steps, ppo.minibatch, self._generator):
                actions, numbers, old, gains, returns = (column[rows].to(self._tasks.device) for column in columns)
                distributions, values = self.policy(observations.index_select(0, rows), numbers)
                log_ratios, entropy = distributions.log_prob(actions) - old, distributions.entropy().mean()
                ratios = log_ratios.exp()
                if ppo.normalise_advantages:
                    gains = (gains - gains.mean()) / (gains.std() + 1e-8)
                gain = torch.min(gains * ratios, gains * ratios.clamp(1 - clip, 1 + clip)).mean()
                value_loss = nn.functional.mse_loss(values, returns)
                self.optimizer.zero_grad()
                (-gain - ppo.entropy * entropy + 0.5 * value_loss).backward()
                nn.utils.clip_grad_norm_(self.policy.parameters(), ppo.gradient_norm)
                self.optimizer.step()
                entropies.append(entropy.item())
                kls.append((ratios - 1 - log_ratios).mean().item())  # http://joschu.net/blog/kl-approx.html
                value_losses.append(value_loss.item())
        means = {"entropy": entropies, "kl": kls, "value loss": value_losses}
        return {"score": self.score, **{name: float(np.mean(values)) for name, values in means.items()}}

    def get_state(self) -> dict[str, Any]:
        """The weights, and the states of the optimizer, the environments and the training."""
        return {
            "weights": self.policy.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "environments": self._environments.get_state(),
            "steps": self._steps,
            "score": self.score,
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        self.policy.load_state_dict(state["weights"])
        restore_optimizer(self.optimizer, state["optimizer"])
        self._observations = self._environments.set_state(state["environments"])
        self._steps, self.score = state["steps"], state["score"]


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
            self._ppo = PPO(settings, self._environments, actor, critic, self._draw)
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
        """One rollout, its rewards and PPO's step. Restores the global generators, from which actions are drawn."""
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
