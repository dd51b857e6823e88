"""The composer task: it runs scenes in composer's loop, with the physics of an engine, and draws observations."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Final

import mujoco
import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_control.rl.control import PhysicsError
from dm_env import specs

from magical_mj.assets.contacts import SUBSTEPS, TIMESTEP
from magical_mj.assets.world import World
from magical_mj.engine import State
from magical_mj.engine.engine import Setup
from magical_mj.engine.simulation import Simulation, write_numbers
from magical_mj.envs.composer.entities import Arena
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.state_vector import OBSERVATIONS, STATE_NAMES, StateEncoder
from magical_mj.shifts.episode import EpisodeShifts
from magical_mj.tasks.spec import REWARDS, Reward
from magical_mj.utils import errors
from magical_mj.utils.errors import SettingsError, check_name, short_repr

CAMERA_NAMES: Final = {"ego": "robot/ego"}
"""The names of cameras in the compiled tree, where they are not those of the views."""


class CurrentObservable(observable.Generic):
    """An observable with a known spec, so that reading the spec draws nothing. It is enabled by default."""

    def __init__(self, function: Callable[[Any], Any], spec: specs.Array) -> None:
        super().__init__(function)
        self._own_spec = spec
        self.enabled = True

    @property
    def array_spec(self) -> specs.Array:
        """Shape and type."""
        return self._own_spec


@dataclass(frozen=True)
class Settings:
    """What an environment is loaded with.

    Attributes:
        setup: what is played.
        strengths: the strengths of the shifts by name.
        observations, image_size, reward, renderer: as `load`.

    Raises:
        UnknownNameError: for an unknown observation or reward.
        SettingsError: if the observations are no list.
    """

    setup: Setup
    strengths: dict[str, int]
    observations: Sequence[str]
    image_size: int
    reward: Reward
    renderer: str | None

    def __post_init__(self) -> None:
        """Checks the names."""
        names = self.observations
        if not isinstance(names, list | tuple):
            raise SettingsError(f'observations are a list or a tuple of names, ("ego",), not {short_repr(names)}')
        for name in names:
            check_name("observation", name, OBSERVATIONS)
        check_name("reward", self.reward, REWARDS)


class SceneTask(composer.Task):
    """Runs scenes: executes actions, provides observations, and ends and scores episodes if there is a benchmark task.

    All ten of MuJoCo's steps of an action are one substep of composer, whose own loop takes longer than the physics.

    Args:
        settings: what the environment is loaded with.
        scene, shifts: of the first episode.

    Attributes:
        world, shifts: of this episode.
        steps: the number of actions since the start of the episode.
    """

    def __init__(self, settings: Settings, scene: Scene, shifts: EpisodeShifts | None) -> None:
        self.settings, self.setup = settings, settings.setup
        self.steps, self._trajectory = 0, list[Scene]()
        self._simulation: Simulation | None = None
        self._compiled: tuple[mujoco.MjModel, mujoco.MjModel] | None = None
        self._arena = Arena(scene)
        self.start(scene, shifts)
        self._observables = OrderedDict((name, self._observable(name)) for name in settings.observations)

    def start(self, scene: Scene, shifts: EpisodeShifts | None, state: State | None = None) -> None:
        """Makes the next episode start in the scene, or in a state of an episode that started in it."""
        if "state" in self.settings.observations:
            StateEncoder(scene)  # raises an error, while the present episode can go on, if the vector is too short
        self.world, self.shifts, self._state = World(scene), shifts, state

    def _observable(self, name: str) -> CurrentObservable:
        if name == "state":
            vector = specs.Array((len(STATE_NAMES),), np.float32, name)
            return CurrentObservable(lambda physics: self.simulation(physics).state_vector(), vector)
        size = self.settings.image_size
        picture = specs.BoundedArray((size, size, 3), np.uint8, 0, 255, name)
        return CurrentObservable(lambda physics: self.simulation(physics).draw(name, size), picture)

    def simulation(self, physics: Any) -> Simulation:
        """The simulation of this episode in composer's model and data."""
        model, data = physics.model.ptr, physics.data.ptr
        if self._simulation is None or self._simulation.model is not model or self._simulation.data is not data:
            self.free()
            renderer, speeds = self.settings.renderer, self.setup.speeds
            self._simulation = Simulation(self.world, model, data, renderer, CAMERA_NAMES, speeds=speeds)
        self._simulation.world, self._simulation.shifts = self.world, self.shifts
        return self._simulation

    def free(self) -> None:
        """Frees what it drew with."""
        if self._simulation is not None:
            self._simulation.free()
        self._simulation = None

    @property
    def root_entity(self) -> Arena:
        """The arena."""
        return self._arena

    @property
    def task_observables(self) -> Mapping[str, observable.Observable]:
        """The observables that were asked for, all enabled."""
        return self._observables

    @property
    def control_timestep(self) -> float:
        """Seconds per action."""
        return 1 / c.CONTROL_RATE

    @property
    def physics_timestep(self) -> float:
        """Seconds per step of MuJoCo."""
        return TIMESTEP

    @property
    def physics_steps_per_control_step(self) -> int:
        """Composer's substeps per action."""
        return 1

    def initialize_episode_mjcf(self, random_state: np.random.RandomState) -> None:
        """Makes the tree that of the scene."""
        del random_state
        self._arena.show(self.world.scene)

    def initialize_episode(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Writes the scene into the compiled model, and puts everything into its place."""
        del random_state
        model, data = physics.model.ptr, physics.data.ptr
        if self._compiled is not None and self._compiled[0] is model:
            write_numbers(model, self._compiled[1])
        elif self.shifts is not None and self.shifts.changes_model:
            self._compiled = model, copy(model)
        self.world.rewrite(model, data, nested=True, change=None if self.shifts is None else self.shifts.model)
        mujoco.mj_resetData(model, data)
        physics.after_reset()
        self.steps, self._trajectory = 0, [self.world.scene] if self.setup.trajectory else []
        if self._state is not None:
            self.resume(physics, self._state)

    def resume(self, physics: Any, state: State) -> None:
        """Restores a state of an episode that started in this scene."""
        self.simulation(physics).restore(state.simulation)
        self.steps, self._trajectory = int(state.steps), self.setup.trajectory_of(state)
        if self.shifts is not None:
            self.shifts.resume(self.steps, state.commands)

    def before_step(self, physics: Any, action: Any, random_state: np.random.RandomState) -> None:
        """Writes the controls of the action."""
        del random_state
        self.simulation(physics).command(action)
        self.steps += 1

    def after_substep(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Takes MuJoCo's other steps: composer has taken the first."""
        del random_state
        try:
            self.simulation(physics).advance(SUBSTEPS - 1)
        except errors.PhysicsError as error:
            raise PhysicsError(str(error)) from None

    def after_step(self, physics: Any, random_state: np.random.RandomState) -> None:
        """Notes the scene, if the score depends on the scenes of all steps."""
        del random_state
        if self._trajectory:
            self._trajectory.append(self.simulation(physics).scene)

    def should_terminate_episode(self, physics: Any) -> bool:
        """Whether the horizon is reached."""
        del physics
        horizon = self.setup.horizon
        return horizon is not None and self.steps >= horizon

    def get_reward(self, physics: Any) -> float:
        """0, or with `reward="score"` the score at the last step."""
        rewarded = self.settings.reward == "score" and self.should_terminate_episode(physics)
        return self.score(physics) if rewarded else 0.0

    def score(self, physics: Any) -> float:
        """The score in [0, 1] if the episode ended now; an `InvalidSceneError` for plain scenes."""
        return self.setup.score(self._trajectory or (self.world.scene, self.simulation(physics).scene))

    def state(self, physics: Any) -> State:
        """The state of the episode."""
        return self.simulation(physics).state(self.steps, self._trajectory)

    def action_spec(self, physics: Any) -> specs.DiscreteArray:
        """The 18 actions."""
        del physics
        return specs.DiscreteArray(len(ACTIONS), name="action")
