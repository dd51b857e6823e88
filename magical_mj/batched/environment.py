"""A vector environment of hundreds to thousands of worlds, whose observations, rewards and ends are torch tensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, Final

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from torch import Tensor

from magical_mj.batched.arguments import check_actions, masked
from magical_mj.batched.observations import Frames, Observation, States
from magical_mj.batched.physics import Physics, check_device
from magical_mj.batched.sampling import SceneSampler, sample
from magical_mj.batched.saved import check_state
from magical_mj.batched.scenes import Capacity, SceneArrays
from magical_mj.batched.scores import SCORES, Start, score
from magical_mj.envs.presets import preset_named
from magical_mj.envs.reset_options import ResetOptions
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.registry import Pair, check_rules, task_spec
from magical_mj.tasks.spec import REWARDS, Reward, Rules
from magical_mj.utils.errors import ClosedError, SettingsError, check_name, shown
from magical_mj.variants import check_seed

MODES: Final = (AutoresetMode.SAME_STEP, AutoresetMode.DISABLED)

OVERFLOW: Final = (
    "worlds had more contacts than there is room for, and some were dropped: do not trust the episodes that "
    'info["overflowed"] marks'
)


class BatchedEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Worlds of one or more environments, stepped and drawn together on one device; see `magical_mj.batched.make`.

    As in every vector environment, `reset(seed=7)` gives the worlds the scenes of seeds 7, 8, 9..., and a list gives
    each its own. With SAME_STEP, a world whose episode ends starts the next one at once: observation and info are the
    new episode's, and `info["final_obs"]` and `info["final_info"]` those of the episodes that ended, in the worlds that
    `info["_final_info"]` marks. With DISABLED, `reset(options={"reset_mask": mask})` resets the masked worlds.

    An info holds tensors of shape (num_envs,): `eval_score` and `is_success` of episodes that end (0 in the others),
    `broken` (the state is not finite: the episode ends with score 0), and `overflowed` (since the reset there were more
    contacts than there is room for, and some were dropped).

    Attributes:
        physics: the simulation of all worlds.
        observer: what makes observations of it.
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
    ) -> None:
        if autoreset_mode not in MODES:
            names = " or ".join(f"gymnasium.vector.{mode}" for mode in MODES)
            raise SettingsError(f"autoreset_mode must be {names}, not {shown(autoreset_mode)}")
        check_name("reward", reward, REWARDS)
        for task, _ in pairs:
            check_name("batched task", task, SCORES)
        self.num_envs = len(pairs)
        self.metadata = {"autoreset_mode": autoreset_mode, "render_fps": c.CONTROL_RATE}
        self._same_step = autoreset_mode == AutoresetMode.SAME_STEP
        self._rules: Rules = check_rules(rules)
        device = check_device(device)
        self._reward, self.device = reward, device
        self._tasks = {task: self._numbers(pairs, task) for task in dict.fromkeys(task for task, _ in pairs)}
        horizons = [task_spec(task).horizon(rules) for task, _ in pairs]
        self._horizons = torch.tensor(horizons, device=device)
        seed, capacity = check_seed(seed), Capacity.of_environments(pairs)
        self._scenes = sample(pairs, [0] * self.num_envs, capacity)
        self._start = Start.of(self._scenes, device)
        self.physics = Physics(self._scenes, device)
        made = preset_named(preset)
        size = made.image_size if image_size is None else check_size(image_size)
        self._kind = {
            "environments": [f"{task}-{variant}" for task, variant in pairs],
            "rules": rules,
            "preset": preset,
            "image_size": None if made.layout == "state" else size,
        }
        if made.layout == "state":
            self.observer: States | Frames = States(self.num_envs, device)
        else:
            self.observer = Frames(made, size, self._scenes, device)
        self.single_observation_space = self.observer.space
        self.observation_space = gymnasium.vector.utils.batch_space(self.observer.space, self.num_envs)
        self.single_action_space = spaces.Discrete(len(ACTIONS))
        self.action_space = spaces.MultiDiscrete([len(ACTIONS)] * self.num_envs)
        self._options = ResetOptions("reset_mask")
        self._steps = torch.zeros(self.num_envs, dtype=torch.int64, device=device)
        self._running = torch.zeros(self.num_envs, dtype=torch.bool, device=device)
        self._sampler = SceneSampler(pairs, capacity, workers)  # last: its workers would outlive an error
        self._sampler.seed(seed)

    def _numbers(self, pairs: Sequence[Pair], task: str) -> Tensor:
        return torch.tensor([world for world, (name, _) in enumerate(pairs) if name == task], device=self.device)

    def reset(
        self, *, seed: int | Sequence[int] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Tensor]]:
        """Starts episodes in all worlds, or in those of `options["reset_mask"]`, shape (num_envs,), bool.

        Args:
            seed: of the first world's scene, the others have the next ones; without a mask, also of the scenes of all
                later episodes. Or a sequence with one for each world, of this episode alone. None: sampled scenes.
            options: see above; others are ignored, with a warning.

        Raises:
            InvalidSeedError: if a seed is not an integer, or negative.
            SettingsError: if there is not one seed, or entry of the mask, for each world; if the options are no dict.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        mask = self._options.checked(options).get("reset_mask")
        chosen = masked(mask, self.num_envs)
        seeds = None
        if seed is not None:
            each: list[Any]
            if isinstance(seed, list | tuple | range) or (isinstance(seed, np.ndarray | Tensor) and seed.ndim > 0):
                each = list(seed)
            else:
                each = [check_seed(seed) + world for world in range(self.num_envs)]
                if mask is None:
                    self._sampler.seed(each[0])
            if len(each) != self.num_envs:
                raise SettingsError(f"there are {self.num_envs} worlds, and {len(each)} seeds were given")
            seeds = [check_seed(each[world]) for world in chosen]
        observation = self._begin(chosen, seeds)
        return observation, self._info(torch.zeros(self.num_envs, dtype=torch.float64, device=self.device))

    def _begin(self, worlds: list[int], seeds: list[int] | None = None) -> Observation:
        where = torch.tensor(worlds, dtype=torch.int64, device=self.device)
        if worlds:
            self._put(self._sampler.scenes(worlds, seeds), where)
        self._steps[where] = 0
        self._running[where] = True
        return self.observer.begin(self.physics, where)

    def _put(self, scenes: SceneArrays, worlds: Tensor) -> None:
        """Puts scenes, at rest, into these worlds."""
        self._scenes.write(scenes, worlds.cpu().numpy())
        for name, column in zip(Start._fields, self._start, strict=True):
            column[worlds] = torch.from_numpy(getattr(scenes, name)).to(column)
        self.physics.reset(scenes, worlds)
        self.observer.start(scenes, worlds)

    def get_state(self) -> dict[str, Any]:
        """The present state of all worlds, the pictures in the stacks included: tensors, arrays and plain values."""
        self._check_open()
        return {
            "kind": self._kind,
            "scenes": asdict(self._scenes),
            "sampler": self._sampler.get_state(),
            "physics": self.physics.get_state(),
            "observer": self.observer.get_state(),
            "steps": self._steps.clone(),
            "running": self._running.clone(),
        }

    def set_state(self, state: Mapping[str, Any]) -> Observation:
        """Goes back to a state, of this environment or another of the same worlds; returns what is seen then.

        What follows is the same to the bit on Warp's CPU device. On an accelerator the state is the same, and what
        follows is as near as any two runs are there: contacts are taken down in the order in which threads find them.

        Raises:
            StateError: if it is not a state of such worlds with such observations; then nothing is changed.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        check_state(state, self.get_state())
        self._put(SceneArrays(**state["scenes"]), torch.arange(self.num_envs, device=self.device))
        self._sampler.set_state(state["sampler"])
        self.physics.set_state(state["physics"])
        self._steps[:], self._running[:] = state["steps"], state["running"]
        return self.observer.set_state(state["observer"], self.physics)

    def step(self, actions: Any) -> tuple[Observation, Tensor, Tensor, Tensor, dict[str, Any]]:
        """One action in every world.

        Args:
            actions: numbers in 0..17, a tensor or an array. Shape (num_envs,).

        Raises:
            InvalidActionError: if they are anything else.
            ResetNeeded: if the episode of a world has ended and was not reset.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        if not self._running.all():
            raise ResetNeeded("worlds have no running episode: reset them, all at once or options={'reset_mask': ...}")
        self.physics.step(check_actions(actions, self.num_envs, self.device))
        self._steps += 1
        broken = self.physics.broken
        ended = (self._steps >= self._horizons) | broken
        scores = torch.zeros(self.num_envs, dtype=torch.float64, device=self.device)
        if bool(ended.any()):
            scores = torch.where(ended & ~broken, self._scores(), 0.0)
        info = self._info(scores, broken)
        if bool(broken.any()):  # put at rest what cannot be drawn
            self.physics.reset(self._scenes.rows(broken.nonzero()[:, 0].cpu().numpy()), broken.nonzero()[:, 0])
        if bool((ended & info["overflowed"]).any()):
            gymnasium.logger.warn(OVERFLOW)
        observation = self.observer.look(self.physics)
        reward = scores.float() if self._reward == "score" else torch.zeros(self.num_envs, device=self.device)
        self._running &= ~ended
        if self._same_step and bool(ended.any()):
            final = {"final_obs": observation, "_final_obs": ended, "final_info": info, "_final_info": ended}
            observation = self._begin(ended.nonzero()[:, 0].tolist())
            info = {**self._info(torch.zeros_like(scores)), **final}
        return observation, reward, torch.zeros_like(ended), ended, info

    def _scores(self) -> Tensor:
        poses = self.physics.poses.double()
        scores = torch.zeros(self.num_envs, dtype=torch.float64, device=self.device)
        for task, worlds in self._tasks.items():
            start = Start(*(column[worlds] for column in self._start))
            scores[worlds] = score(task, start, poses[worlds], self._rules)
        return scores

    def _info(self, scores: Tensor, broken: Tensor | None = None) -> dict[str, Any]:
        return {
            "eval_score": scores,
            "is_success": scores == 1.0,
            "broken": torch.zeros_like(self._running) if broken is None else broken,
            "overflowed": self.physics.overflowed,
        }

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the processes that sample scenes, and frees the worlds."""
        del kwargs
        self._sampler.close()
        del self.physics, self.observer

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; make another one")
