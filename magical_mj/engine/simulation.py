"""The simulation of an episode: MuJoCo's model and data, with actions, scores, pictures, and states to save."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import Action, action_number, as_speeds, to_vector
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import controls, speed_signal
from magical_mj.assets.scene_model import SceneModel, compiled_model, new_model
from magical_mj.engine.episode import PLAIN, Setup, State
from magical_mj.observations import VIEWS, StateEncoder
from magical_mj.rendering.picture import Picture
from magical_mj.rendering.renderer import KINDS, Renderer, new_renderer
from magical_mj.scene import Scene
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.shifts.episode import Draws, EpisodeShifts
from magical_mj.shifts.shift import Frame
from magical_mj.utils.errors import PhysicsError, StateError

_SMALLEST_INTEGER: Final = np.iinfo(np.int32).min
_INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_NO_ACTUATION: Final = mujoco.mjtDisableBit.mjDSBL_ACTUATION.value


class Simulation:
    """The simulation of an episode. After `start`, the scene's objects are at rest in their initial poses.

    Args:
        setup: the setup of the episodes.
        scene_model: the initial scene and its coordinates.
        model: the compiled model of a scene with this structure; None: a new one.
        data: MuJoCo's data of this model; None: new data.
        renderer: "opengl", "software" or None, as for `magical_mj.Engine`.
        cameras: the names of the views' cameras in the model, where they differ from the views' names.

    Attributes:
        scene_model: the initial scene of the current episode, and its coordinates.
        episode_shifts: the shifts of the current episode.
        trajectory: the scenes of the episode so far if the score depends on all of them; otherwise empty.
    """

    def __init__(
        self,
        setup: Setup,
        scene_model: SceneModel,
        model: mujoco.MjModel | None = None,
        data: mujoco.MjData | None = None,
        renderer: str | None = None,
        cameras: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self._setup, self.scene_model = setup, scene_model
        self._model = new_model(scene_model.structure) if model is None else model
        self._data = mujoco.MjData(self._model) if data is None else data
        self.renderer, self._cameras = renderer, cameras
        self.episode_shifts = EpisodeShifts()
        self._steps, self.trajectory = 0, list[Scene]()
        self._last_remaining: tuple[Any, float] = None, 0.0  # (steps, positions), and the distance there
        self._renderers: dict[str, Renderer] = {}
        self._encoder: tuple[Scene, bool, StateEncoder] | None = None

    @classmethod
    def of(cls, scene: Scene, shifts: EpisodeShifts | None = None, renderer: str | None = None) -> Simulation:
        """The simulation of a plain scene with these shifts, at its start."""
        simulation = Simulation(PLAIN, SceneModel(scene), renderer=renderer)
        simulation.start(scene, shifts)
        return simulation

    @property
    def setup(self) -> Setup:
        """Task, variant, rules and body, and the properties that follow from them."""
        return self._setup

    @property
    def model(self) -> mujoco.MjModel:
        """MuJoCo's model. `start` replaces it if the new scene has another structure."""
        return self._model

    @property
    def data(self) -> mujoco.MjData:
        """MuJoCo's data of that model."""
        return self._data

    @property
    def steps(self) -> int:
        """The number of actions since the start of the episode."""
        return self._steps

    @property
    def scene(self) -> Scene:
        """The current scene, with the poses of robot, blocks and fingers."""
        return self.scene_model.read(self._data.qpos)

    @property
    def initial_scene(self) -> Scene:
        """The initial scene of this episode."""
        return self.scene_model.scene

    @property
    def draws(self) -> Draws:
        """The values that the shifts of this episode have drawn: for each shift its factors and its seed."""
        return self.episode_shifts.draws

    @property
    def instruction(self) -> str:
        """The sentence that describes the task in this episode; "" for plain scenes."""
        return self.episode_shifts.instruction(self._setup.spec.instruction, str(self._setup.task))

    def start(self, scene: Scene, shifts: EpisodeShifts | None = None) -> None:
        """Starts an episode in this scene with these shifts. The result equals that of a newly compiled model.

        Compiling takes more than ten times as long as rewriting a model, and most scenes differ only in numbers.
        """
        changed, before = self.episode_shifts.changes_model, self.scene_model.structure
        self.episode_shifts = shifts or EpisodeShifts()
        if scene != self.scene_model.scene:
            self.scene_model = SceneModel(scene)
        if self.scene_model.structure != before:
            self._model = new_model(self.scene_model.structure)
            self._data = mujoco.MjData(self._model)
            self._renderers = {}
        elif changed:
            write_numbers(self._model, compiled_model(before))
        model, data = self._model, self._data
        change = self.episode_shifts.model if self.episode_shifts.changes_model else None
        self.scene_model.rewrite(model, data, change=change)
        mujoco.mj_resetData(model, data)
        enabled = model.opt.disableflags
        model.opt.disableflags = enabled | _NO_ACTUATION  # no action has set the controls yet
        try:
            mujoco.mj_forward(model, data)
            mujoco.mj_forward(model, data)  # starts from the first solution, and changes it: protocol 1 includes that
        finally:
            model.opt.disableflags = enabled
        self.clear_records()

    def clear_records(self) -> None:
        """Sets the number of steps to 0, and the trajectory to the initial scene if the score depends on it."""
        self._steps = 0
        self.trajectory = [self.scene_model.scene] if self._setup.spec.trajectory else []
        self._last_remaining = None, 0.0

    def take_records(self, other: Simulation) -> None:
        """Takes the number of steps and the trajectory of another simulation of the same episode."""
        self._steps, self.trajectory = other.steps, other.trajectory

    def physics_copy(self) -> Simulation:
        """A copy of the model's current state. It has no shifts and no records, and executes actions as commanded."""
        twin = Simulation(self._setup, self.scene_model, self._model, renderer=self.renderer, cameras=self._cameras)
        twin.restore(self.save())
        return twin

    def act(self, action: Any) -> None:
        """Simulates one action of 1/8 s: ten steps of MuJoCo. For errors, see `command` and `advance`."""
        self.command(action)
        self.advance(SUBSTEPS)
        self.record()

    def record(self) -> None:
        """Counts an action after it was simulated, and stores the scene if the score depends on it."""
        self._steps += 1
        if self.trajectory:
            self.trajectory.append(self.scene)

    def command(self, action: Any) -> None:
        """Writes the controls of an action.

        Raises:
            InvalidActionError: if the action is neither one of the 18 nor, with `speeds`, a vector of speeds.
        """
        if self._setup.speeds:
            self._command_speeds(action)
            return
        scene_model = self.scene_model
        table = controls(scene_model.scene.robot.body, scene_model.scene.dynamics.veer)
        self._data.ctrl[scene_model.coordinates.ctrl] = table[self.episode_shifts.action(action_number(action))]

    def _command_speeds(self, action: Any) -> None:
        """Writes the controls of a vector of speeds, or of one of the 18 actions, as full speed or none."""
        scene_model, data = self.scene_model, self._data
        size = 3 if scene_model.has_fingers else 2
        if np.ndim(action) == 0 or isinstance(action, Action):
            vector = to_vector(self.episode_shifts.action(action_number(action)))[:size]
        else:
            vector = as_speeds(action, size)
        fingers = scene_model.fingers(data.qpos) if scene_model.has_fingers else None
        controls = scene_model.coordinates.ctrl
        data.ctrl[controls] = speed_signal(vector, fingers, data.ctrl[controls])

    def advance(self, steps: int) -> None:
        """Takes steps of MuJoCo.

        The second half of a step (`mj_step2`) comes first, and the first half (`mj_step1`) last. So contacts, positions
        of bodies and everything else that depends on positions always belong to the current state.

        Args:
            steps: the number of steps, at least 1.

        Raises:
            PhysicsError: if the simulation becomes unstable.
        """
        model, data = self._model, self._data
        warnings = data.warning.number
        before = warnings.tobytes()
        mujoco.mj_step2(model, data)
        mujoco.mj_step(model, data, steps - 1)
        mujoco.mj_step1(model, data)
        if warnings.tobytes() != before:
            counts = zip(mujoco.mjtWarning.__members__, warnings > np.frombuffer(before, warnings.dtype), strict=False)
            names = ", ".join(name for name, new in counts if new)
            raise PhysicsError(f"the simulation has become unstable (MuJoCo's warning: {names}): reset the environment")

    def state_vector(self, *, start: bool = False) -> NDArray[np.float32]:
        """The state vector, in a fresh array of shape (len(STATE_NAMES),).

        `magical_mj.observations.STATE_NAMES` describes its entries. With `start`, the poses in the initial scene follow
        as `magical_mj.observations.START_NAMES` describes them.

        Raises:
            InvalidSceneError: if the scene has more blocks or regions than the vector has entries for.
        """
        scene, data, at = self.scene_model.scene, self._data, self.scene_model.coordinates
        if self._encoder is None or self._encoder[0] is not scene or self._encoder[1] != start:
            self._encoder = scene, start, StateEncoder(scene, start=start)
        return self._encoder[2](data.qpos[at.qpos], data.qvel[at.qvel], data.qpos[at.fingers])

    def fingers(self) -> NDArray[np.float64]:
        """Angles of the left and the right finger, rad. Shape (2,)."""
        return self.scene_model.fingers(self._data.qpos)

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A picture of the current state, as `magical_mj.Engine.render` without a check of its arguments."""
        kind, camera = KINDS[view], self._cameras.get(view, view)
        if (renderer := self._renderers.get(kind)) is None:
            renderer = self._renderers[kind] = new_renderer(self._model, kind, self.renderer)
        if not self.episode_shifts.changes_pictures or view not in VIEWS:
            return renderer.draw(self._data, camera, size, out)
        uncovered = np.empty((size, size), np.uint8) if self.episode_shifts.changes_ground else None
        target = (
            None if self.episode_shifts.filters else out
        )  # filters need a contiguous array, and `out` may have gaps
        picture = renderer.draw(self._data, camera, size, target, uncovered)
        frame = self._frame(view, self.episode_shifts.steps)
        picture = self.episode_shifts.picture(picture, frame, uncovered, self.scene_model.scene.half_width)
        if out is None or target is out:
            return picture
        for channel in range(3):  # three strided copies are faster than one copy of triples
            out[..., channel] = picture[..., channel]
        return out

    def _frame(self, view: str, step: int) -> Frame:
        """The description of a picture that shifts receive: the view, the step and the camera."""
        camera = mujoco.mj_name2id(self._model, mujoco.mjtObj.mjOBJ_CAMERA, self._cameras.get(view, view))
        (x, y, _), axes = self._data.cam_xpos[camera].tolist(), self._data.cam_xmat[camera].tolist()
        return Frame(view, step, (x, y, math.atan2(axes[3], axes[0]), float(self._model.cam_fovy[camera])))

    def free(self) -> None:
        """Frees the simulation's renderers. The drawing context is shared and remains."""
        self._renderers = {}

    @property
    def scored_scenes(self) -> tuple[Scene, ...]:
        """The scenes that the score depends on: the initial and the current scene, or the scenes of all steps."""
        return tuple(self.trajectory) or (self.scene_model.scene, self.scene)

    @np.errstate(all="ignore")  # no result depends on the caller's settings
    def score(self) -> float:
        """The score in [0, 1] if the episode ended now. Raises an `InvalidSceneError` without a task."""
        return self._setup.spec.checked_score(self.scored_scenes, self._setup.rules)

    def side_effects(self) -> int | None:
        """The number of moved blocks that the goal does not name; None if the task does not define it."""
        count = self._setup.spec.side_effects
        return None if count is None else count(self.scene_model.scene, self.scene)

    @np.errstate(all="ignore")
    def remaining(self) -> float:
        """The remaining distance to the goal, in world units. It is 0 if and only if the score is 1.

        The module of each task defines it.

        Raises:
            InvalidSceneError: without a task.
            TaskError: if the task does not define it.
        """
        now = self._steps, self._data.qpos.tobytes()
        if self._last_remaining[0] != now:  # dense rewards ask before and after each step
            self._last_remaining = now, self._setup.spec.remaining(self.scored_scenes, self._setup.rules)
        return self._last_remaining[1]

    def get_state(self) -> State:
        """The exact current state of the episode. Takes about 1/40 of a step's time."""
        return State(
            self.scene_model.scene,
            self._steps,
            self.save(),
            draws=self.episode_shifts.draws,
            commands={name: tuple(last) for name, last in self.episode_shifts.commands.items()},
            trajectory=tuple(self.trajectory),
        )

    def resume(self, state: State) -> None:
        """Continues from a state of an episode with the same initial scene and the same values of shifts."""
        self.restore(state.simulation)
        self._steps = int(state.steps)
        self.trajectory = list(state.trajectory) if self._setup.spec.trajectory else []
        self._last_remaining = None, 0.0
        self.episode_shifts.resume(self._steps, state.commands)

    def save(self) -> NDArray[np.float64]:
        """MuJoCo's complete current state in a fresh array. Shape (state size + number of trees,).

        It is MuJoCo's integration state, and which trees (bodies with their children) sleep: that state lacks this.
        """
        size = mujoco.mj_stateSize(self._model, _INTEGRATION)
        saved = np.empty(size + self._model.ntree)
        mujoco.mj_getState(self._model, self._data, saved[:size], _INTEGRATION)
        saved[size:] = self._data.tree_asleep
        return saved

    def coordinates(self, saved: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """The positions and the velocities in a state that `save` returned. Shapes (nq,) and (nv,)."""
        nq, nv = self._model.nq, self._model.nv  # they follow the time, the first number
        return saved[1 : 1 + nq], saved[1 + nq : 1 + nq + nv]

    def restore(self, saved: NDArray[np.float64]) -> None:
        """Restores a state that `save` returned for the same model. The simulation then continues exactly as before.

        Raises:
            StateError: if it is not a state of this model.
        """
        before = self.save()
        length, trees = len(before), self._model.ntree
        whole = isinstance(saved, np.ndarray) and saved.dtype == np.float64 and saved.shape == (length,)
        if not whole or not (np.abs(saved) <= MAX_NUMBER).all():  # with larger numbers, MuJoCo resets silently
            raise StateError(
                f"a state of this scene must be an array of {length} finite float64, from -{MAX_NUMBER:g} to "
                f"{MAX_NUMBER:g}; see get_state()"
            )
        asleep = saved[length - trees :]
        sleeping = asleep >= 0
        together = np.array_equal(np.sort(asleep[sleeping]), np.flatnonzero(sleeping))
        if not together or asleep.min() < _SMALLEST_INTEGER or (asleep % 1).any():
            raise StateError("the state is damaged: the entries about sleeping bodies are inconsistent")
        try:
            self._put(saved)
        except mujoco.FatalError as error:
            self._put(before)
            raise StateError(f"the state is damaged: MuJoCo cannot continue from it ({error})") from error

    def _put(self, saved: NDArray[np.float64]) -> None:
        model, data = self._model, self._data
        state, asleep = np.split(saved, [len(saved) - model.ntree])
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, state, _INTEGRATION)
        mujoco.mj_fwdPosition(model, data)  # before any body sleeps: MuJoCo does not update sleeping bodies
        data.tree_asleep[:] = asleep
        _update_sleep(model, data)
        mujoco.mj_step1(model, data)


def write_numbers(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Copies all numbers from `other`, a model with the same structure. This is faster than copying the model."""
    arrays, options = _fields()
    for name in arrays:
        values = getattr(other, name)
        if values.size:
            getattr(model, name)[...] = values
    for name in options:
        setattr(model.opt, name, getattr(other.opt, name))


def different_numbers(model: mujoco.MjModel, other: mujoco.MjModel) -> list[str]:
    """The arrays and options that differ between two models, such as "geom_rgba". Names of objects are ignored."""
    if np.array_equal(_content(model), _content(other)):  # much faster
        return []
    arrays, options = _fields()
    pairs = {name: (getattr(model, name), getattr(other, name)) for name in arrays if not name.startswith("name")}
    pairs |= {name: (getattr(model.opt, name), getattr(other.opt, name)) for name in options}
    return [name for name, values in pairs.items() if not np.array_equal(*values, equal_nan=True)]


def _content(model: mujoco.MjModel) -> NDArray[np.uint8]:
    """All bytes of a model."""
    content = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, content)
    return content


@cache
def _fields() -> tuple[list[str], list[str]]:
    """The names of a model's arrays, and the names of its options."""
    model = mujoco.MjModel.from_xml_string("<mujoco/>")
    arrays = [name for name in dir(model) if name[0] != "_" and isinstance(getattr(model, name), np.ndarray)]
    return arrays, [name for name in dir(model.opt) if name[0] != "_" and not callable(getattr(model.opt, name))]


def _update_sleep(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Updates the fields that MuJoCo derives from `tree_asleep`. MuJoCo has no public function for this."""
    data.tree_awake[:] = data.tree_asleep < 0
    in_tree = model.body_treeid >= 0
    data.body_awake[:] = np.where(in_tree, data.tree_awake[model.body_treeid], mujoco.mjtSleepState.mjS_STATIC.value)
    moves = data.body_awake != mujoco.mjtSleepState.mjS_ASLEEP.value
    parent_moves = moves[model.body_parentid]
    parent_moves[0] = False  # the world body has no parent
    for name, which in (("body", moves), ("parent", parent_moves), ("dof", data.tree_awake[model.dof_treeid])):
        indices = np.flatnonzero(which)
        getattr(data, f"{name}_awake_ind")[: len(indices)] = indices
        setattr(data, "nv_awake" if name == "dof" else f"n{name}_awake", len(indices))
    data.ntree_awake = int(data.tree_awake.sum())
