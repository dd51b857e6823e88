"""A vector environment of hundreds to thousands of environments. Observations, rewards and ends are torch tensors."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from torch import Tensor

from magical_mj.actions import ACTIONS
from magical_mj.batched.observations import Frames, Observation, States
from magical_mj.batched.physics import Physics, check_device
from magical_mj.batched.pictures import check_accelerator
from magical_mj.batched.scenes import BatchScenes, EpisodeArrays, Prepare, Sampler, capacity_of_environments, sample
from magical_mj.batched.tables import constant_states, episode_tables
from magical_mj.envs.gymnasium_env import check_options
from magical_mj.envs.presets import preset_named
from magical_mj.envs.vector import check_mask, environment_seeds
from magical_mj.rendering.picture import check_size
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.registry import DRAWN, Shifts, parse_shifts, shift_label
from magical_mj.tasks.registry import Pair, check_rules, task_spec
from magical_mj.tasks.spec import REWARDS, Reward, Rules
from magical_mj.utils.errors import (
    ClosedError,
    InvalidActionError,
    SettingsError,
    StateError,
    as_integer,
    check_name,
    short_repr,
)
from magical_mj.variants import check_seed

MODES: Final = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)

OVERFLOW: Final = (
    "some environments had more contacts than the allocated maximum, so that contacts were lost: do not use the "
    'episodes marked by info["overflowed"]'
)


class BatchedEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Environments with one or more tasks and variants, stepped and rendered together. See `magical_mj.batched.make`.

    As in every vector environment, `reset(seed=7)` starts the environments with the scenes of seeds 7, 8, 9..., and a
    list contains a seed for each environment. With SAME_STEP, an environment whose episode ends starts the next one at
    once: observation and info are the new episode's. `info["final_obs"]` and `info["final_info"]` are those of the
    ended episodes, in the environments marked by `info["_final_info"]`. With DISABLED,
    `reset(options={"reset_mask": mask})` resets the masked environments.

    An info contains tensors of shape (num_envs,): `eval_score` and `is_success` of episodes that end (0 in the others),
    `broken` (the state is not finite: the episode ends with score 0), and `overflowed` (since the reset there were more
    contacts than the allocated maximum, so that some were lost).

    Attributes:
        tasks: the task of each environment.
        variants: the variant of each environment.
        physics: the simulation of all environments.
        observer: the object that computes observations of the simulation.
        sampler: samples the scenes of episodes.
        steps: the number of steps of each environment's episode, shape (num_envs,), int64.
    """

    def __init__(
        self,
        pairs: Sequence[Pair],
        *,
        preset: str,
        device: str,
        seed: int,
        image_size: int | None = None,
        rules: Rules = "paper",
        reward: Reward = "none",
        autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
        workers: int = 0,
        shifts: Shifts = None,
    ) -> None:
        if autoreset_mode not in MODES:
            names = " or ".join(f"gymnasium.vector.{mode}" for mode in MODES)
            raise SettingsError(f"autoreset_mode must be {names}, not {short_repr(autoreset_mode)}")
        check_name("reward", reward, REWARDS)
        if reward == "dense":
            raise SettingsError(
                "batched environments have no dense rewards, which need each environment's scene at each step: use "
                'reward="score" here, or gymnasium.make_vec'
            )
        seed = check_seed(seed)
        self._rules: Rules = check_rules(rules)
        observed = preset_named(preset)
        size = observed.image_size if image_size is None else check_size(image_size)
        self.device = check_device(device)
        strengths = check_shifts(shifts, pairs, pictures=observed.layout != "state")
        if observed.layout != "state":
            check_accelerator(self.device)
        self._specs = [task_spec(task) for task, _ in pairs]

        self.num_envs = len(pairs)
        self.tasks, self.variants = (tuple(names) for names in zip(*pairs, strict=True))
        self.metadata = {"autoreset_mode": autoreset_mode, "render_fps": c.CONTROL_RATE}
        self._reward, self._same_step = reward, autoreset_mode == AutoresetMode.SAME_STEP
        self._kind = {
            "environments": [f"{task}-{variant}" for task, variant in pairs],
            "rules": rules,
            "preset": preset,
            "image_size": None if observed.layout == "state" else size,
            "shifts": strengths,
        }
        self._horizons = torch.tensor([spec.horizon(rules) for spec in self._specs], device=self.device)
        self.steps = torch.zeros(self.num_envs, dtype=torch.int64, device=self.device)
        self._running = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)

        capacity = capacity_of_environments(pairs)
        in_states = observed.layout == "state"
        steps = 1 + int(self._horizons.max())
        self._prepare: Prepare = (
            partial(constant_states, start=observed.start)
            if in_states
            else partial(episode_tables, shifts=strengths, steps=steps)
        )
        self.sampler = Sampler(pairs, capacity, self._prepare, workers)
        self.sampler.seed(seed)
        self._seeds = [0] * self.num_envs
        kinds = {pair: row for row, pair in enumerate(dict.fromkeys(pairs))}
        rows = [kinds[pair] for pair in pairs]
        first = sample(list(kinds), capacity, self._prepare, [0] * len(kinds))
        episodes = {name: values[rows] for name, values in first.items()}
        self._scenes = BatchScenes.named(episodes)
        self.physics = Physics(self._scenes, self.device)
        self.observer: States | Frames = (
            States(observed, episodes, self.device)
            if in_states
            else Frames(observed, size, self._scenes, episodes, self.device)
        )
        self.single_observation_space = self.observer.space
        self.observation_space = gymnasium.vector.utils.batch_space(self.observer.space, self.num_envs)
        self.single_action_space = spaces.Discrete(len(ACTIONS))
        self.action_space = spaces.MultiDiscrete([len(ACTIONS)] * self.num_envs)

    @property
    def conditions(self) -> list[dict[str, Any]]:
        """For each environment, the properties that results record; see `MagicalEnv.conditions`."""
        kind = self._kind
        common = {"rules": kind["rules"], "body": GRIPPER, "shift": shift_label(kind["shifts"]), "worlds": "batched"}
        names = (name.rpartition("-") for name in kind["environments"])
        return [{"task": task, "variant": variant, "preset": kind["preset"], **common} for task, _, variant in names]

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Tensor]]:
        """Starts episodes in all environments, or in those selected by `options["reset_mask"]`, bool, (num_envs,).

        Args:
            seed: the seed of the first environment's scene. The others use the next ones. Without a mask, it also
                determines the scenes of all later episodes. A sequence contains a seed for each environment, for this
                episode only. None: the next sampled scenes.
            options: may contain "reset_mask". Other options are ignored with a warning.

        Raises:
            InvalidSeedError: if a seed is not an integer, or negative.
            SettingsError: if the number of seeds or of mask entries is not that of the environments, or if the options
                are not a dict.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        mask = check_options(options, "reset_mask").get("reset_mask")
        envs = np.flatnonzero(check_mask(arrays(mask), self.num_envs)).tolist()
        each = environment_seeds(arrays(seed), self.num_envs)
        if mask is None and as_integer(seed) is not None:
            self.sampler.seed(check_seed(seed))
        observation = self._begin(envs, None if seed is None else [check_seed(each[env]) for env in envs])
        return observation, self._info(torch.zeros(self.num_envs, dtype=torch.float64, device=self.device))

    def _begin(self, envs: list[int], seeds: list[int] | None = None) -> Observation:
        where = torch.tensor(envs, dtype=torch.int64, device=self.device)
        if envs:
            self._put(*self.sampler.episodes(envs, seeds), where)
        self.steps[where] = 0
        self._running[where] = True
        return self.observer.observe_start(self.physics, where)

    def _put(self, seeds: Sequence[int], episodes: EpisodeArrays, envs: Tensor) -> None:
        """Starts the episodes of these seeds in these environments."""
        scenes = BatchScenes.named(episodes)
        for env, seed in zip(envs.tolist(), seeds, strict=True):
            self._seeds[env] = seed
        self._scenes.write(scenes, envs.cpu().numpy())
        self.physics.reset(scenes, envs)
        self.observer.set_episodes(episodes, envs)

    def get_state(self) -> dict[str, Any]:
        """The state of all environments, including the pictures in the stacks, as tensors, arrays and plain values."""
        self._check_open()
        return {
            "kind": self._kind,
            "scenes": asdict(self._scenes),
            "seeds": list(self._seeds),
            "sampler": self.sampler.get_state(),
            "physics": self.physics.get_state(),
            "observer": self.observer.get_state(),
            "steps": self.steps.clone(),
            "running": self._running.clone(),
        }

    def set_state(self, state: Mapping[str, Any]) -> Observation:
        """Restores a state of this environment, or of another one with the same settings. Returns its observation.

        On Warp's CPU device, the following steps are identical to the bit. On an accelerator, the state is identical,
        but the following steps agree only as well as any two runs there: the order of contacts depends on the threads'
        timing.

        Raises:
            StateError: if the state is from another batch or other observations. Then nothing is changed.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        check_state(state, self.get_state())
        scenes, seeds = BatchScenes(**state["scenes"]), state["seeds"]
        every = torch.arange(self.num_envs, device=self.device)
        self._put(seeds, {**vars(scenes), **self._prepare(scenes, seeds)}, every)
        self.sampler.set_state(state["sampler"])
        self.physics.set_state(state["physics"])
        self.steps[:], self._running[:] = state["steps"], state["running"]
        return self.observer.set_state(state["observer"], self.physics)

    def step(self, actions: Any) -> tuple[Observation, Tensor, Tensor, Tensor, dict[str, Any]]:
        """Performs an action in each environment.

        Args:
            actions: integers in 0..17, a tensor or an array. Shape (num_envs,).

        Raises:
            InvalidActionError: if the actions are invalid.
            ResetNeeded: if the episode of an environment has ended and was not reset.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        if not self._running.all():
            raise ResetNeeded(
                "some environments have no running episode: reset all, or with options={'reset_mask': ...}"
            )
        self.physics.step(check_actions(actions, self.num_envs, self.device))
        self.steps += 1
        broken = self.physics.broken
        ended = (self.steps >= self._horizons) | broken
        scores = self._scores(ended & ~broken)
        info = self._info(scores, broken)
        if bool(broken.any()):  # reset states that cannot be drawn
            where = broken.nonzero()[:, 0]
            self.physics.reset(self._scenes[where.cpu().numpy()], where)
        if bool((ended & info["overflowed"]).any()):
            gymnasium.logger.warn(OVERFLOW)
        observation = self.observer.observe(self.physics, self.steps)
        reward = scores.float() if self._reward == "score" else torch.zeros(self.num_envs, device=self.device)
        self._running &= ~ended
        if self._same_step and bool(ended.any()):
            final = {"final_obs": observation, "_final_obs": ended, "final_info": info, "_final_info": ended}
            observation = self._begin(ended.nonzero()[:, 0].tolist())
            info = {**self._info(torch.zeros_like(scores)), **final}
        return observation, reward, torch.zeros_like(ended), ended, info

    def _scores(self, ended: Tensor) -> Tensor:
        """The scores of the environments whose episodes ended, and 0 in the others. Shape (num_envs,), float64."""
        scores = torch.zeros(self.num_envs, dtype=torch.float64)
        envs = ended.nonzero()[:, 0]
        for env, poses in zip(envs.tolist(), self.physics.poses[envs].cpu().numpy(), strict=True):
            initial, final = self._scenes.scene(env), self._scenes.scene(env, poses)
            scores[env] = self._specs[env].checked_score((initial, final), self._rules)
        return scores.to(self.device)

    def _info(self, scores: Tensor, broken: Tensor | None = None) -> dict[str, Any]:
        return {
            "eval_score": scores,
            "is_success": scores == 1.0,
            "broken": torch.zeros_like(self._running) if broken is None else broken,
            "overflowed": self.physics.overflowed,
        }

    def close_extras(self, **kwargs: Any) -> None:
        """Stops the processes that sample scenes, and frees the environments."""
        del kwargs
        self.sampler.close()
        del self.physics, self.observer

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; create a new one")


class Arrays(gymnasium.vector.VectorWrapper[Any, Any, Any, Any]):
    """A `BatchedEnv` with numpy arrays, copied from the device, as observations, rewards, episode ends and infos.

    The states of `get_state` are unchanged.
    """

    env: BatchedEnv  # pyright: ignore[reportIncompatibleVariableOverride]

    @property
    def device(self) -> str:
        """Warp's name of the device of the environments."""
        return self.env.device

    def reset(self, **settings: Any) -> tuple[Any, dict[str, Any]]:
        """See `BatchedEnv.reset`."""
        return arrays(self.env.reset(**settings))

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """See `BatchedEnv.step`."""
        return arrays(self.env.step(actions))

    def get_state(self) -> dict[str, Any]:
        """The environment's state."""
        return self.env.get_state()

    def set_state(self, state: Mapping[str, Any]) -> Any:
        """See `BatchedEnv.set_state`."""
        return arrays(self.env.set_state(state))


def arrays(value: Any) -> Any:
    """Converts tensors to arrays, also inside dicts and tuples."""
    if isinstance(value, Tensor):
        return value.cpu().numpy()
    if isinstance(value, dict):
        return {name: arrays(entry) for name, entry in value.items()}
    if isinstance(value, tuple):
        return tuple(arrays(entry) for entry in value)
    return value


def check_shifts(shifts: Shifts, pairs: Sequence[Pair], *, pictures: bool) -> dict[str, int]:
    """The strengths of shifts.

    Raises:
        SettingsError: if batched environments cannot draw one of them, or draw no pictures.
        UnknownNameError, ShiftError: see `parse_shifts`.
    """
    strengths = dict(ChainMap(*(parse_shifts(shifts, task) for task in dict.fromkeys(task for task, _ in pairs))))
    if other := [name for name in strengths if name not in DRAWN]:
        raise SettingsError(
            f"batched environments can have the shifts {', '.join(DRAWN)}, not {other[0]}: use gymnasium.make or "
            "make_vec"
        )
    if strengths and not pictures:
        raise SettingsError("these shifts change pictures, and the preset has none: leave them out, or choose another")
    return {name: int(strength) for name, strength in strengths.items()}


def check_actions(actions: Any, envs: int, device: str) -> Tensor:
    """The actions on a device. Raises an `InvalidActionError` unless they are num_envs integers in 0..17."""
    try:
        given = torch.as_tensor(actions, device=device)
        whole = not (given.dtype == torch.bool or given.is_floating_point() or given.is_complex())
    except (TypeError, ValueError, RuntimeError):  # they cannot be converted to a tensor
        given, whole = torch.empty(0), False
    numbers = given.long()
    if not whole or numbers.shape != (envs,) or bool(((numbers < 0) | (numbers >= len(ACTIONS))).any()):
        raise InvalidActionError(
            f"actions must be {envs} integers in 0..{len(ACTIONS) - 1}, one for each environment, not "
            f"{short_repr(actions)}"
        )
    return numbers


def check_state(state: Any, own: Mapping[str, Any]) -> None:
    """Raises a `StateError` unless a user's state is of the same kind as the environment's `own` state."""
    kind = state.get("kind") if isinstance(state, Mapping) else None
    if not isinstance(kind, Mapping) or state.keys() != own.keys() or kind.keys() != own["kind"].keys():
        raise StateError(f"set_state() needs a state from get_state(), not {short_repr(state)}")
    for name, value in own["kind"].items():
        if kind[name] != value:
            raise StateError(
                f"the state has {name} {short_repr(kind[name])} instead of this environment's {short_repr(value)}"
            )
