"""The composer task of all environments: it runs any scene, with the score and horizon of a benchmark task if given."""

from __future__ import annotations

from collections import OrderedDict
from typing import Any

import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs
from numpy.typing import NDArray

from magical_mj.assets.contacts import SUBSTEPS, TIMESTEP
from magical_mj.assets.world import World
from magical_mj.engine.settings import EnvironmentSettings
from magical_mj.engine.simulation import Simulation
from magical_mj.envs.composer.observables import CurrentObservable, picture, state
from magical_mj.scene import Scene
from magical_mj.scene import constants as c
from magical_mj.scene.actions import ACTIONS
from magical_mj.scene.state_vector import StateEncoder


class SceneTask(composer.Task):
    """Runs scenes: executes actions, provides observations, and ends and scores episodes if there is a benchmark task.

    Args:
        settings: the settings of the environment.
        first: the scene of the first episode.

    Attributes:
        next_scene: the scene of the next episode; None to draw one.
        seed: the seed of the present scene; `next_seed`: that of the next one. None if there is none or it is unknown.
    """

    def __init__(self, settings: EnvironmentSettings, first: Scene) -> None:
        self.settings = settings
        self.world = World(first)
        self.next_scene: Scene | None = first
        self.next_seed: int | None = None
        self.seed: int | None = None
        self.steps = 0
        self.horizon = settings.horizon
        self._encoder: StateEncoder | None = None
        self._observables = OrderedDict((name, self._observable(name)) for name in settings.observations)

    def _observable(self, name: str) -> CurrentObservable:
        return state(self._state) if name == "state" else picture(name, self.settings.image_size)

    def set_next_seed(self, seed: int) -> Scene:
        """Makes the next episode start in the scene of this seed, and returns that scene."""
        self.next_scene = self.settings.sample(seed)
        self.next_seed = seed if self.settings.scene is None else None
        return self.next_scene

    def start(self, scene: Scene, seed: int | None = None) -> None:
        """Makes the world of the scene in which an episode starts."""
        self.next_scene, self.next_seed, self.seed = None, None, seed
        if scene != self.world.scene:
            self.world = World(scene)
            self._encoder = None

    def _state(self, physics: Simulation) -> NDArray[np.float32]:
        world, data = self.world, physics.data
        if self._encoder is None:
            self._encoder = StateEncoder(world.scene)
        return self._encoder(world.poses(data.qpos), world.poses(data.qvel), world.fingers(data.qpos))

    @property
    def root_entity(self) -> World:
        """The world of this episode."""
        return self.world

    @property
    def task_observables(self) -> OrderedDict[str, observable.Observable]:
        """The observables that were asked for, all enabled."""
        return self._observables

    @property
    def control_timestep(self) -> float:
        """Seconds per action."""
        return 1 / c.CONTROL_RATE

    @property
    def physics_timestep(self) -> float:
        """Seconds per substep."""
        return TIMESTEP

    @property
    def physics_steps_per_control_step(self) -> int:
        """Substeps per action."""
        return SUBSTEPS

    def initialize_episode_mjcf(self, random_state: np.random.RandomState) -> None:
        """Starts in `next_scene` if there is one, else in the scene of a randomly drawn seed."""
        scene = self.next_scene or self.set_next_seed(int(random_state.randint(2**63 - 1, dtype=np.int64)))
        self.start(scene, self.next_seed)

    def initialize_episode(self, physics: Simulation, random_state: np.random.RandomState) -> None:
        """Resets the step counter. The poses are already right: the scene is the model's reference pose."""
        del physics, random_state
        self.steps = 0

    def before_step(self, physics: Simulation, action: Any, random_state: np.random.RandomState) -> None:
        """Writes the controls of the action."""
        del random_state
        physics.command(action)
        self.steps += 1

    def should_terminate_episode(self, physics: Simulation) -> bool:
        """Whether the horizon is reached."""
        del physics
        return self.horizon is not None and self.steps >= self.horizon

    def get_reward(self, physics: Simulation) -> float:
        """0, or with `reward="score"` the score at the last step."""
        if self.settings.reward == "score" and self.should_terminate_episode(physics):
            return self.score(physics)
        return 0.0

    def score(self, physics: Simulation) -> float:
        """The score in [0, 1] if the episode ended now; an `InvalidSceneError` for plain scenes."""
        return self.settings.score(self.world.scene, self.world.read(physics.data.qpos))

    def action_spec(self, physics: Simulation) -> specs.DiscreteArray:
        """The 18 actions."""
        del physics
        return specs.DiscreteArray(len(ACTIONS), name="action")
