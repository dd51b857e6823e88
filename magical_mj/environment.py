"""The dm_control environment, and how it is loaded.

A control step writes the controls once and lets MuJoCo do all its substeps in one call; composer's own Python
loop over substeps costs more than the physics. Whoever listens to substeps (a hook of their own, an observable
with a buffer or a delay) still gets composer's loop.
"""

from __future__ import annotations

import secrets
import weakref
from collections import OrderedDict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import dm_env
import numpy as np
from dm_control import composer
from dm_control.composer.environment import HOOK_NAMES
from dm_env import specs
from numpy.typing import NDArray

from magical_mj.errors import unknown_name
from magical_mj.observations import OBSERVATIONS, VIEWS
from magical_mj.registry import check_rules, environment_axes, sample_scene, task_spec
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene
from magical_mj.scene_task import REWARDS, CurrentObservable, Reward, SceneTask
from magical_mj.simulation import Simulation, SimulationCache
from magical_mj.tasks.spec import Rules
from magical_mj.variants import check_seed


class Environment(composer.Environment):
    """A composer environment that knows its scene. Make one with `magical_mj.load` or `load_scene`."""

    task: SceneTask

    def __init__(self, task: SceneTask, seed: int | None = None) -> None:
        """Compiles the task's first scene.

        Args:
            task: what to run.
            seed: of the generator that draws the seeds of scenes; any size; None: from the system's entropy.
        """
        self._simulations = SimulationCache()
        super().__init__(
            task,
            random_state=np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed))),
            strip_singleton_obs_buffer_dim=True,
        )

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self.task.world.read(self._open_physics().data.qpos)

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self.task.world.scene

    @property
    def horizon(self) -> int | None:
        """Number of control steps of an episode; None if it never ends."""
        return self.task.horizon

    @property
    def compilations(self) -> int:
        """How many models were compiled so far; all other resets rewrote one."""
        return self._simulations.compiled

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now; an `InvalidSceneError` for plain scenes."""
        return self.task.score(self._open_physics())

    def render(self, view: str = "allo", size: int = 384, *, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the world as it is now, in a fresh array or in `out`.

        Shape (size, size, 3), RGB, top row first.
        """
        if view not in VIEWS:
            raise unknown_name("view", view, VIEWS)
        return self._open_physics().draw(view, check_size(size), out)

    def reset(self, *, seed: int | None = None, scene: Scene | None = None) -> dm_env.TimeStep:
        """Starts an episode in `scene`, or in the scene of `seed`, or else in the next one that is drawn."""
        self._open_physics()
        if scene is not None:
            self.task.check(scene)
            self.task.next_scene = scene
        elif seed is not None:
            self.task.next_scene = self.task.source(check_seed(seed))
        return super().reset()

    def step(self, action: Any) -> dm_env.TimeStep:
        """One action of 1/8 s. After the last step of an episode, the next call starts another one.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            dm_control.rl.control.PhysicsError: if the simulation becomes unstable.
        """
        physics = self._open_physics()
        if self._reset_next_step or self._watched:
            return super().step(action)
        self._hooks.before_step(self._physics_proxy, action, self._random_state)
        physics.step(self._n_sub_steps)
        self._hooks.after_step(self._physics_proxy, self._random_state)
        observation = OrderedDict((name, see()) for name, see in self._sight)
        last = self.task.should_terminate_episode(self._physics_proxy)
        self._reset_next_step = last
        return dm_env.TimeStep(
            dm_env.StepType.LAST if last else dm_env.StepType.MID,
            self.task.get_reward(self._physics_proxy),
            self.task.get_discount(self._physics_proxy),
            observation,
        )

    def observation_spec(self) -> OrderedDict[str, specs.Array]:
        """Name, shape and type of each observation. Draws nothing."""
        if self._sees_now():
            return OrderedDict((name, entry.array_spec) for name, entry in self._enabled())
        return super().observation_spec()

    def add_extra_hook(self, hook_name: str, hook_callable: Callable[..., Any]) -> None:
        """Has `hook_callable` called at the moment of this name; see `composer.Environment`."""
        super().add_extra_hook(hook_name, hook_callable)
        self._watch()

    def close(self) -> None:
        """Frees the simulation. Closing twice is fine."""
        self._simulations.free()
        self._physics = None

    def _open_physics(self) -> Simulation:
        if self._physics is None:
            raise RuntimeError("the environment is closed; load another one")
        return self._physics

    def _enabled(self) -> list[tuple[str, Any]]:
        return [(name, entry) for name, entry in self.task.observables.items() if entry.enabled]

    def _sees_now(self) -> bool:
        return all(isinstance(entry, CurrentObservable) and entry.is_immediate for _, entry in self._enabled())

    def _watch(self) -> None:
        """Looks whether anybody listens to substeps."""
        self._watched = not self._sees_now() or self._has_hooks(("before_substep", "after_substep"))

    def _has_hooks(self, names: Iterable[str]) -> bool:
        """Whether anybody but the task listens to one of these."""
        hooks = (getattr(self._hooks, f"_{name}") for name in names)
        return any(hook.entity_hooks or hook.extra_hooks for hook in hooks)

    def _recompile_physics_and_update_observables(self) -> None:
        """Composer's own, less the compiling where a model can be rewritten, and the drawing that nobody looks at."""
        self._physics = self._simulations.simulation(self.task.world, fresh=self._has_hooks(HOOK_NAMES))
        self._physics_proxy = weakref.proxy(self._physics)
        self._n_sub_steps = self.task.physics_steps_per_control_step
        self._hooks.refresh_entity_hooks()
        self._hooks.after_compile(self._physics_proxy, self._random_state)
        self._observation_updater = self._make_observation_updater()

    def _reset_attempt(self) -> dm_env.TimeStep:
        first = super()._reset_attempt()
        self._sight = [
            (name, entry.observation_callable(self._physics_proxy, self._random_state))
            for name, entry in self._enabled()
        ]
        self._watch()
        return first


def load(
    task: str,
    variant: str = "Demo",
    *,
    seed: int | None = None,
    scene: Scene | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
    reward: Reward = "none",
    rules: Rules = "paper",
) -> Environment:
    """A dm_env environment of the benchmark.

    Args:
        task: one of `magical_mj.TASKS`.
        variant: one of `magical_mj.VARIANTS` that the task has.
        seed: the first episode starts in `sample_scene(task, variant, seed)`, the following ones in scenes
            drawn from a generator with this seed. None: seeded from the system's entropy.
        scene: start every episode in this scene instead.
        observations: any of "ego", "allo" and "state".
        image_size: side of the pictures in pixels.
        reward: "none" (always 0: the benchmark has no reward) or "score" (the score, at the last step).
        rules: "paper", or "released" for the scores and horizons of the original's released code.

    Raises:
        UnknownNameError: for an unknown task, variant, observation, reward or rules, or an unsupported pair.
        InvalidSceneError: if the scene is illegal or not one of the task.
        ValueError: for a bad image size or seed.
    """
    spec = task_spec(task)
    environment_axes(task, variant)
    rules = check_rules(rules)

    def source(number: int) -> Scene:
        return sample_scene(task, variant, number) if scene is None else scene

    first = source(_check_seed(seed))
    task_of_scenes = SceneTask(
        first,
        source,
        check=spec.check,
        horizon=spec.horizon(rules),
        score=lambda initial, final: spec.score(initial, final, rules),
        **_checked(observations, image_size, reward),
    )
    return Environment(task_of_scenes, seed)


def load_scene(
    scene: Scene,
    *,
    seed: int | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
) -> Environment:
    """A dm_env environment that starts every episode in `scene`: no task, so no score and no horizon.

    Raises:
        UnknownNameError, InvalidSceneError, ValueError: as `load`.
    """
    _check_seed(seed)
    return Environment(SceneTask(scene, lambda _: scene, **_checked(observations, image_size)), seed)


def _check_seed(seed: int | None) -> int:
    """`seed` if it is one, or a fresh one for None."""
    return secrets.randbits(63) if seed is None else check_seed(seed)


def _checked(observations: Sequence[str], image_size: int, reward: Reward = "none") -> dict[str, Any]:
    """The arguments that `load` and `load_scene` share, or an error for the one that is wrong."""
    if isinstance(observations, str):
        raise unknown_name("tuple of observations", observations, (f"({name!r},)" for name in OBSERVATIONS))
    for name in observations:
        if name not in OBSERVATIONS:
            raise unknown_name("observation", name, OBSERVATIONS)
    if reward not in REWARDS:
        raise unknown_name("reward", reward, REWARDS)
    return {"observations": tuple(observations), "image_size": check_size(image_size), "reward": reward}
