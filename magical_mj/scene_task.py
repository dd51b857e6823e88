"""The one composer task: it runs any scene, and with a score and a horizon it is a task of the benchmark."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Any, Literal, get_args

import numpy as np
from dm_control import composer
from dm_control.composer.observation import observable
from dm_env import specs
from numpy.typing import NDArray

from magical_mj import constants as c
from magical_mj.actions import ACTIONS, action_number
from magical_mj.assets.contacts import SUBSTEPS, TIMESTEP
from magical_mj.assets.robot import control_signal
from magical_mj.assets.world import World
from magical_mj.errors import InvalidSceneError
from magical_mj.geometry import check_scene
from magical_mj.observations import STATE_NAMES, VIEWS, StateEncoder
from magical_mj.scene import Scene
from magical_mj.simulation import Simulation

Reward = Literal["none", "score"]
REWARDS: tuple[Reward, ...] = get_args(Reward)

SceneSource = Callable[[int], Scene]
"""The scene of a seed."""


class CurrentObservable(observable.Generic):
    """An observable that knows its spec, so that asking for the spec draws nothing."""

    def __init__(self, function: Callable[[Simulation], Any], spec: specs.Array) -> None:
        super().__init__(function)
        self._spec = spec

    @property
    def array_spec(self) -> specs.Array:
        """Shape and type."""
        return self._spec

    @property
    def is_immediate(self) -> bool:
        """Whether it is seen as it is now, once per control step."""
        timing = (self.update_interval, self.buffer_size, self.delay)
        return timing == (1, None, None) and self.aggregator is None


class SceneTask(composer.Task):
    """Runs scenes: acts in them, shows them, and ends and scores them where there is a score.

    Args:
        first: the scene of the first episode.
        source: gives the scenes of the following episodes, whose seeds are drawn.
        check: raises for scenes that are not scenes of the task; None: any legal scene will do.
        observations: which of `OBSERVATIONS` to give.
        image_size: side of the pictures in pixels.
        horizon: number of control steps after which an episode ends; None: never.
        score: initial scene, final scene -> score; None: there is none.
    """

    def __init__(
        self,
        first: Scene,
        source: SceneSource,
        *,
        check: Callable[[Scene], None] | None = None,
        observations: Sequence[str] = VIEWS,
        image_size: int = 96,
        horizon: int | None = None,
        score: Callable[[Scene, Scene], float] | None = None,
        reward: Reward = "none",
    ) -> None:
        self.world = World(first)
        self.source = source
        self.next_scene: Scene | None = first
        self.horizon = horizon
        self.steps = 0
        self._encoder: StateEncoder | None = None
        self._check = check
        self._score = score
        self._reward = reward
        self._observables = OrderedDict((name, self._observable(name, image_size)) for name in observations)
        self.check(first)

    def check(self, scene: Scene) -> None:
        """Raise `InvalidSceneError` unless an episode can start in `scene`."""
        check_scene(scene)
        if "state" in self._observables:
            StateEncoder(scene)
        if self._check is not None:
            self._check(scene)

    def _observable(self, name: str, image_size: int) -> observable.Observable:
        if name == "state":
            spec = specs.Array((len(STATE_NAMES),), np.float32, name)
            entry = CurrentObservable(self._state, spec)
        else:
            spec = specs.BoundedArray((image_size, image_size, 3), np.uint8, 0, 255, name)
            entry = CurrentObservable(lambda physics: physics.draw(name, image_size), spec)
        entry.enabled = True
        return entry

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
        """Takes the scene that was asked for, else the source's next, and makes its world."""
        scene = self.next_scene or self.source(int(random_state.randint(2**63 - 1, dtype=np.int64)))
        self.next_scene = None
        if scene != self.world.scene:
            self.world = World(scene)
            self._encoder = None

    def initialize_episode(self, physics: Simulation, random_state: np.random.RandomState) -> None:
        """Counts from 0 again. Everything is in its place: the scene is the model's reference pose."""
        del physics, random_state
        self.steps = 0

    def before_step(self, physics: Simulation, action: Any, random_state: np.random.RandomState) -> None:
        """Writes the controls of the action."""
        del random_state
        physics.data.ctrl[:] = control_signal(action_number(action))
        self.steps += 1

    def should_terminate_episode(self, physics: Simulation) -> bool:
        """Whether the horizon is reached."""
        del physics
        return self.horizon is not None and self.steps >= self.horizon

    def get_reward(self, physics: Simulation) -> float:
        """0, or with `reward="score"` the score at the last step."""
        if self._reward == "score" and self.should_terminate_episode(physics):
            return self.score(physics)
        return 0.0

    def score(self, physics: Simulation) -> float:
        """The score in [0, 1] if the episode ended now."""
        if self._score is None:
            raise InvalidSceneError("a plain scene has no score; load a task, or use magical_mj.score(task, ...)")
        return self._score(self.world.scene, self.world.read(physics.data.qpos))

    def action_spec(self, physics: Simulation) -> specs.DiscreteArray:
        """The 18 actions."""
        del physics
        return specs.DiscreteArray(len(ACTIONS), name="action")
