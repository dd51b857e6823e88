"""`Engine`: one world with its task's horizon and score, pictures, and states that can be saved and restored."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.engine.simulation import Simulation, State, check_state
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.renderer import check_size
from magical_mj.scene import Scene, check_scene_type
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.geometry import check_scene
from magical_mj.scene.state_vector import CAMERAS, SEGMENTATIONS
from magical_mj.shifts.episode import Draws, EpisodeShifts, draw_shifts
from magical_mj.shifts.registry import Shifts, split_body
from magical_mj.tasks.registry import check_rules, environment_axes, sample_scene, task_spec, variant_name
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import (
    ClosedError,
    InvalidSceneError,
    PhysicsError,
    SettingsError,
    StateError,
    check_name,
)
from magical_mj.variants import check_seed


@dataclass(frozen=True)
class Setup:
    """What is played: the arguments of `Engine` that say so, checked, and what follows from them.

    The task is None for plain scenes, which have no score and no horizon, and say the robot's body themselves.
    """

    task: str | None
    variant: str = "Demo"
    rules: Rules = "paper"
    body: str = GRIPPER

    def __post_init__(self) -> None:
        """Checks the names."""
        if self.task is not None:
            object.__setattr__(self, "variant", variant_name(self.variant))
            environment_axes(self.task, self.variant)
            task_spec(self.task).check_body(self.body)
        check_rules(self.rules)

    @property
    def horizon(self) -> int | None:
        """The number of actions after which an episode ends; None: never."""
        return None if self.task is None else task_spec(self.task).horizon(self.rules, self.body)

    @property
    def speeds(self) -> bool:
        """Whether actions are x-magical's speeds."""
        return self.task is not None and task_spec(self.task).speeds

    @property
    def trajectory(self) -> bool:
        """Whether the score depends on the scenes of all steps."""
        return self.task is not None and task_spec(self.task).trajectory

    def check(self, scene: object) -> None:
        """Raises `InvalidSceneError` unless it is a `Scene` in which an episode can start."""
        scene = check_scene_type(scene)
        check_scene(scene)
        if self.task is not None:
            task_spec(self.task).check(scene)
            if scene.robot.body != self.body:
                raise InvalidSceneError(
                    f"the robot of this scene has the body {scene.robot.body!r}, and this environment is made for "
                    f"{self.body!r}: make another one with body={scene.robot.body!r}"
                )

    def sample(self, seed: int) -> Scene:
        """The scene of this seed.

        Raises:
            InvalidSeedError: if the seed is not an integer, or negative.
            SettingsError: without a task.
        """
        if self.task is None:
            raise SettingsError("a plain scene has no seeds: give a scene or a state")
        return sample_scene(self.task, self.variant, seed, self.body)

    def begin(
        self, shifts: Mapping[str, int], start: int | Scene, draws: Draws | None = None
    ) -> tuple[Scene, EpisodeShifts | None]:
        """The scene in which an episode starts, and its shifts.

        Args:
            shifts: their strengths.
            start: the seed of the scene, and of what the shifts draw. Or a scene, which stays as it is, whatever the
                shifts would change in it; the rest is drawn from seed 0.
            draws: what the shifts have drawn, instead.
        """
        draws = draw_shifts(shifts, start if isinstance(start, int) else 0) if draws is None else draws
        episode = EpisodeShifts(draws) if draws else None
        if not isinstance(start, int):
            self.check(start)
            return start, episode
        scene = self.sample(start)
        return (scene if episode is None or self.task is None else episode.scene(scene, self.task)), episode

    def instruction(self, shifts: EpisodeShifts | None) -> str:
        """The sentence that says what is to be done in an episode with these shifts; "" for plain scenes."""
        if self.task is None:
            return ""
        sentence = task_spec(self.task).summary
        return sentence if shifts is None else shifts.instruction(sentence, self.task)

    @np.errstate(all="ignore")  # no result depends on the caller's settings
    def score(self, scenes: Sequence[Scene]) -> float:
        """The score in [0, 1] of an episode with these scenes. Most tasks use only the first and the last.

        Raises:
            InvalidSceneError: without a task.
        """
        if self.task is None:
            raise InvalidSceneError("a plain scene has no score; name a task, or use magical_mj.score(task, ...)")
        return task_spec(self.task).checked_score(scenes, self.rules)

    def check_start(self, *, seed: object = None, scene: object = None, state: State | None = None) -> None:
        """Raises an error unless an episode can start here: from one thing at most, and no state that is over.

        Raises:
            SettingsError, StateError: accordingly.
        """
        starts = {"seed": seed, "scene": scene, "state": state}
        names = [name for name, value in starts.items() if value is not None]
        if len(names) > 1:
            raise SettingsError(f"an episode starts from one of seed, scene and state, not from {' and '.join(names)}")
        if state is not None:
            check_state(state)
            check_goes_on(state, self.horizon)
            self.trajectory_of(state)

    def trajectory_of(self, state: State) -> list[Scene]:
        """The scenes of a state's episode, where the score depends on them.

        Raises:
            StateError: if the state lacks them, as one that another task or a plain scene has given.
        """
        if not self.trajectory:
            return []
        if len(state.trajectory) != state.steps + 1 or state.trajectory[0] != state.scene:
            raise StateError(
                f"the score of {self.task} depends on the scenes of all steps, which this state lacks: "
                f"give a state that get_state() of an environment of {self.task} returned"
            )
        return list(state.trajectory)


def check_goes_on(state: State, limit: int | None) -> None:
    """Raises a `StateError` if a state is that of an episode which has ended after `limit` steps."""
    if limit is not None and state.steps >= limit:
        raise StateError(
            f"the episode of this state is over, after {state.steps} steps: give an earlier state, of less than {limit}"
        )


class Engine:
    """One of the benchmark's environments without observations, rewards and wrappers: both doors stand on it.

    A new engine is at the start of its first episode: in `scene`, or else in `sample_scene(task, variant, seed)`.

    Args:
        task: one of `magical_mj.TASKS`, a task that a package announces, or ``"package.module:SPEC"``.
        variant: one of `magical_mj.VARIANTS` that the task has.
        scene: the scene in which to start.
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        seed: the seed of the first scene; None: drawn from the system's entropy.
        renderer: "opengl" or "software" for flat views; None: MAGICAL_MJ_RENDERER, or what works (docs/pictures.md).
        shifts: shifts and their strengths, such as ``"camera:3,latency:1"`` or ``{"camera": 3}``; see docs/shifts.md.
        body: the robot's body, see docs/bodies.md.

    Attributes:
        setup: task, variant and rules, with what follows from them.
        task, variant, rules: likewise; the task is None for plain scenes.
        seed: the seed of the present episode's scene; None if it came from elsewhere.
        steps: the number of actions since the start of the episode.
        horizon: the number of actions of an episode; None if it never ends, as in plain scenes.
        shifts: the strengths of the shifts by name, without `body`.

    Raises:
        UnknownNameError: for an unknown task, variant or rules, or an unsupported pair.
        TaskError: if the task of another package is invalid.
        InvalidSceneError: if the scene is illegal or not one of the task.
        InvalidSeedError: if the seed is not an integer, or negative.
        SettingsError: if both a scene and a seed are given; for wrong shifts, or such as the task cannot have; for a
            body that it does not offer.
        ShiftError: if a shift of another package is invalid.
    """

    def __init__(
        self,
        task: str,
        variant: str = "Demo",
        *,
        scene: Scene | None = None,
        rules: Rules = "paper",
        seed: int | None = None,
        renderer: str | None = None,
        shifts: Shifts = None,
        body: str = GRIPPER,
    ) -> None:
        task_spec(task)  # None, too, is no task
        strengths, body = split_body(shifts, task, body)
        setup = Setup(task, variant, rules, body)
        setup.check_start(seed=seed, scene=scene)
        if scene is None:
            seed = start = secrets.randbits(63) if seed is None else check_seed(seed)
        else:
            start = check_scene_type(scene)
        self._begin(setup, *setup.begin(strengths, start), renderer, strengths)
        self.seed = seed

    @classmethod
    def of_scene(cls, scene: Scene, renderer: str | None = None) -> Engine:
        """An engine for a plain scene: no task, so no score and no horizon.

        Raises:
            InvalidSceneError: if the scene is illegal.
        """
        engine, setup = cls.__new__(cls), Setup(None)
        setup.check(scene)
        engine._begin(setup, scene, None, renderer, {})
        return engine

    def _begin(
        self,
        setup: Setup,
        scene: Scene,
        shifts: EpisodeShifts | None,
        renderer: str | None,
        strengths: dict[str, int],
    ) -> None:
        check_renderer(renderer)
        self.setup, self.task, self.variant = setup, setup.task, setup.variant
        self.rules: Rules = setup.rules
        self.horizon = setup.horizon
        self._simulation: Simulation | None = Simulation.of(scene, renderer, shifts, speeds=setup.speeds)
        self.shifts = strengths
        self.seed: int | None = None
        self._start_counting()

    def _start_counting(self) -> None:
        self.steps, self._broken = 0, False
        self._trajectory = [self.initial_scene] if self.setup.trajectory else []

    @property
    def simulation(self) -> Simulation:
        """The simulation."""
        if self._simulation is None:
            raise ClosedError("the environment is closed; make another one")
        return self._simulation

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model. A reset may replace it, and writes every number that the scene determines."""
        return self.simulation.model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data."""
        return self.simulation.data

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self.simulation.scene

    @property
    def initial_scene(self) -> Scene:
        """The scene in which this episode started."""
        return self.simulation.world.scene

    @property
    def draws(self) -> Draws:
        """What the shifts of this episode have drawn: the values of each one's factors, and its seed."""
        return {} if self.simulation.shifts is None else self.simulation.shifts.draws

    @property
    def instruction(self) -> str:
        """The sentence that says what is to be done; "" for plain scenes."""
        return self.setup.instruction(self.simulation.shifts)

    @property
    def over(self) -> bool:
        """Whether the episode has ended: at its horizon, or because the simulation became unstable."""
        return self._broken or (self.horizon is not None and self.steps >= self.horizon)

    def reset(
        self,
        *,
        seed: int | None = None,
        scene: Scene | None = None,
        state: State | None = None,
        draws: Draws | None = None,
    ) -> None:
        """Starts an episode in the scene of `seed`, or in `scene`, or again in the present episode's scene.

        Args:
            seed: the seed of this episode's scene, and of what its shifts draw.
            scene: the scene in which to start, whatever shifts would change in it.
            state: a state to continue from, as `set_state`, of an episode that goes on.
            draws: what shifts draw in this episode, such as `draws` of another one, instead of the seed's draws.

        Raises:
            InvalidSceneError, InvalidSeedError, StateError, SettingsError: if it is invalid; if there is more than one.
        """
        simulation = self.simulation
        self.setup.check_start(seed=seed, scene=scene, state=state)
        if state is not None:
            self.set_state(state)
            return
        if seed is not None:
            seed = start = check_seed(seed)
        elif scene is not None:
            start = check_scene_type(scene)
        else:
            start, seed, draws = self.initial_scene, self.seed, self.draws if draws is None else draws
        start = self.setup.begin(self.shifts, start, draws)
        self._broken = True  # until it has succeeded
        simulation.start(*start)
        self.seed = seed
        self._start_counting()

    def step(self, action: Any) -> bool:
        """One action of 1/8 s. Returns whether the episode is over.

        Raises:
            InvalidActionError: if the action is not one of the 18, nor, in x-magical's suite, a vector of speeds.
            StateError: if the episode is over already.
            PhysicsError: if the simulation becomes unstable, which ends the episode.
        """
        simulation = self.simulation
        if self.over:
            raise StateError("the episode is over: call reset() before the next step")
        try:
            simulation.act(action)
        except PhysicsError:
            self._broken = True
            raise
        self.steps += 1
        if self._trajectory:
            self._trajectory.append(self.scene)
        return self.over

    @property
    def scored_scenes(self) -> tuple[Scene, ...]:
        """What the score depends on: the initial and the present scene, or the scenes of all steps."""
        return tuple(self._trajectory) or (self.initial_scene, self.scene)

    def score(self) -> float:
        """The score in [0, 1] if the episode ended now.

        Raises:
            InvalidSceneError: without a task.
        """
        return self.setup.score(self.scored_scenes)

    def state_vector(self) -> NDArray[np.float32]:
        """What `magical_mj.scene.state_vector.STATE_NAMES` names, in a fresh vector. Shape (len(STATE_NAMES),).

        Raises:
            InvalidSceneError: if the scene has more blocks or regions than the vector holds.
        """
        return self.simulation.state_vector()

    def fingers(self) -> NDArray[np.float64]:
        """The angles of the left and the right finger, rad. Shape (2,)."""
        return self.simulation.world.fingers(self.data.qpos)

    def render(self, view: str = "allo", size: int = 384, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the present state in a fresh array or in `out`. Shape (size, size, 3), uint8 RGB, top row first.

        Args:
            view: "ego" or "allo", the flat views of the benchmark, or "scene", a 3-D view from above a corner; or
                "ego-segmentation" or "allo-segmentation", of shape (size, size), which say what is where.
            size: pixels per side.
            out: the array to write to.

        Raises:
            UnknownNameError, SettingsError, RenderingError: for another view, size or array; without OpenGL.
        """
        check_name("view", view, (*CAMERAS, *SEGMENTATIONS))
        return self.simulation.draw(view, check_size(size, "size"), out)

    def get_state(self) -> State:
        """The present state of the episode, exactly. Takes about 1/40 of a step's time."""
        return self.simulation.state(self.steps, self._trajectory)

    def set_state(self, state: State) -> None:
        """Restores a state of this engine, or of another one with the same task: what follows is exactly the same.

        Takes half a step's time, or as long as a reset if the state has another scene than the present one. The shifts
        of the state's episode are those of this one from then on.

        Raises:
            StateError, InvalidSceneError: if it is none of this task. A damaged one of another scene ends the episode.
        """
        simulation = self.simulation
        check_state(state)
        trajectory = self.setup.trajectory_of(state)
        if state.scene != self.initial_scene or state.draws != self.draws:
            start = self.setup.begin({}, state.scene, state.draws)
            self._broken = True  # until everything below has succeeded
            simulation.start(*start)
            self.seed = None
        simulation.restore(state.simulation)
        if simulation.shifts is not None:
            simulation.shifts.resume(int(state.steps), state.commands)
        self.steps, self._broken, self._trajectory = int(state.steps), False, trajectory

    def clone(self) -> Engine:
        """A copy in the same state, in as long as a new one takes. Both go on alike."""
        return restored(*self.__reduce__()[1])

    def __deepcopy__(self, memo: dict[int, Any]) -> Engine:
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """For copying and pickling: what it was made of, and its state."""
        state = self.get_state()
        return restored, (self.setup, self.shifts, self.seed, state, self._broken, self.simulation.renderer)

    def close(self) -> None:
        """Frees the simulation. Closing twice is fine."""
        if self._simulation is not None:
            self._simulation.free()
        self._simulation = None


def restored(
    setup: Setup, shifts: dict[str, int], seed: int | None, state: State, broken: bool, renderer: str | None
) -> Engine:
    """A copy of an engine, as `Engine.__reduce__` describes it."""
    engine = Engine.__new__(Engine)
    engine._begin(setup, state.scene, EpisodeShifts(state.draws) if state.draws else None, renderer, shifts)
    engine.set_state(state)
    engine.seed, engine._broken = seed, broken
    return engine
