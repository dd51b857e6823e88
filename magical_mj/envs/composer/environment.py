"""`Environment`: composer's environment, which knows its scene and saves and restores its states.

A control step writes the controls once and runs all substeps in one call of MuJoCo: composer's own Python loop over
substeps takes longer than the physics. Environments with users' hooks, or with observables that have a buffer or a
delay, still use composer's loop.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import dm_env
import numpy as np
from dm_control.rl.control import PhysicsError
from numpy.typing import NDArray

from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.engine.settings import EnvironmentSettings
from magical_mj.engine.simulation import Simulation
from magical_mj.engine.state import State, check_state
from magical_mj.envs.composer.internals import OpenEnvironment
from magical_mj.envs.composer.observables import CurrentObservable, CurrentUpdater
from magical_mj.envs.composer.task import SceneTask
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene
from magical_mj.scene.state_vector import CAMERAS
from magical_mj.utils.errors import ClosedError, SettingsError, StateError, check_name
from magical_mj.variants import check_seed


class Environment(OpenEnvironment):
    """A composer environment that knows its scene. Make one with `magical_mj.load` or `load_scene`."""

    task: SceneTask

    def __init__(self, settings: EnvironmentSettings, first: Scene, seed: int) -> None:
        """Compiles the first scene.

        Args:
            settings: the settings of the environment.
            first: the scene of the first episode.
            seed: the seed of the generator that draws the seeds of later scenes.
        """
        self._compiled: tuple[Hashable, Simulation] | None = None
        super().__init__(
            SceneTask(settings, first),
            random_state=np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed))),
            strip_singleton_obs_buffer_dim=True,
        )

    @property
    def physics(self) -> Simulation:
        """The simulation. A reset may replace it: whoever changes its model does so in a hook, at every episode."""
        self._open()
        return super().physics

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self.task.world.read(self._open().data.qpos)

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self.task.world.scene

    @property
    def horizon(self) -> int | None:
        """Number of control steps of an episode; None if it never ends."""
        return self.task.horizon

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now; an `InvalidSceneError` for plain scenes."""
        return self.task.score(self._open())

    def render(self, view: str = "allo", size: int = 384, *, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the present state in a fresh array or in `out`. Shape (size, size, 3), uint8 RGB, top row first.

        Args:
            view: "ego" or "allo", the flat views of the benchmark, or "scene", a 3-D view from above a corner.
            size: pixels per side.
            out: the array to write to.

        Raises:
            UnknownNameError, SettingsError, RenderingError: for another view, size or array; without OpenGL.
        """
        check_name("view", view, CAMERAS)
        return self._open().draw(view, check_size(size, "size"), out)

    def reset(
        self, *, seed: int | None = None, scene: Scene | None = None, state: State | None = None
    ) -> dm_env.TimeStep:
        """Starts an episode in `scene`, or in the scene of `seed`, or else in a scene drawn by the environment.

        Args:
            seed: the seed of this episode's scene; scenes of later episodes do not depend on it.
            scene: the scene in which to start.
            state: a state to continue from: as `set_state`, but returns a first time step with its observation.

        Raises:
            InvalidSceneError, InvalidSeedError, StateError, SettingsError: if it is invalid; if there is more than one.
        """
        self._open()
        given = [name for name, value in (("seed", seed), ("scene", scene), ("state", state)) if value is not None]
        if len(given) > 1:
            raise SettingsError(f"an episode starts from one of seed, scene and state, not from {' and '.join(given)}")
        if state is not None:
            check_state(state)
            if self.horizon is not None and state.steps >= self.horizon:
                raise StateError(f"the episode of this state is over, after {state.steps} steps; give an earlier state")
            self.set_state(state)
            return dm_env.restart(self._updater.get_observation())
        if scene is not None:
            self.task.settings.check(scene)
            self.task.next_scene, self.task.next_seed = scene, None
        elif seed is not None:
            self.task.set_next_seed(check_seed(seed))
        return super().reset()

    def get_state(self) -> State:
        """The present state of the episode, exactly. Takes about 1/40 of a step's time."""
        return State(self.initial_scene, self.task.steps, self._open().save())

    def set_state(self, state: State) -> None:
        """Restores a state of this environment, or of another one with the same task: what follows is exactly the same.

        Takes half a step's time, or as long as a reset if the state has another scene than the present one. The
        environments may have different observations. The generator of later scenes stays as it is; no hook is called.

        Raises:
            StateError, InvalidSceneError: if it is none of this task. A damaged one of another scene ends the episode.
        """
        self._open()
        check_state(state)
        if self.task.next_scene is not None or state.scene != self.initial_scene:
            self.task.settings.check(state.scene)
            self.over = True  # until everything below has succeeded
            self.task.start(state.scene)
            self.recompile()
        self._open().restore(state.simulation)
        self.task.steps = int(state.steps)
        self._updater.reset(self._open(), self.random_state)
        self.over = self.task.should_terminate_episode(self._open())

    def clone(self) -> Environment:
        """A copy in the same state, in as long as loading takes. Both behave the same, also in later episodes.

        Raises:
            StateError: if users have changed the hooks, observables or the MJCF tree of this environment.
        """
        return _copied(*self.__reduce__()[1])

    def __reduce__(self) -> tuple[Any, ...]:
        """For copying and pickling: the settings, the generator, and the state of the episode if one has begun."""
        self._open()
        own_observables = self._is_plain and len(self._enabled()) == len(self.task.observables)
        if self.user_hooks() or not own_observables or self.task.world.tree is not None:
            raise StateError(
                "an environment with hooks, changed observables or a changed MJCF tree cannot be copied or pickled: "
                "load another one, make the same changes, and call its set_state() with this one's get_state()"
            )
        begun = None if self.task.next_scene is not None else self.get_state()
        now = self.random_state.get_state(legacy=False), self.task.seed, self.task.next_seed
        return _copied, (self.task.settings, self.initial_scene, now, begun)

    def step(self, action: Any) -> dm_env.TimeStep:
        """One action of 1/8 s. After the last step of an episode, the next call starts another one.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            dm_control.rl.control.PhysicsError: if the simulation becomes unstable, which ends the episode.
        """
        if self.over:  # if this reset failed, composer's own would let the episode that is over go on
            return self.reset()
        simulation = self._open()
        try:
            if self.extra_hooks or not self._is_plain:
                return super().step(action)
            self.task.before_step(simulation, action, self.random_state)
            simulation.step(SUBSTEPS)
        except PhysicsError:
            self.over = True  # MuJoCo has put everything back to the start
            raise
        self.over = self.task.should_terminate_episode(simulation)
        kind = dm_env.StepType.LAST if self.over else dm_env.StepType.MID
        reward, discount = self.task.get_reward(simulation), self.task.get_discount(simulation)
        return dm_env.TimeStep(kind, reward, discount, self._updater.get_observation())

    def close(self) -> None:
        """Frees the simulation. Closing twice is fine."""
        if self._compiled is not None:
            self._compiled[1].free()
        self._compiled = None
        super().close()

    def _open(self) -> Simulation:
        if self._compiled is None:
            raise ClosedError("the environment is closed, or its model could not be compiled; load another one")
        return self._compiled[1]

    def _enabled(self) -> dict[str, Any]:
        return {name: entry for name, entry in self.task.observables.items() if entry.enabled}

    def make_updater(self) -> Any:
        """`CurrentUpdater` if all observables are immediate, else composer's updater."""
        enabled = self._enabled()
        current = all(isinstance(entry, CurrentObservable) and entry.is_immediate for entry in enabled.values())
        self._is_plain = current and not self.user_hooks()
        self._updater = CurrentUpdater(enabled) if current else super().make_updater()
        return self._updater

    def simulate(self) -> Simulation:
        """The simulation of the task's present world, exactly as if newly compiled. It may replace the previous one.

        Compiling takes more than ten times as long as rewriting a model, and most episodes differ in numbers only.
        If users may have changed the model, by a hook or in composer's tree, it is always compiled.
        """
        world = self.task.world
        if self._compiled is not None:
            structure, simulation = self._compiled
            changed = world.tree is not None or not simulation.is_ours or self.user_hooks()
            if world.structure == structure and not changed:
                world.rewrite(simulation.model.ptr, simulation.data.ptr)
                return simulation
            simulation.free()
            self._compiled = None  # also if it cannot be compiled
        self._compiled = world.structure, Simulation.of(world)
        return self._compiled[1]


def _copied(settings: EnvironmentSettings, first: Scene, seeds: tuple[Any, ...], begun: State | None) -> Environment:
    """A copy of an environment, as `Environment.__reduce__` describes it."""
    env = Environment(settings, first, seed=0)
    if begun is not None:
        env.set_state(begun)
    generator, env.task.seed, env.task.next_seed = seeds
    env.random_state.set_state(generator)
    return env
