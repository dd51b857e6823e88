"""The simulation of a world: MuJoCo's model and data, with actions, pictures, and saved states."""

from __future__ import annotations

from copy import copy
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal
from magical_mj.assets.world import World, world_model
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Views
from magical_mj.scene import Scene
from magical_mj.scene.actions import action_number
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.utils.errors import PhysicsError, StateError

_LEAST: Final = np.iinfo(np.int32).min
_INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION
_NO_ACTUATION: Final = mujoco.mjtDisableBit.mjDSBL_ACTUATION.value


class Simulation:
    """The simulation of a world, at rest in its scene after `start`.

    Args:
        scene: the first scene.

    Attributes:
        world: the world of the present scene.
        model: MuJoCo's model. `start` replaces it if the new scene has another structure.
        data: MuJoCo's state of that model.
    """

    world: World
    model: mujoco.MjModel
    data: mujoco.MjData

    def __init__(self, scene: Scene, renderer: str | None = None) -> None:
        self.renderer = renderer
        self._views: Views | None = None
        self._compile(World(scene))
        self._begin()

    def start(self, scene: Scene) -> None:
        """Puts everything to the start of an episode in this scene, exactly as if newly compiled.

        Compiling takes more than ten times as long as rewriting a model, and most scenes differ in numbers only.
        """
        if scene != self.world.scene:
            before, self.world = self.world, World(scene)
            if self.world.structure != before.structure:
                self._compile(self.world)
        self._begin()

    def _compile(self, world: World) -> None:
        self.world, self.model = world, copy(world_model(world.structure))
        self.data = mujoco.MjData(self.model)

    def _begin(self) -> None:
        """Twice, since the solver starts from its last solution, and protocol 1 has always started after two."""
        model, data = self.model, self.data
        self.world.rewrite(model, data)
        mujoco.mj_resetData(model, data)
        enabled = model.opt.disableflags
        model.opt.disableflags = enabled | _NO_ACTUATION  # there are no controls yet
        try:
            mujoco.mj_forward(model, data)
            mujoco.mj_forward(model, data)
        finally:
            model.opt.disableflags = enabled

    def copy(self) -> Simulation:
        """Another simulation in the same state, which shares the model."""
        twin = object.__new__(type(self))
        twin.world, twin.model, twin.data = self.world, self.model, copy(self.data)
        twin.renderer, twin._views = self.renderer, None
        return twin

    def act(self, action: Any) -> None:
        """Simulates one action of 1/8 s.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            PhysicsError: if the simulation becomes unstable.
        """
        self.data.ctrl[:] = control_signal(action_number(action))
        advance(self.model, self.data, SUBSTEPS)

    def save(self) -> NDArray[np.float64]:
        """The complete present state in a fresh array. Shape (state size + number of trees,).

        It is MuJoCo's integration state and, since that lacks it, which trees (bodies with their children) sleep.
        """
        return save(self.model, self.data)

    def restore(self, saved: NDArray[np.float64]) -> None:
        """Restores a state that `save` returned for the same model: what follows is exactly the same.

        Raises:
            StateError: if it is not a state of this model.
        """
        restore(self.model, self.data, saved)

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A view of the present state, fresh or in `out`, top row first: see `rendering.renderer.Views.draw`."""
        if self._views is None or self._views.model is not self.model:
            self._views = Views(self.model, self.renderer)
        return self._views.draw(self.data, view, size, out)

    def free(self) -> None:
        """Frees what the simulation drew with."""
        if self._views is not None:
            self._views.close()
        self._views = None


def advance(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> None:
    """Takes some steps of MuJoCo.

    The last half of its step is done first, and its first half last. So positions and what follows from them, such as
    contacts and the places of bodies, are always those of the present state.

    Raises:
        PhysicsError: if the simulation becomes unstable.
    """
    warnings = data.warning.number
    before = warnings.tobytes()
    mujoco.mj_step2(model, data)
    mujoco.mj_step(model, data, steps - 1)
    mujoco.mj_step1(model, data)
    if warnings.tobytes() != before:
        counts = zip(mujoco.mjtWarning.__members__, warnings > np.frombuffer(before, warnings.dtype), strict=False)
        names = ", ".join(name for name, new in counts if new)
        raise PhysicsError(f"the simulation has become unstable, MuJoCo warns of {names}: the episode cannot go on")


def save(model: mujoco.MjModel, data: mujoco.MjData) -> NDArray[np.float64]:
    """See `Simulation.save`."""
    size = mujoco.mj_stateSize(model, _INTEGRATION)
    saved = np.empty(size + model.ntree)
    mujoco.mj_getState(model, data, saved[:size], _INTEGRATION)
    saved[size:] = data.tree_asleep
    return saved


def restore(model: mujoco.MjModel, data: mujoco.MjData, saved: NDArray[np.float64]) -> None:
    """See `Simulation.restore`."""
    size = mujoco.mj_stateSize(model, _INTEGRATION)
    whole = isinstance(saved, np.ndarray) and saved.dtype == np.float64 and saved.shape == (size + model.ntree,)
    if not whole or not (np.abs(saved) <= MAX_NUMBER).all():  # beyond, MuJoCo starts again without a word
        raise StateError(
            f"a state of this scene is an array of {size + model.ntree} finite float64, none of them beyond "
            f"{MAX_NUMBER:g}; see get_state()"
        )
    asleep = saved[size:]
    sleeping = asleep >= 0
    together = np.array_equal(np.sort(asleep[sleeping]), np.flatnonzero(sleeping))
    if not together or asleep.min() < _LEAST or (asleep % 1).any():
        raise StateError("the state is damaged: the entries about sleeping bodies are inconsistent")
    before = save(model, data)
    try:
        _put(model, data, saved)
    except mujoco.FatalError as error:
        _put(model, data, before)
        raise StateError(f"the state is damaged: MuJoCo cannot continue from it ({error})") from error


def _put(model: mujoco.MjModel, data: mujoco.MjData, saved: NDArray[np.float64]) -> None:
    size = mujoco.mj_stateSize(model, _INTEGRATION)
    mujoco.mj_resetData(model, data)
    mujoco.mj_setState(model, data, saved[:size], _INTEGRATION)
    mujoco.mj_fwdPosition(model, data)  # with everything awake, since MuJoCo does not update sleeping bodies
    data.tree_asleep[:] = saved[size:]
    _update_sleep(model, data)
    mujoco.mj_step1(model, data)


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
