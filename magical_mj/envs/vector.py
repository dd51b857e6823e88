"""A Gymnasium vector environment on all cores: threads of one process step and draw its environments.

MuJoCo and the software renderer release Python's global interpreter lock, so threads are enough. Each environment is a
`MagicalEnv`, with the same results to the bit as on its own. MuJoCo's own batches (`mujoco.batch`) need the same layout
for all models of a batch, and variants change the layout from episode to episode.
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
from gymnasium.envs.registration import EnvSpec
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space, create_empty_array
from numpy.typing import NDArray

from magical_mj.actions import as_array, tensor_hint
from magical_mj.envs.gymnasium_env import STARTS, MagicalEnv, check_options
from magical_mj.envs.registration import env_id
from magical_mj.utils.errors import ClosedError, InvalidActionError, SettingsError, as_integer, short_repr
from magical_mj.utils.parallel import cores
from magical_mj.variants import check_seed
from magical_mj.wrappers import check_id


def make_vec(
    environment: str, num_envs: int = 1, *, variant: str | None = None, preset: str | None = None, **settings: Any
) -> VectorEnv:
    """A vector environment of copies of one environment, stepped on all cores.

    Args:
        environment: an id, such as "magical_mj/FindDupe-Demo-LoRes4E-v0", or a task.
        num_envs: the number of environments.
        variant: the task's variant, by default Demo; ids contain theirs.
        preset: the observation preset, by default LoRes4E; ids contain theirs.
        settings: the arguments of `make_vector` and of `MagicalEnv`.

    Example:
        >>> envs = magical_mj.make_vec("FindDupe", 4, renderer="software")
        >>> observations, infos = envs.reset(seed=0)
        >>> observations.shape
        (4, 96, 96, 12)

    Raises:
        SettingsError: for `vectorization_mode`, which is an argument of `gymnasium.make_vec`, and for the reasons given
            by `make_vector`.
    """
    if "vectorization_mode" in settings:
        raise SettingsError(
            "magical_mj.make_vec makes the vector environment on all cores: for another one, call "
            "gymnasium.make_vec(id, ..., vectorization_mode=...)"
        )
    if isinstance(environment, str) and environment in gymnasium.registry:
        id_ = environment
        settings |= {name: value for name, value in (("variant", variant), ("preset", preset)) if value is not None}
    else:
        id_ = env_id(environment, "Demo" if variant is None else variant, "LoRes4E" if preset is None else preset)
    return cast("VectorEnv", gymnasium.make_vec(id_, num_envs, "vector_entry_point", **settings))


def make_vector(
    kind: Callable[..., MagicalEnv] = MagicalEnv,
    *,
    num_envs: int = 1,
    threads: int | None = None,
    autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> VectorEnv:
    """The vector entry point of the ids, which `gymnasium.make_vec` calls.

    Args:
        kind: the class of the environments.
        num_envs: the number of environments.
        threads: the number of threads; None: one for each core.
        autoreset_mode: a `gymnasium.vector.AutoresetMode` or its value.
        max_episode_steps: the number of steps of an episode, if fewer than the task's horizon.
        settings: the arguments of the class, such as `task`, `renderer` and `image_size`.

    Raises:
        SettingsError: if `num_envs` or `threads` is not an integer of at least 1, or the mode or limit is invalid.
    """
    for name, value in (("num_envs", num_envs), ("threads", threads)):
        if value is not None and as_integer(value, 1) is None:
            raise SettingsError(f"{name} must be an integer of at least 1, not {short_repr(value)}")
    envs = [kind(limit=max_episode_steps, **settings) for _ in range(num_envs)]
    return VectorEnv(envs, threads, autoreset_mode)


class VectorEnv(gymnasium.vector.VectorEnv[Any, Any, Any]):
    """Environments that are stepped and drawn together. Each has the same results to the bit as on its own.

    `reset(seed=7)` resets the environments with the seeds 7, 8, 9..., and a list gives each its own seed. Observations,
    rewards, infos and the three modes of `gymnasium.vector.AutoresetMode` are those of
    `gymnasium.vector.SyncVectorEnv`. Observations are new arrays at each step. With DISABLED,
    `reset(options={"reset_mask": mask})` resets the masked environments. If an episode has ended, and
    `call("set_state", state)` then restores a state, the episode continues from this state. Copies and pickles have
    their own environments, in the same states.

    If a subclass has a `step` or `reset` of its own, it is called, as in `SyncVectorEnv`.

    Args:
        envs: the environments, with equal spaces. Each may occur once, and has no wrapper.
        threads: the number of threads; None: one for each core.
        autoreset_mode: when an environment starts a new episode after the end of one.

    Attributes:
        envs: the environments.
        autoreset_mode: a `gymnasium.vector.AutoresetMode`.

    Raises:
        SettingsError: for an unknown mode, or if the environments have wrappers, different or nested spaces, or occur
            twice.
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
            raise SettingsError(f"autoreset_mode must be one of {names}, not {short_repr(autoreset_mode)}") from None
        self.envs, self.num_envs = _checked_envs(envs), len(envs)
        self._is_own = [_is_own(env) for env in self.envs]
        self._ended = np.zeros(self.num_envs, np.bool_)  # the episodes of users' own environments
        self._instructions = dict[int, str]()  # of users' own environments
        self._views: list[Any] | None = None
        self._spec: EnvSpec | None = None
        first = self.envs[0]
        self.metadata = {**first.metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = first.render_mode
        self.single_observation_space, self.single_action_space = first.observation_space, first.action_space
        for env in self.envs:
            env.observation_space = first.observation_space  # its bounds need four times an observation's memory
        self.action_space = batch_space(first.action_space, self.num_envs)
        self._threads = threads
        self._start_threads()

    @property
    def spec(self) -> EnvSpec | None:
        """The spec with the arguments of `gymnasium.make_vec`, which may not contradict the id."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec) -> None:  # pyright: ignore[reportIncompatibleVariableOverride]
        try:
            check_id(spec.id, spec.kwargs)
        except SettingsError:
            self.close()
            raise
        self._spec = spec

    def _start_threads(self) -> None:
        count = min(self._threads or cores(), self.num_envs)
        self._pool = ThreadPoolExecutor(count - 1, "magical_mj") if count > 1 else None
        self._helpers = count - 1

    def __getstate__(self) -> dict[str, Any]:
        """For copying and pickling. Threads cannot be copied, and `observation_space` is made again on demand."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_pool", "observation_space")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._start_threads()

    def __copy__(self) -> VectorEnv:
        """A deep copy: two vector environments that share environments would disturb each other."""
        return copy.deepcopy(self)

    @cached_property
    def observation_space(self) -> spaces.Space[Any]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The space of the batched observations. It is made on demand, since its bounds take much memory."""
        return batch_space(self.single_observation_space, self.num_envs)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Starts episodes in all environments, or in those selected by ``options["reset_mask"]``.

        Args:
            seed: the seed of the first environment, and the next integers for the others; or a sequence with a seed
                for each environment.
            options: "reset_mask", an array of bools, shape (num_envs,); and the options of `MagicalEnv.reset` for all
                of these environments: "scene", "state" or "variation".

        Raises:
            InvalidSeedError, InvalidSceneError, StateError: for the reasons given by `magical_mj.Engine.reset`.
            SettingsError: if the number of seeds or of mask entries is not `num_envs`, or the options are invalid.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        known = check_options(options, "reset_mask", *STARTS)
        mask, seeds = check_mask(known.get("reset_mask"), self.num_envs), environment_seeds(seed, self.num_envs)
        start = {name: known[name] for name in STARTS if name in known}
        rows, before = self._rows()
        infos: list[dict[str, Any] | None] = [None] * self.num_envs

        def reset(index: int) -> None:
            if mask[index]:
                infos[index] = self._reset(index, rows[index], seed=seeds[index], options=start)
            elif before is not None and self._is_own[index]:
                self._put(index, before[index], rows[index])
            else:
                self.envs[index].observe(rows[index])

        self.each_environment(reset)
        return self._with_instructions(), self._batched(infos)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Executes an action in each environment. With NEXT_STEP, environments whose episode has ended are reset.

        Args:
            actions: numbers in 0..17, shape (num_envs,); or with continuous actions vectors, shape (num_envs, 3).

        Returns:
            Observations, rewards, terminated (always False), truncated, and infos.

        Raises:
            InvalidActionError: if an action is invalid. Then no environment is stepped.
            PhysicsError: if a simulation becomes unstable. This ends its episode.
            ResetNeeded: before the first reset, and with DISABLED if an episode has ended.
            ClosedError: if the environment is closed.
        """
        self._check_open()
        checked = self._checked(actions)
        over = [self._ended[index] or env.engine.over for index, env in enumerate(self.envs)]
        if self.autoreset_mode != AutoresetMode.NEXT_STEP and any(over):
            raise ResetNeeded("episodes have ended: reset these environments with options={'reset_mask': ...}")
        rows, _ = self._rows()
        rewards, terminated, truncated = np.zeros(self.num_envs), *np.zeros((2, self.num_envs), np.bool_)
        infos: list[dict[str, Any] | None] = [None] * self.num_envs
        final: dict[int, dict[str, Any]] = {}
        same_step = self.autoreset_mode == AutoresetMode.SAME_STEP

        def step(index: int) -> None:
            env, row = self.envs[index], rows[index]
            if over[index]:  # only in the mode NEXT_STEP
                infos[index] = self._reset(index, row)
                return
            own = self._is_own[index]
            outcome = env.step(checked[index]) if own else env.step(checked[index], row)
            seen, rewards[index], terminated[index], truncated[index], infos[index] = outcome
            if own:
                self._put(index, seen, row)
            ended = bool(terminated[index] or truncated[index])
            self._ended[index] = ended and own
            if ended and same_step:
                final[index] = {"final_obs": copy.deepcopy(seen), "final_info": infos[index]}
                infos[index] = self._reset(index, row)

        self.each_environment(step)
        batched: dict[str, Any] = {}
        for index in sorted(final):
            batched = self._add_info(batched, final[index], index)
        return self._with_instructions(), rewards, terminated, truncated, {**self._batched(infos), **batched}

    def _reset(self, index: int, row: Any, **arguments: Any) -> dict[str, Any]:
        """Resets an environment, writes its observation into `row`, and returns its info."""
        env = self.envs[index]
        if self._is_own[index]:
            seen, info = env.reset(**arguments)
            self._put(index, seen, row)
        else:
            _, info = env.reset(**arguments, out=row)
        self._ended[index] = False
        return info

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """The attribute of this name of each environment. Methods are called with these arguments."""
        values = (env.get_wrapper_attr(name) for env in self.envs)
        return tuple(value(*args, **kwargs) if callable(value) else value for value in values)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """The attribute of this name of each environment."""
        return self.call(name)

    def set_attr(self, name: str, values: Any) -> None:
        """Sets an attribute of each environment.

        Args:
            name: the attribute.
            values: a list or tuple with a value for each environment, or one value for all.

        Raises:
            SettingsError: if the number of values is not `num_envs`.
        """
        each = list(values) if isinstance(values, list | tuple) else [values] * self.num_envs
        if len(each) != self.num_envs:
            raise SettingsError(f"there are {self.num_envs} environments, and {len(each)} values of {name} were given")
        for env, value in zip(self.envs, each, strict=True):
            env.set_wrapper_attr(name, value)

    @property
    def np_random(self) -> tuple[np.random.Generator, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The environments' generators, which draw the seeds of later episodes."""
        return self.get_attr("np_random")

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The seeds of these generators."""
        return self.get_attr("np_random_seed")

    def render(self) -> tuple[Any, ...]:
        """The pictures of all environments; see `MagicalEnv.render`."""
        return self.call("render")

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the environments and ends the threads."""
        del kwargs
        for env in self.envs:
            env.close()
        if self._pool is not None:
            self._pool.shutdown()

    def _check_open(self) -> None:
        if self.closed:
            raise ClosedError("the environment is closed; make another one")

    def _checked(self, actions: Any) -> list[Any]:
        """The actions of the environments. All are checked before any environment is stepped."""
        rows, space = as_array(actions), self.single_action_space
        fitting = rows.ndim == len(space.shape or ()) + 1 and len(rows) == self.num_envs
        if isinstance(space, spaces.Discrete):
            fitting = fitting and rows.dtype.kind in "iu" and rows.min() >= 0 and rows.max() < space.n
        if not fitting:
            raise InvalidActionError(
                f"actions must be {self.num_envs} values of {space}, one for each environment, "
                f"not {short_repr(actions)}{tensor_hint(actions)}"
            )
        if rows.ndim == 1:
            return rows.tolist()
        for row, env, own in zip(rows, self.envs, self._is_own, strict=True):
            if not own:
                env.to_action(row)
        return list(rows)

    def _rows(self) -> tuple[list[Any], list[Any] | None]:
        """Makes fresh arrays for observations. Returns each environment's views into them, and into the last ones."""
        before = self._views
        self._observations: Any = create_empty_array(self.single_observation_space, self.num_envs, np.empty)
        if isinstance(self._observations, dict):
            arrays = {name: part for name, part in self._observations.items() if isinstance(part, np.ndarray)}
            columns = zip(*arrays.values(), strict=True)
            self._views = [dict(zip(arrays, column, strict=True)) for column in columns]
        else:
            self._views = list(self._observations)
        return self._views, before

    def _put(self, index: int, observation: Any, row: Any) -> None:
        """Copies the observation that a user's own environment returned into its row."""
        if not isinstance(row, dict):
            np.copyto(row, observation)
            return
        for name, part in row.items():
            np.copyto(part, observation[name])
        if "instruction" in observation:
            self._instructions[index] = observation["instruction"]

    def _with_instructions(self) -> Any:
        """The batched observations. Instructions are text instead of arrays, and are added here."""
        if isinstance(self._observations, dict) and "instruction" in self._observations:
            own = self._instructions
            sentences = (own.get(index, env.instruction) for index, env in enumerate(self.envs))
            self._observations["instruction"] = tuple(sentences)
        return self._observations

    def each_environment(self, do: Callable[[int], None]) -> None:
        """Calls a function with the index of each environment, on all threads.

        After each call, a thread takes the next index. The last call does not wait for threads that have not started:
        on a busy machine, starting a thread can take longer than many steps. If calls fail, the first error is raised
        after all have finished.
        """
        indices = iter(range(self.num_envs))  # shared by all threads

        def work() -> None:
            for index in indices:
                do(index)

        futures = [self._pool.submit(work) for _ in range(self._helpers)] if self._pool else []
        try:
            work()
        finally:
            errors = [None if future.cancel() else future.exception() for future in futures]
        for error in filter(None, errors):
            raise error

    def _batched(self, infos: Sequence[dict[str, Any] | None]) -> dict[str, Any]:
        """The infos in Gymnasium's format: an array for each key, and a mask of the environments that have the key."""
        known = [info for info in infos if info is not None]
        nested = any(isinstance(value, dict) for value in known[0].values()) if known else False
        if nested or len(known) < self.num_envs or any(info.keys() != known[0].keys() for info in known):
            batched: dict[str, Any] = {}
            for index, info in enumerate(infos):
                batched = self._add_info(batched, info or {}, index)
            return batched
        types = {key: object if isinstance(value, str) else None for key, value in known[0].items()}
        arrays = {key: np.array([info[key] for info in known], dtype) for key, dtype in types.items()}
        return arrays | {f"_{key}": np.ones(self.num_envs, np.bool_) for key in arrays}


def _is_own(env: MagicalEnv) -> bool:
    """Whether `step` or `reset` is a user's own method. Such methods may change whatever they return."""
    functions = (getattr(method, "__func__", None) for method in (env.step, env.reset))
    return not all(getattr(function, "__module__", "").startswith("magical_mj.") for function in functions)


def _checked_envs(envs: Sequence[Any]) -> list[MagicalEnv]:
    """The environments. Raises a `SettingsError` unless they can be stepped together."""
    if not envs:
        raise SettingsError("a vector environment needs at least one environment")
    for env in envs:
        if not isinstance(env, MagicalEnv):
            raise SettingsError(
                f"VectorEnv takes environments such as magical_mj.MagicalEnv(...), not {short_repr(env)}: "
                "gymnasium.vector.SyncVectorEnv takes any, also with wrappers"
            )
    if len({id(env) for env in envs}) < len(envs):
        raise SettingsError("an environment occurs twice: make one for each place, or copy it with clone()")
    first = envs[0]
    for env in envs[1:]:
        for what in ("observation_space", "action_space"):
            if getattr(env, what) != getattr(first, what):
                both = f"{short_repr(getattr(first, what))} and {short_repr(getattr(env, what))}"
                raise SettingsError(f"the environments differ in the {what}: {both}")
    space = first.observation_space
    parts = space.spaces.values() if isinstance(space, spaces.Dict) else (space,)
    if not all(isinstance(part, spaces.Text) or (isinstance(part, spaces.Box) and part.shape) for part in parts):
        raise SettingsError(
            f"observations must be an array or a dict of arrays, not {short_repr(space)}: use "
            "gymnasium.vector.SyncVectorEnv"
        )
    return list(envs)


def environment_seeds(seed: Any, count: int) -> list[int | None]:
    """A seed for each of `count` environments: `seed` and the next integers, or the entries of a sequence."""
    if seed is None:
        return [None] * count
    if isinstance(seed, list | tuple | range) or (isinstance(seed, np.ndarray) and seed.ndim > 0):
        if len(seed) != count:
            raise SettingsError(f"there are {count} environments, and {len(seed)} seeds were given")
        return [None if value is None else check_seed(value) for value in seed]
    first = check_seed(seed)
    return [first + index for index in range(count)]


def check_mask(mask: Any, count: int) -> NDArray[np.bool_]:
    """A mask of `count` environments as an array; without a mask, all entries are true."""
    if mask is None:
        return np.ones(count, np.bool_)
    entries = as_array(mask)
    if entries.dtype != np.bool_ or entries.shape != (count,):
        raise SettingsError(f"reset_mask must hold {count} bools, one for each environment, not {short_repr(mask)}")
    return entries
