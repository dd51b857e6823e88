"""The composer task: simulates scenes in composer's loop with an engine's physics, and provides observations."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, Final

import mujoco
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_control.rl.control import PhysicsError
from dm_env import specs

from magical_mj.actions import ACTIONS
from magical_mj.assets.contacts import SUBSTEPS, TIMESTEP
from magical_mj.assets.scene_model import SceneModel, Structure
from magical_mj.engine import State
from magical_mj.engine.episode import Setup
from magical_mj.engine.simulation import Simulation, write_numbers
from magical_mj.envs.composer.entities import Arena
from magical_mj.envs.composer.observables import STACKS, CurrentObservable, LatestFrames
from magical_mj.observations import OBSERVATIONS, STATE_NAMES, StateEncoder
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.shifts.episode import EpisodeShifts
from magical_mj.tasks.spec import REWARDS, Reward
from magical_mj.utils import errors
from magical_mj.utils.errors import SettingsError, check_name, short_repr
from magical_mj.utils.frozen import FrozenDict

CAMERA_NAMES: Final = {"ego": "robot/ego"}
"""View -> the name of its camera in the compiled tree, if the two differ."""

FIXED_TIMESTEPS: Final = (
    f"the timesteps cannot be changed: motors, friction and contacts are fitted for {SUBSTEPS} substeps of "
    f"{TIMESTEP} s per action. To act less often, repeat actions"
)


@dataclass(frozen=True)
class LoadSettings:
    """The arguments of `load` or `load_scene`, checked."""

    setup: Setup
    strengths: Mapping[str, int]
    observations: Sequence[str]
    image_size: int
    reward: Reward
    renderer: str | None

    def __post_init__(self) -> None:
        """Checks the names, and copies what the caller may change."""
        names = self.observations
        if not isinstance(names, list | tuple):
            raise SettingsError(f'observations must be a list or tuple of names, ("ego",), not {short_repr(names)}')
        for name in names:
            check_name("observation", name, OBSERVATIONS)
        object.__setattr__(self, "observations", tuple(names))
        object.__setattr__(self, "strengths", FrozenDict(self.strengths))
        check_name("reward", self.reward, REWARDS)
        if self.setup.task is not None:
            self.setup.spec.check_reward(self.reward)


class SceneTask(composer.Task):
    """Executes actions and provides observations. With a benchmark task, it also ends and scores episodes.

    If a hook or an observable needs every substep, the ten substeps of an action are substeps of composer.
    Otherwise they are one substep, because composer's own loop takes longer than the physics.

    Attributes:
        horizon: the number of actions of an episode; None if it never ends.
        scene_model: the initial scene of this episode, and its coordinates.
        shifts: the shifts of this episode.
        stepwise: whether an action has ten substeps of composer, as of the last compilation.
        substeps_hooked: whether users have added hooks to substeps.
    """

    def __init__(self, settings: LoadSettings, scene: Scene, shifts: EpisodeShifts) -> None:
        self.settings, self.setup, self.horizon = settings, settings.setup, settings.setup.horizon
        self._remaining = 0.0  # before the last step, for dense rewards
        self._simulation: Simulation | None = None
        self._simulated = 0, 0  # the identities of its model and data, which it keeps alive
        self._compiled: tuple[mujoco.MjModel, mujoco.MjModel] | None = None  # a model and its copy before shifts
        self._structure: Structure | None = None  # that of the compiled model
        self._arena = Arena(scene)
        self.stepwise = self.substeps_hooked = False
        self._observers, self._stacks = list[int](), list[LatestFrames]()
        self.start(scene, shifts)
        self._observables = OrderedDict((name, self._observable(name)) for name in settings.observations)

    def start(self, scene: Scene, shifts: EpisodeShifts, state: State | None = None) -> None:
        """Sets the scene of the next episode, and a state of an episode with this initial scene to continue from."""
        if "state" in self.settings.observations:
            StateEncoder(scene)  # raises an error if the vector is too short, before anything is changed
        self._arena.check(scene)
        self.scene_model, self.shifts, self._state = SceneModel(scene), shifts, state
        self._arena.scene = scene

    def _observable(self, name: str) -> CurrentObservable:
        if name == "state":
            vector = specs.Array((len(STATE_NAMES),), np.float32, name)
            return CurrentObservable(lambda physics: self.simulation(physics).state_vector(), vector)
        size = self.settings.image_size
        if name in STACKS:
            return LatestFrames(lambda physics: self.simulation(physics).draw, name, size)
        picture = specs.BoundedArray((size, size, 3), np.uint8, 0, 255, name)
        return CurrentObservable(lambda physics: self.simulation(physics).draw(name, size), picture)

    def state(self, physics: Any) -> State:
        """The current state of the episode, with the frames of stacks."""
        frames = {name: frames for stack in self._stacks for name, frames in stack.save(physics).items()}
        return replace(self.simulation(physics).get_state(), frames=frames)

    def simulation(self, physics: Any) -> Simulation:
        """The simulation of this episode, which uses composer's model and data."""
        model, data = physics.model.ptr, physics.data.ptr
        simulation = self._simulation
        if simulation is None or self._simulated != (id(model), id(data)):
            self.free()
            self.scene_model.find_in(model)
            renderer = self.settings.renderer
            own = Simulation(self.setup, self.scene_model, model, data, renderer, CAMERA_NAMES)
            if simulation is not None:  # a copy of the physics is in the same episode
                own.take_records(simulation)
            self._simulation, self._simulated = own, (id(model), id(data))
            simulation = own
        self.scene_model.coordinates = simulation.scene_model.coordinates
        simulation.scene_model, simulation.episode_shifts = self.scene_model, self.shifts
        return simulation

    def free(self) -> None:
        """Frees the renderer."""
        if self._simulation is not None:
            self._simulation.free()
        self._simulation = None

    @property
    def root_entity(self) -> Arena:
        """The arena."""
        return self._arena

    @property
    def task_observables(self) -> Mapping[str, observable.Observable]:
        """The observables that `load(observations=...)` names, all enabled."""
        return self._observables

    @property
    def control_timestep(self) -> float:
        """Seconds per action. Setting it raises a `SettingsError`."""
        return 1 / c.CONTROL_RATE

    @control_timestep.setter
    def control_timestep(self, new_value: float) -> None:
        self.set_timesteps(new_value, TIMESTEP)

    @property
    def physics_timestep(self) -> float:
        """Seconds per step of MuJoCo. Setting it raises a `SettingsError`."""
        return TIMESTEP

    @physics_timestep.setter
    def physics_timestep(self, new_value: float) -> None:
        self.set_timesteps(self.control_timestep, new_value)

    def set_timesteps(self, control_timestep: float, physics_timestep: float) -> None:
        """Raises a `SettingsError`: the timesteps are fixed."""
        del control_timestep, physics_timestep
        raise SettingsError(FIXED_TIMESTEPS)

    @property
    def physics_steps_per_control_step(self) -> int:
        """Steps of MuJoCo per action: ten. While composer compiles, its number of substeps per action: ten or one."""
        return 1 if self._arena.compiling and not self.stepwise else SUBSTEPS

    def compile_next(self) -> None:
        """Prepares the next compilation: composer then reads the trees and the number of substeps per action."""
        self._arena.compiling, self._structure = True, None
        self.stepwise, self._observers = self._composition()

    @property
    def outdated(self) -> bool:
        """Whether a compilation is required: for other blocks, or if users changed trees, observables or hooks."""
        other_blocks = self.scene_model.structure != self._structure
        return other_blocks or self._arena.edited or self._composition() != (self.stepwise, self._observers)

    def _composition(self) -> tuple[bool, list[int]]:
        """Whether a hook or an observable needs every substep, and the identities of all observables."""
        watched = self.substeps_hooked or _overrides(self, SceneTask)
        observers = list(self._observables.values())
        for entity in self._arena.iter_entities():
            watched = watched or _overrides(entity, composer.Entity)
            observers += entity.observables.as_dict(fully_qualified=False).values()
        watched = watched or any(map(_in_substeps, observers))
        return watched, list(map(id, observers))

    def initialize_episode_mjcf(self, random_state: np.random.RandomState) -> None:
        """Writes the episode's scene into the trees."""
        del random_state
        self.compile_next()
        self._arena.show(self.scene_model.scene)

    def after_compile(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Raises a `SettingsError` if hooks have changed attributes that the scene determines."""
        del physics, random_state
        self._arena.check_owned()
        self._structure = self.scene_model.structure

    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Writes the scene into the compiled model, and sets the initial state."""
        del random_state
        self._arena.compiled()
        model, data = physics.model.ptr, physics.data.ptr
        if model.opt.timestep != TIMESTEP:
            model.opt.timestep = TIMESTEP
            raise SettingsError(FIXED_TIMESTEPS)
        if self._compiled is not None and self._compiled[0] is model:
            write_numbers(model, self._compiled[1])
        elif self.shifts.changes_model:
            self._compiled = model, copy(model)
        self.scene_model.rewrite(model, data, nested=True, change=self.shifts.model)
        mujoco.mj_resetData(model, data)
        physics.after_reset()
        self.simulation(physics).clear_records()
        self._stacks = [entry for entry in self._observables.values() if isinstance(entry, LatestFrames)]
        if self._state is not None:
            self.simulation(physics).resume(self._state)
        for stack in self._stacks:
            stack.begin({} if self._state is None else self._state.frames)

    def before_step(self, physics: Any, action: Any, random_state: np.random.RandomState) -> None:
        """Writes the controls of the action."""
        del random_state
        for stack in self._stacks:
            stack.catch_up(physics)
        if self.settings.reward == "dense":
            self._remaining = self.simulation(physics).remaining()
        self.simulation(physics).command(action)

    def after_substep(self, physics: Any, random_state: np.random.RandomState) -> None:
        """If an action is one substep, takes MuJoCo's remaining steps: composer has taken the first."""
        del random_state
        if self.stepwise:
            return
        try:
            self.simulation(physics).advance(SUBSTEPS - 1)
        except errors.PhysicsError as error:
            raise PhysicsError(str(error)) from None

    def after_step(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Counts the action, and requests frames, which are drawn after all hooks."""
        del random_state
        self.simulation(physics).record()
        for stack in self._stacks:
            stack.after_action()

    def should_terminate_episode(self, physics: Any) -> bool:
        """Whether the horizon is reached."""
        return self.horizon is not None and self.simulation(physics).steps >= self.horizon

    def get_reward(self, physics: Any) -> float:
        """The reward of the last step; see `magical_mj.load`."""
        kind, simulation = self.settings.reward, self.simulation(physics)
        reward = simulation.score() if kind != "none" and self.should_terminate_episode(physics) else 0.0
        if kind == "dense":
            reward = reward + self._remaining - simulation.remaining()
        return reward

    def action_spec(self, physics: Any) -> specs.DiscreteArray:
        """The spec of the 18 actions."""
        del physics
        return specs.DiscreteArray(len(ACTIONS), name="action")


def _overrides(owner: SceneTask | composer.Entity, base: type) -> bool:
    """Whether a task or an entity overrides the hooks of substeps."""
    return any(
        getattr(getattr(owner, name), "__func__", None) is not getattr(base, name)
        for name in ("before_substep", "after_substep")
    )


def _in_substeps(entry: observable.Observable) -> bool:
    """Whether an observable depends on more than the state after the last substep."""
    return entry.enabled and (entry.update_interval, entry.delay or 0, entry.buffer_size or 1) != (1, 0, 1)
