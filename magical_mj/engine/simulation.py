"""The simulation of a world: MuJoCo's model and data, with actions, pictures, and states that can be saved.

A `State` is plain data from which an episode goes on: for search, for an expert's corrections, for resets.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from functools import cache
from types import MappingProxyType
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal, speed_signal
from magical_mj.assets.world import World, world_model
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Views, check_out
from magical_mj.scene import Scene
from magical_mj.scene.actions import Action, action_number, as_speeds, to_vector
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.scene.state_vector import VIEWS, StateEncoder
from magical_mj.shifts.episode import Draws, EpisodeShifts
from magical_mj.shifts.shift import Frame
from magical_mj.utils.errors import PhysicsError, StateError, as_integer, short_repr

_SMALLEST_INTEGER: Final = np.iinfo(np.int32).min
_INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_NO_ACTUATION: Final = mujoco.mjtDisableBit.mjDSBL_ACTUATION.value


@dataclass(frozen=True, eq=False)
class State:
    """Everything that determines how an episode continues: `get_state` returns it, `set_state` restores it exactly.

    It holds numbers only, so it can be copied, pickled, sent to another process, or saved in a file field by field (the
    scene as `scene.to_json()`). It can be restored in every environment that runs the same task, or the same scene
    without a task, whatever that environment observes. The generator that draws the scenes of later episodes is not
    part of it.

    Attributes:
        scene: the scene in which the episode started.
        steps: number of control steps since then.
        simulation: MuJoCo's state, a vector with the same length for all states of episodes with this scene:
            positions, velocities, actuators, the solver's warm start, and which blocks sleep.
        frames: the stacks of pictures of a Gymnasium environment, by their names; empty elsewhere.
        draws: what the shifts of the episode have drawn; see `magical_mj.shifts`.
        commands: the last commands that each of them was given which changes actions.
        trajectory: the scenes of the episode so far, the present one last, if the task's score depends on them all.
    """

    scene: Scene
    steps: int
    simulation: NDArray[np.float64]
    frames: Mapping[str, NDArray[np.uint8]] = field(default_factory=dict[str, NDArray[np.uint8]])
    draws: Draws = field(default_factory=dict[str, dict[str, float]])
    commands: Mapping[str, tuple[int, ...]] = field(default_factory=dict[str, tuple[int, ...]])
    trajectory: tuple[Scene, ...] = ()

    def __eq__(self, other: object) -> bool:
        """Whether the simulations are in exactly the same state. Pictures are not compared: they follow from it."""
        if not isinstance(other, State):
            return NotImplemented
        return self._identity() == other._identity()

    def __hash__(self) -> int:
        return hash(self._identity())

    def _identity(self) -> tuple[object, ...]:
        shifts = repr(self.draws), repr(self.commands)
        return self.scene, self.steps, self.simulation.tobytes(), *shifts, self.trajectory


def check_state(state: object) -> None:
    """Raises `StateError` unless it is a `State`, whose simulation may still not fit."""
    if not (
        isinstance(state, State)
        and isinstance(state.scene, Scene)
        and as_integer(state.steps) is not None
        and isinstance(state.frames, Mapping)
        and isinstance(state.draws, Mapping)
        and isinstance(state.commands, Mapping)
        and isinstance(state.trajectory, tuple)
        and all(isinstance(scene, Scene) for scene in state.trajectory)
    ):
        raise StateError(
            "a state is what get_state() returns: a scene, a number of steps from 0 up, the simulation's numbers, and "
            f"frames by name; not {short_repr(state)}"
        )


class Simulation:
    """The simulation of a world, at rest in its scene after `start`.

    Args:
        world: the world of the first scene.
        model: a compiled model of it.
        data: its state, which others may use too.
        renderer: as `magical_mj.Engine`.
        cameras: as those of `Views`.
        speeds: whether actions are x-magical's speeds, see `magical_mj.assets.robot.speed_signal`.

    Attributes:
        world: the world of the present scene.
        model: MuJoCo's model. `start` replaces it if the new scene has another structure.
        data: MuJoCo's state of that model.
        shifts: those of the present episode; None: none.
    """

    def __init__(
        self,
        world: World,
        model: mujoco.MjModel,
        data: mujoco.MjData | None = None,
        renderer: str | None = None,
        cameras: Mapping[str, str] = MappingProxyType({}),
        *,
        speeds: bool = False,
    ) -> None:
        self.world, self.model, self.data = world, model, data or mujoco.MjData(model)
        self.renderer, self.speeds, self._cameras = renderer, speeds, cameras
        self.shifts: EpisodeShifts | None = None
        self._views: Views | None = None
        self._encoder: tuple[Scene, StateEncoder] | None = None

    @classmethod
    def of(
        cls,
        scene: Scene,
        renderer: str | None = None,
        shifts: EpisodeShifts | None = None,
        *,
        speeds: bool = False,
    ) -> Simulation:
        """The simulation of an episode that begins in this scene, with these shifts."""
        world = World(scene)
        simulation = cls(world, copy(world_model(world.structure)), renderer=renderer, speeds=speeds)
        simulation.shifts = shifts
        simulation._begin()
        return simulation

    @property
    def scene(self) -> Scene:
        """Where everything is now, fingers included."""
        return self.world.read(self.data.qpos)

    def start(self, scene: Scene, shifts: EpisodeShifts | None = None) -> None:
        """Puts everything to the start of an episode in this scene, exactly as if newly compiled, with these shifts.

        Compiling takes more than ten times as long as rewriting a model, and most scenes differ in numbers only.
        """
        if self.shifts is not None and self.shifts.changes_model:
            write_numbers(self.model, world_model(self.world.structure))
        self.shifts = shifts
        if scene != self.world.scene:
            before, self.world = self.world, World(scene)
            if self.world.structure != before.structure:
                self.model = copy(world_model(self.world.structure))
                self.data = mujoco.MjData(self.model)
        self._begin()

    def _begin(self) -> None:
        """Solves twice, since the solver starts from its last solution, and protocol 1 has always started after two."""
        model, data = self.model, self.data
        self.world.rewrite(model, data, change=None if self.shifts is None else self.shifts.model)
        mujoco.mj_resetData(model, data)
        enabled = model.opt.disableflags
        model.opt.disableflags = enabled | _NO_ACTUATION  # there are no controls yet
        try:
            mujoco.mj_forward(model, data)
            mujoco.mj_forward(model, data)
        finally:
            model.opt.disableflags = enabled

    def copy(self) -> Simulation:
        """Another simulation in the same state, which shares the model, and takes actions as they are commanded."""
        return Simulation(self.world, self.model, copy(self.data), self.renderer, self._cameras, speeds=self.speeds)

    def act(self, action: Any) -> None:
        """Simulates one action of 1/8 s; see `command` and `advance`."""
        self.command(action)
        self.advance(SUBSTEPS)

    def command(self, action: Any) -> None:
        """Writes the controls of an action.

        Raises:
            InvalidActionError: if the action is not one of the 18, nor, where actions are speeds, a vector of them.
        """
        if self.speeds:
            self._command_speeds(action)
            return
        number, scene = action_number(action), self.world.scene
        if self.shifts is not None:
            number = self.shifts.action(number)
        self.data.ctrl[:] = control_signal(number, scene.robot.body, scene.dynamics.veer)

    def _command_speeds(self, action: Any) -> None:
        """Writes the controls of a vector of speeds, or of one of the 18 actions: full speed, or none."""
        world, data = self.world, self.data
        size = 3 if world.has_fingers else 2
        if np.ndim(action) == 0 or isinstance(action, Action):
            number = action_number(action)
            vector = to_vector(number if self.shifts is None else self.shifts.action(number))[:size]
        else:
            vector = as_speeds(action, size)
        fingers = world.fingers(data.qpos) if world.has_fingers else None
        data.ctrl[:] = speed_signal(vector, fingers, data.ctrl)

    def advance(self, steps: int) -> None:
        """Takes some steps of MuJoCo.

        The last half of its step is done first, and its first half last. So positions and what follows from them, such
        as contacts and the places of bodies, are always those of the present state.

        Raises:
            PhysicsError: if the simulation becomes unstable.
        """
        model, data = self.model, self.data
        warnings = data.warning.number
        before = warnings.tobytes()
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, steps - 1)
        mujoco.mj_step1(model, data)
        if warnings.tobytes() != before:
            counts = zip(mujoco.mjtWarning.__members__, warnings > np.frombuffer(before, warnings.dtype), strict=False)
            names = ", ".join(name for name, new in counts if new)
            raise PhysicsError(f"the simulation has become unstable, MuJoCo warns of {names}: the episode cannot go on")

    def state_vector(self) -> NDArray[np.float32]:
        """See `magical_mj.Engine.state_vector`."""
        world, data = self.world, self.data
        if self._encoder is None or self._encoder[0] is not world.scene:
            self._encoder = world.scene, StateEncoder(world.scene)
        return self._encoder[1](world.poses(data.qpos), world.poses(data.qvel), world.fingers(data.qpos))

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A view of the present state, fresh or in `out`, top row first: see `rendering.renderer.Views.draw`."""
        if self._views is None or self._views.model is not self.model:
            self._views = Views(self.model, self.renderer, self._cameras)
        if self.shifts is None or not self.shifts.changes_pictures or view not in VIEWS:
            return self._views.draw(self.data, view, size, out)
        check_out(out, size)
        bare = np.empty((size, size), np.uint8) if self.shifts.changes_ground else None
        place = None if self.shifts.filters else out  # which has gaps in memory
        picture = self._views.draw(self.data, view, size, place, bare)
        frame = self._frame(view, self.shifts.steps)
        picture = self.shifts.picture(picture, frame, bare, self.world.scene.half_width)
        if out is None or place is out:
            return picture
        for channel in range(3):  # three strided copies are faster than one of triples
            out[..., channel] = picture[..., channel]
        return out

    def _frame(self, view: str, step: int) -> Frame:
        """What shifts are told about a picture of this view."""
        camera = mujoco.mj_name2id(self.model, mujoco.mjtObj.mjOBJ_CAMERA, self._cameras.get(view, view))
        (x, y, _), axes = self.data.cam_xpos[camera].tolist(), self.data.cam_xmat[camera].tolist()
        return Frame(view, step, (x, y, math.atan2(axes[3], axes[0]), float(self.model.cam_fovy[camera])))

    def free(self) -> None:
        """Frees what the simulation drew with; the drawing context, which all share, remains."""
        self._views = None

    def state(self, steps: int, trajectory: Sequence[Scene] = ()) -> State:
        """The state of the episode, after so many steps through these scenes, if they count."""
        scene, saved = self.world.scene, self.save()
        if self.shifts is None:
            return State(scene, steps, saved, trajectory=tuple(trajectory))
        commands = {name: tuple(commands) for name, commands in self.shifts.commands.items()}
        return State(scene, steps, saved, draws=self.shifts.draws, commands=commands, trajectory=tuple(trajectory))

    def save(self) -> NDArray[np.float64]:
        """The complete present state in a fresh array. Shape (state size + number of trees,).

        It is MuJoCo's integration state and, since that lacks it, which trees (bodies with their children) sleep.
        """
        size = mujoco.mj_stateSize(self.model, _INTEGRATION)
        saved = np.empty(size + self.model.ntree)
        mujoco.mj_getState(self.model, self.data, saved[:size], _INTEGRATION)
        saved[size:] = self.data.tree_asleep
        return saved

    def restore(self, saved: NDArray[np.float64]) -> None:
        """Restores a state that `save` returned for the same model: what follows is exactly the same.

        Raises:
            StateError: if it is not a state of this model.
        """
        size = mujoco.mj_stateSize(self.model, _INTEGRATION)
        length = size + self.model.ntree
        whole = isinstance(saved, np.ndarray) and saved.dtype == np.float64 and saved.shape == (length,)
        if not whole or not (np.abs(saved) <= MAX_NUMBER).all():  # beyond, MuJoCo starts again without a word
            raise StateError(
                f"a state of this scene is an array of {length} finite float64, none of them beyond {MAX_NUMBER:g}; "
                "see get_state()"
            )
        asleep = saved[size:]
        sleeping = asleep >= 0
        together = np.array_equal(np.sort(asleep[sleeping]), np.flatnonzero(sleeping))
        if not together or asleep.min() < _SMALLEST_INTEGER or (asleep % 1).any():
            raise StateError("the state is damaged: the entries about sleeping bodies are inconsistent")
        before = self.save()
        try:
            self._put(saved)
        except mujoco.FatalError as error:
            self._put(before)
            raise StateError(f"the state is damaged: MuJoCo cannot continue from it ({error})") from error

    def _put(self, saved: NDArray[np.float64]) -> None:
        model, data = self.model, self.data
        size = mujoco.mj_stateSize(model, _INTEGRATION)
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, saved[:size], _INTEGRATION)
        mujoco.mj_fwdPosition(model, data)  # with everything awake, since MuJoCo does not update sleeping bodies
        data.tree_asleep[:] = saved[size:]
        _update_sleep(model, data)
        mujoco.mj_step1(model, data)


def write_numbers(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Gives a model the numbers of another one with the same structure, which takes less time than a copy of it."""
    arrays, options = _fields()
    for name in arrays:
        values = getattr(other, name)
        if values.size:
            getattr(model, name)[...] = values
    for name in options:
        setattr(model.opt, name, getattr(other.opt, name))


@cache
def _fields() -> tuple[list[str], list[str]]:
    """The names of a model's arrays, and of its options."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    arrays = [name for name in dir(model) if name[0] != "_" and isinstance(getattr(model, name), np.ndarray)]
    return arrays, [name for name in dir(model.opt) if name[0] != "_" and not callable(getattr(model.opt, name))]


def _update_sleep(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Updates what MuJoCo derives from `tree_asleep`; it has no public function for this."""
    data.tree_awake[:] = data.tree_asleep < 0
    in_tree = model.body_treeid >= 0
    data.body_awake[:] = np.where(in_tree, data.tree_awake[model.body_treeid], mujoco.mjtSleepState.mjS_STATIC.value)
    moves = data.body_awake != mujoco.mjtSleepState.mjS_ASLEEP.value
    parent_moves = moves[model.body_parentid]
    parent_moves[0] = False  # the world has no parent
    for name, which in (("body", moves), ("parent", parent_moves), ("dof", data.tree_awake[model.dof_treeid])):
        indices = np.flatnonzero(which)
        getattr(data, f"{name}_awake_ind")[: len(indices)] = indices
        setattr(data, "nv_awake" if name == "dof" else f"n{name}_awake", len(indices))
    data.ntree_awake = int(data.tree_awake.sum())
