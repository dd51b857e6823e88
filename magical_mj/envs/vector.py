"""Worlds on all cores: a Gymnasium vector environment whose worlds are stepped and drawn by threads of one process.

MuJoCo and the software renderer let go of Python's interpreter while they work, so threads are enough. Each world is a
`MagicalEnv`: what it does is the same to the bit as alone. MuJoCo's own batches (`mujoco.batch`) need one layout for
all models of a batch, and variants change it from episode to episode.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space, create_empty_array
from numpy.typing import NDArray

from magical_mj.envs.gymnasium_env import STARTS, MagicalEnv, check_options
from magical_mj.envs.registration import env_id
from magical_mj.scene.actions import ACTIONS, as_array, tensor_hint
from magical_mj.utils.errors import ClosedError, InvalidActionError, SettingsError, as_integer, short_repr
from magical_mj.utils.parallel import cores
from magical_mj.variants import check_seed


def make_vec(
    environment: str, num_envs: int = 1, *, variant: str = "Demo", preset: str = "LoRes4E", **settings: Any
) -> VectorEnv:
    """Worlds of one environment, on all cores: `VectorEnv`.

    Args:
        environment: an id, such as "magical_mj/FindDupe-Demo-LoRes4E-v0", or a task.
        num_envs: the number of worlds.
        variant: of the task.
        preset: of the observations, if it is a task.
        settings: those of `make_worlds` and of `MagicalEnv`.

    Example:
        >>> envs = magical_mj.make_vec("FindDupe", 32, renderer="software")
        >>> observations, infos = envs.reset(seed=0)  # (32, 96, 96, 12)
    """
    known = isinstance(environment, str) and environment in gymnasium.registry
    name = environment if known else env_id(environment, variant, preset)
    return cast("VectorEnv", gymnasium.make_vec(name, num_envs, "vector_entry_point", **settings))


def make_worlds(
    kind: Callable[..., MagicalEnv] = MagicalEnv,
    *,
    num_envs: int = 1,
    threads: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> VectorEnv:
    """What `gymnasium.make_vec` calls.

    Args:
        kind: the class of the worlds.
        num_envs: the number of worlds.
        threads: how many step and draw them; None: one for each core.
        autoreset_mode: as Gymnasium defines it: a `gymnasium.vector.AutoresetMode` or its value.
        max_episode_steps: where episodes end before the task's horizon.
        settings: the arguments of the class, such as `task`, `renderer` and `image_size`.

    Raises:
        SettingsError: if a number is not possible.
    """
    for name, value in (("num_envs", num_envs), ("threads", threads)):
        if value is not None and as_integer(value, 1) is None:
            raise SettingsError(f"{name} must be an integer of at least 1, not {short_repr(value)}")
    worlds = [kind(limit=max_episode_steps, **settings) for _ in range(num_envs)]
    return VectorEnv(worlds, threads, autoreset_mode)


class VectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Worlds that are stepped and drawn together, each the same to the bit as the single environment.

    `reset(seed=7)` gives the worlds the seeds 7, 8, 9..., and a list gives each its own. Observations, rewards, infos
    and the three modes of `gymnasium.vector.AutoresetMode` are those of `gymnasium.vector.SyncVectorEnv`; observations
    are fresh arrays. With DISABLED, `reset(options={"reset_mask": mask})` resets the masked worlds. A world that ended
    and was then set to a state with `call("set_state", state)` goes on from it. Copies and pickles have worlds of their
    own, in the same states.

    Args:
        envs: the worlds, with equal spaces.
        threads: how many step and draw them; None: one for each core.
        autoreset_mode: what happens where an episode ends.

    Attributes:
        envs: the worlds.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`.
    """

    def __init__(
        self,
        envs: Sequence[MagicalEnv],
        threads: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            names = ", ".join(f"gymnasium.vector.{mode}" for mode in AutoresetMode)
            raise SettingsError(f"autoreset_mode is one of {names}, not {short_repr(autoreset_mode)}") from None
        self.envs, self.num_envs = list(envs), len(envs)
        first = envs[0]
        self.metadata = {**first.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = first.render_mode
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        for env in self.envs:
            env.observation_space = first.observation_space  # whose bounds take four times the memory of an observation
        self.action_space = batch_space(first.action_space, self.num_envs)
        self._threads = threads
        self._start_threads()

    def _start_threads(self) -> None:
        count = min(self._threads or cores(), self.num_envs)
        self._pool = ThreadPoolExecutor(count - 1, "magical_mj") if count > 1 else None
        self._helpers = count - 1

    def __getstate__(self) -> dict[str, Any]:
        """For copying and pickling: everything but the threads, and what is made when it is asked for."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_pool", "observation_space")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._start_threads()

    def __copy__(self) -> VectorEnv:
        """As a deep copy: two vectors that step the same worlds would disturb each other."""
        return copy.deepcopy(self)

    @cached_property
    def observation_space(self) -> spaces.Space[Any]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The space of all observations, which is made when it is asked for: its bounds take memory."""
        return batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts episodes in all worlds, or in those of ``options["reset_mask"]``.

        Args:
            seed: of the first world, the others have the next ones; or one for each world.
            options: "reset_mask", an array of bools, shape (num_envs,); the others are those of `MagicalEnv.reset`, for
                all of these worlds: "scene", "state" or "variation".

        Raises:
            InvalidSeedError, InvalidSceneError, StateError: accordingly.
            SettingsError: if there is not one seed, or entry of the mask, for each world; if the options are no dict.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        known = check_options(options, "reset_mask", *STARTS)
        mask, seeds = check_mask(known.get("reset_mask"), self.num_envs), world_seeds(seed, self.num_envs)
        start = {name: known[name] for name in STARTS if name in known}
        rows = self._rows()
        infos: list[dict[str, Any] | None] = [None] * self.num_envs

        def reset_world(world: int) -> None:
            env = self.envs[world]
            if mask[world]:
                infos[world] = env.reset(seed=seeds[world], options=start)[1]
            env.observe(rows[world])

        self.each_world(reset_world)
        return self._with_instructions(), self._batched(infos)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One action in every world, or with NEXT_STEP a reset where the episode has ended.

        Args:
            actions: numbers in 0..17, shape (num_envs,); or vectors, shape (num_envs, 3), where actions are continuous.

        Returns:
            Observations, rewards, whether episodes terminated (never) and were truncated, and infos.

        Raises:
            InvalidActionError: if an action is invalid; no world is stepped.
            PhysicsError: if a simulation becomes unstable, which ends its episode.
            ResetNeeded: before the first reset, and with DISABLED where an episode has ended.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        numbers = self._checked(actions)
        over = [env.over for env in self.envs]
        if self.autoreset_mode != AutoresetMode.NEXT_STEP and any(over):
            raise ResetNeeded("episodes have ended: reset these worlds with options={'reset_mask': ...}")
        rows = self._rows()
        rewards, ended = np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)
        infos: list[dict[str, Any] | None] = [None] * self.num_envs
        final: dict[int, dict[str, Any]] = {}
        same_step = self.autoreset_mode == AutoresetMode.SAME_STEP

        def step_world(world: int) -> None:
            env = self.envs[world]
            if over[world]:  # only in the mode NEXT_STEP
                infos[world] = env.reset()[1]
            else:
                last = env.advance(numbers[world])
                rewards[world], _, ended[world], infos[world] = env.outcome(last=last)
                if last and same_step:
                    final[world] = {"final_obs": env.observe(), "final_info": infos[world]}
                    infos[world] = env.reset()[1]
            env.observe(rows[world])

        self.each_world(step_world)
        batched: dict[str, Any] = {}
        for world in sorted(final):
            batched = self._add_info(batched, final[world], world)
        return self._with_instructions(), rewards, np.zeros_like(ended), ended, {**self._batched(infos), **batched}

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """What a method of each world returns, or the attributes of this name."""
        values = (env.get_wrapper_attr(name) for env in self.envs)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """An attribute of each world."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Sets an attribute of each world: to its own of a list or tuple of values, or to the same value.

        Raises:
            SettingsError: if there is not one value for each world.
        """
        each = list(values) if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise SettingsError(f"there are {self.num_envs} worlds, and {len(each)} values of {name} were given")
        for env, value in zip(self.envs, each, strict=True):
            env.set_wrapper_attr(name, value)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The generators of the worlds, which draw the seeds of their later episodes."""
        return self.get_attr("np_random")

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The seeds of these generators."""
        return self.get_attr("np_random_seed")

    def render(self) -> tuple[Any, ...]:
        """The pictures of all worlds; see `MagicalEnv.render`."""
        return self.call("render")

    def close_extras(self, **kwargs: Any) -> None:
        """Frees the simulations and ends the threads."""
        del kwargs
        for env in self.envs:
            env.close()
        if self._pool is not None:
            self._pool.shutdown()

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; make another one")

    def _checked(self, actions: Any) -> list[Any]:
        """The actions as the worlds take them, before any does."""
        rows = as_array(actions)
        if isinstance(self.single_action_space, spaces.Box) and rows.ndim == 2 and len(rows) == self.num_envs:
            return [self.envs[0].to_action(row) for row in rows]
        fitting = rows.shape == (self.num_envs,) and rows.dtype.kind in "iu" and rows.min() >= 0
        if isinstance(self.single_action_space, spaces.Box) or not fitting or rows.max() >= len(ACTIONS):
            raise InvalidActionError(
                f"actions are {self.num_envs} values of {self.single_action_space}, one for each world, "
                f"not {short_repr(actions)}{tensor_hint(actions)}"
            )
        return rows.tolist()

    def _rows(self) -> list[Any]:
        """Fresh arrays for the observations of all worlds, and each world's places in them."""
        self._observations: Any = create_empty_array(self.single_observation_space, self.num_envs, np.empty)
        if not isinstance(self._observations, dict):
            return list(self._observations)
        arrays = {name: part for name, part in self._observations.items() if isinstance(part, np.ndarray)}
        return [dict(zip(arrays, column, strict=True)) for column in zip(*arrays.values(), strict=True)]

    def _with_instructions(self) -> Any:
        """The observations of all worlds; instructions are no arrays, and are put in here."""
        if isinstance(self._observations, dict) and "instruction" in self._observations:
            self._observations["instruction"] = tuple(env.instruction for env in self.envs)
        return self._observations

    def each_world(self, do: Callable[[int], None]) -> None:
        """Does something in every world, by its number, with all threads. Raises the first error when all are done.

        Each takes the next world when it is done with one, and none waits for a thread that has not begun: beside other
        work the system may let a thread wait for as long as many steps take.
        """
        worlds = iter(range(self.num_envs))  # which all threads share

        def work() -> None:
            for world in worlds:
                do(world)

        futures = [self._pool.submit(work) for _ in range(self._helpers)] if self._pool else []
        try:
            work()
        finally:
            errors = [None if future.cancel() else future.exception() for future in futures]
        for error in filter(None, errors):
            raise error

    def _batched(self, infos: Sequence[dict[str, Any] | None]) -> dict[str, Any]:
        """The infos as Gymnasium batches them: an array for each key, and one that says which worlds have it."""
        known = [info for info in infos if info is not None]
        if len(known) < self.num_envs:
            batched: dict[str, Any] = {}
            for world, info in enumerate(infos):
                batched = self._add_info(batched, info or {}, world)
            return batched
        types = {key: object if isinstance(value, str) else None for key, value in known[0].items()}
        arrays = {key: np.array([info[key] for info in known], dtype) for key, dtype in types.items()}
        return arrays | {f"_{key}": np.ones(self.num_envs, np.bool_) for key in arrays}


def world_seeds(seed: Any, worlds: int) -> list[int | None]:
    """A seed for each world: from `seed` up, or those of a sequence."""
    if seed is None:
        return [None] * worlds
    if isinstance(seed, list | tuple | range) or (isinstance(seed, np.ndarray) and seed.ndim > 0):
        if len(seed) != worlds:
            raise SettingsError(f"there are {worlds} worlds, and {len(seed)} seeds were given")
        return [None if value is None else check_seed(value) for value in seed]
    first = check_seed(seed)
    return [first + world for world in range(worlds)]


def check_mask(mask: Any, worlds: int) -> NDArray[np.bool_]:
    """For which worlds the mask of bools is true; without a mask all of them."""
    if mask is None:
        return np.ones(worlds, np.bool_)
    entries = as_array(mask)
    if entries.dtype != np.bool_ or entries.shape != (worlds,):
        raise SettingsError(f"reset_mask must hold {worlds} bools, one for each world, not {short_repr(mask)}")
    return entries
