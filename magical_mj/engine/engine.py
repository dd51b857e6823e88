"""`Engine`: one environment with its task's horizon and score, pictures, and states that can be saved and restored."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.scene_model import SceneModel
from magical_mj.engine.episode import PLAIN, Setup, State
from magical_mj.engine.simulation import Simulation, different_numbers
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.picture import check_picture
from magical_mj.scene import Scene
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts.episode import Draws, EpisodeShifts
from magical_mj.shifts.registry import Shifts, shift_class, split_body
from magical_mj.shifts.shift import overrides
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import ClosedError, CopyError, PhysicsError, SettingsError, StateError
from magical_mj.utils.frozen import FrozenDict
from magical_mj.variants import check_seed

_EPISODE: Final = ("scene_model", "_model", "_data", "episode_shifts", "_steps", "trajectory", "_renderers")
"""The attributes of an engine that `close` frees."""


class Engine(Simulation):
    """An environment of the benchmark without observations and rewards. The Gymnasium and dm_env environments wrap it.

    A new engine is at the start of its first episode: in `scene` if given, otherwise in
    `sample_scene(task, variant, seed)`.

    Example:
        >>> engine = magical_mj.Engine("MoveToRegion", seed=0)
        >>> ended = [engine.step(1) for _ in range(engine.horizon)]  # drives forward until the horizon
        >>> ended[-1], 0 <= engine.score() <= 1
        (True, True)

    Args:
        task: one of `magical_mj.TASKS`, a task of an installed plug-in, or ``"package.module:SPEC"``.
        variant: a variant of the task, one of `magical_mj.VARIANTS`.
        scene: the initial scene.
        rules: "paper", or "released" for the scores and horizons of the original's released code.
        seed: the seed of the first scene; None: drawn from the system's entropy.
        renderer: "opengl" or "software" for flat views; None: MAGICAL_MJ_RENDERER, or the first that works
            (docs/pictures.md).
        shifts: shifts and their strengths, such as ``"camera:3,latency:1"`` or ``{"camera": 3}``; see docs/shifts.md.
        body: the robot's body, see docs/bodies.md.
        speeds: whether vectors of x-magical's speeds are also actions (`magical_mj.assets.robot.speed_signal`).

    Attributes:
        limit: the largest number of actions in an episode of this engine: the horizon, or fewer.

    Raises:
        UnknownNameError: for an unknown task, variant or rules, or if the task does not have the variant.
        TaskError: if the task of another package is invalid.
        InvalidSceneError: if the scene is illegal or does not belong to the task.
        InvalidSeedError: if the seed is negative or not an integer.
        SettingsError: if both a scene and a seed are given, or if the task or its actions do not support the shifts.
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
        speeds: bool = False,
    ) -> None:
        task_spec(task)  # rejects None as well, which is the task of plain scenes in `Setup`
        strengths, body = split_body(shifts, task, body)
        setup = Setup(task, variant, rules, body, speeds)
        if setup.speeds and (unable := [name for name in strengths if overrides(shift_class(name), "action")]):
            raise SettingsError(f"the shift {unable[0]!r} changes the 18 actions, but the actions here are speeds")
        setup.check_start(seed=seed, scene=scene)
        if scene is None:
            seed = secrets.randbits(63) if seed is None else check_seed(seed)
        self._begin(setup, *setup.scene_and_shifts(strengths, seed, scene), renderer, strengths)
        self._seed = seed

    @classmethod
    def of_scene(cls, scene: Scene, renderer: str | None = None) -> Engine:
        """An engine for a plain scene, without score and horizon. Raises `InvalidSceneError` if it is illegal."""
        engine = cls.__new__(cls)
        engine._begin(PLAIN, PLAIN.check(scene), EpisodeShifts(), renderer, {})
        return engine

    def _begin(
        self,
        setup: Setup,
        scene: Scene,
        episode_shifts: EpisodeShifts,
        renderer: str | None,
        strengths: Mapping[str, int],
    ) -> None:
        """Initialises the engine at the start of an episode with this scene and these shifts."""
        check_renderer(renderer)
        super().__init__(setup, SceneModel(scene), renderer=renderer)
        self.limit = setup.horizon
        self._shifts: Mapping[str, int] = FrozenDict(strengths)
        self.start(scene, episode_shifts)

    def start(self, scene: Scene, shifts: EpisodeShifts | None = None, seed: int | None = None) -> None:
        """Starts an episode in a scene that `Setup.scene_and_shifts` returned. `seed` is that of the scene, if any."""
        self._broken = True  # until the start has succeeded
        super().start(scene, shifts)
        self._seed, self._broken = seed, False

    @property
    def task(self) -> str | None:
        """The task; None for plain scenes."""
        return self._setup.task

    @property
    def variant(self) -> str:
        """The variant."""
        return self._setup.variant

    @property
    def rules(self) -> Rules:
        """The rules of score and horizon."""
        return self._setup.rules

    @property
    def horizon(self) -> int | None:
        """The number of actions of an episode; None if it never ends, as in plain scenes."""
        return self._setup.horizon

    @property
    def seed(self) -> int | None:
        """The seed of the current episode's scene; None if the scene was not drawn from a seed."""
        return self._seed

    @property
    def shifts(self) -> Mapping[str, int]:
        """The strengths of the shifts by name, without `body`."""
        return self._shifts

    @property
    def over(self) -> bool:
        """Whether the episode has ended, at its limit or because the simulation became unstable."""
        steps = self._steps  # an error if the engine is closed
        return self._broken or (self.limit is not None and steps >= self.limit)

    def reset(
        self,
        *,
        seed: int | None = None,
        scene: Scene | None = None,
        state: State | None = None,
        draws: Draws | None = None,
    ) -> None:
        """Starts an episode. Without seed, scene and state, it starts in the current episode's initial scene again.

        Args:
            seed: draws this episode's scene and the values of its shifts.
            scene: the initial scene. Shifts do not change it.
            state: a state of an episode that has not ended; the episode continues from it, as with `set_state`.
            draws: the values of the shifts, such as `draws` of another engine, instead of those drawn from the seed.

        Raises:
            InvalidSceneError: if the scene is illegal or does not belong to the task.
            InvalidSeedError: if the seed is negative or not an integer.
            StateError: if the state does not fit the task, or its episode has ended.
            SettingsError: if more than one of seed, scene and state is given.
        """
        self._setup.check_start(seed=seed, scene=scene, state=state, limit=self.limit)
        if state is not None:
            self.set_state(state)
            return
        if seed is not None:
            seed = check_seed(seed)
        elif scene is None:
            scene, seed, draws = self.initial_scene, self._seed, self.draws if draws is None else draws
        self.start(*self._setup.scene_and_shifts(self._shifts, seed, scene, draws), seed)

    def step(self, action: Any) -> bool:
        """Executes one action of 1/8 s. Returns whether the episode has ended.

        Raises:
            InvalidActionError: if the action is neither one of the 18 nor, in x-magical's suite, a vector of speeds.
            StateError: if the episode had ended before.
            PhysicsError: if the simulation becomes unstable. This ends the episode.
        """
        if self.over:
            raise StateError("the episode is over: call reset() before the next step")
        try:
            self.act(action)
        except PhysicsError:
            self._broken = True
            raise
        return self.over

    def render(self, view: str = "allo", size: int = 384, out: NDArray[np.uint8] | None = None) -> NDArray[np.uint8]:
        """A picture of the current state. Shape (size, size, 3), uint8 RGB, top row first.

        Args:
            view: "ego" or "allo", the flat views of the benchmark; "scene", a 3-D view from above a corner; or
                "ego-segmentation" or "allo-segmentation", an object id for each pixel, shape (size, size).
            size: pixels per side.
            out: the array for the picture; None: a fresh array.

        Raises:
            UnknownNameError: for an unknown view.
            SettingsError: if the size is invalid, or the array has another shape or type.
            RenderingError: if the picture needs OpenGL, and OpenGL does not work.
        """
        return self.draw(view, check_picture(view, size, out), out)

    def set_state(self, state: State) -> None:
        """Restores a state of this engine or of another one with the same task. The episode continues exactly.

        Takes half a step's time, or as long as a reset if the state has another initial scene. The engine continues
        with the shifts of the state's episode.

        Raises:
            StateError: if the state does not belong to this task, or is damaged. If a damaged state has another initial
                scene, the current episode ends.
            InvalidSceneError: if the state's scene does not belong to this task.
        """
        self._setup.check_state(state)  # before anything is changed
        if state.scene != self.initial_scene or state.draws != self.draws:
            self.start(*self._setup.scene_and_shifts({}, scene=state.scene, draws=state.draws))
            self._broken = True  # until everything below has succeeded
        self.resume(state)
        self._broken = False

    def clone(self) -> Engine:
        """A copy in the same state, with the same future. Takes as long as making a new engine.

        Raises:
            StateError: if `model` was changed by hand, since the copy would not have these changes.
        """
        copied = restored(*self._parts())
        try:
            self._check_model(copied.model)
        except StateError:
            copied.close()
            raise
        return copied

    def __deepcopy__(self, memo: dict[int, Any]) -> Engine:
        return self.clone()

    def __reduce__(self) -> tuple[Any, ...]:
        """For pickling. Raises a `StateError` if `model` was changed by hand."""
        self._check_model(Simulation.of(self.initial_scene, EpisodeShifts(self.draws)).model)
        return restored, self._parts()

    def _parts(self) -> tuple[Any, ...]:
        """The arguments of `restored` for a copy."""
        episode = self._seed, self.get_state(), self._broken, self.limit
        return self._setup, self._shifts, *episode, self.renderer

    def _check_model(self, expected: mujoco.MjModel) -> None:
        """Raises a `CopyError` if the model differs from that of an unchanged engine in this episode."""
        if changes := different_numbers(self._model, expected):
            raise CopyError(
                f"the engine's model was changed by hand ({', '.join(changes[:5])}), and a copy would lack that: "
                "change it in a shift of your own (docs/adding-a-shift.md), which copies have as well"
            )

    def close(self) -> None:
        """Frees the simulation. Can be called more than once.

        Methods and properties of the episode, such as `score`, `scene` and `steps`, then raise a `ClosedError`. Those
        of the engine, such as `task` and `limit`, do not.
        """
        for name in _EPISODE:
            vars(self).pop(name, None)

    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Raises a `ClosedError` for what `close` has freed."""
            if name in _EPISODE:
                raise ClosedError("the environment is closed; make another one")
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")


def restored(
    setup: Setup,
    shifts: Mapping[str, int],
    seed: int | None,
    state: State,
    broken: bool,
    limit: int | None,
    renderer: str | None,
) -> Engine:
    """A copy of an engine, made from the values of `Engine._parts`."""
    engine = Engine.__new__(Engine)
    engine._begin(setup, state.scene, EpisodeShifts(state.draws), renderer, shifts)
    engine.set_state(state)
    engine._seed, engine._broken, engine.limit = seed, broken, limit
    return engine
