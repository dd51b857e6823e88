"""The simulation of a world: composer's physics, with actions, pictures, and saved states."""

from __future__ import annotations

from copy import copy
from typing import Any, Final

import mujoco
import numpy as np
from dm_control.mujoco import wrapper
from numpy.typing import NDArray

from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import control_signal
from magical_mj.assets.world import World, world_model
from magical_mj.envs.composer.internals import UnindexedPhysics
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Renderer, SolidRenderer, check_out
from magical_mj.scene.actions import action_number
from magical_mj.scene.scene import MAX_NUMBER
from magical_mj.scene.state_vector import SOLID_VIEW
from magical_mj.utils.errors import StateError

_RK4: Final = mujoco.mjtIntegrator.mjINT_RK4.value
_LEAST: Final = np.iinfo(np.int32).min
_INTEGRATION: Final = mujoco.mjtState.mjSTATE_INTEGRATION


class Simulation(UnindexedPhysics):
    """The simulation of a world, at rest in its scene after each reset."""

    _ours: mujoco.MjModel | None = None
    _renderer: Renderer | None = None
    _solid_renderer: SolidRenderer | None = None

    @classmethod
    def of(cls, world: World) -> Simulation:
        """Compiles a world from its spec, or from composer's tree if a user has read that."""
        if world.tree is not None:
            return cls.from_mjcf_model(world.tree)
        model = wrapper.MjModel(copy(world_model(world.structure)))
        data = wrapper.MjData(model)
        world.rewrite(model.ptr, data.ptr)
        mujoco.mj_resetData(model.ptr, data.ptr)  # to the scene
        simulation = cls(data)
        simulation._ours = model.ptr
        return simulation

    @property
    def is_ours(self) -> bool:
        """Whether the model was compiled from our own spec; users may have changed composer's tree."""
        return self.model.ptr is self._ours

    def step(self, nstep: int = 1) -> None:
        """As dm_control's, with less Python around the same physics.

        Raises:
            dm_control.rl.control.PhysicsError: if the simulation has become unstable.
        """
        model, data, before = self.model.ptr, self.data.ptr, self.warning_counts.tobytes()
        if self.legacy_step and model.opt.integrator != _RK4:
            mujoco.mj_step2(model, data)  # mj_step1 was done at the end of the last step
            mujoco.mj_step(model, data, nstep - 1)
        else:
            mujoco.mj_step(model, data, nstep)
        if self.legacy_step:
            mujoco.mj_step1(model, data)
        after = self.warning_counts.tobytes()
        if after != before:
            self.warning_counts[:] = np.frombuffer(before, self.warning_counts.dtype)
            with self.check_invalid_state():  # raises an error or logs it, as dm_control is configured
                self.warning_counts[:] = np.frombuffer(after, self.warning_counts.dtype)

    def command(self, action: Any) -> None:
        """Writes the controls of one of the 18 actions.

        Raises:
            InvalidActionError: if it is not one of them.
        """
        self.data.ctrl[:] = control_signal(action_number(action))

    def act(self, action: Any) -> None:
        """Simulates one action of 1/8 s.

        Raises:
            InvalidActionError: if the action is not one of the 18.
            dm_control.rl.control.PhysicsError: if the simulation becomes unstable.
        """
        self.command(action)
        self.step(SUBSTEPS)

    def save(self) -> NDArray[np.float64]:
        """The complete present state in a fresh array. Shape (state size + number of trees,).

        It is MuJoCo's integration state and, since that lacks it, which trees (bodies with their children) sleep.
        """
        model, data = self.model.ptr, self.data.ptr
        size = mujoco.mj_stateSize(model, _INTEGRATION)
        saved = np.empty(size + model.ntree)
        mujoco.mj_getState(model, data, saved[:size], _INTEGRATION)
        saved[size:] = data.tree_asleep
        return saved

    def restore(self, saved: NDArray[np.float64]) -> None:
        """Restores a state that `save` returned for the same model: what follows is exactly the same.

        Raises:
            StateError: if it is not a state of this model.
        """
        model = self.model.ptr
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
        before = self.save()
        try:
            self._put(saved)
        except mujoco.FatalError as error:
            self._put(before)
            raise StateError(f"the state is damaged: MuJoCo cannot continue from it ({error})") from error

    def _put(self, saved: NDArray[np.float64]) -> None:
        model, data = self.model.ptr, self.data.ptr
        size = mujoco.mj_stateSize(model, _INTEGRATION)
        mujoco.mj_resetData(model, data)
        mujoco.mj_setState(model, data, saved[:size], _INTEGRATION)
        mujoco.mj_fwdPosition(model, data)  # with everything awake, since MuJoCo does not update sleeping bodies
        data.tree_asleep[:] = saved[size:]
        _update_sleep(model, data)
        mujoco.mj_step1(model, data)

    def draw(self, view: str, size: int, out: Picture | None = None) -> Picture:
        """A picture of the present state, fresh or in `out`. Shape (size, size, 3), RGB, top row first."""
        check_out(out, size)
        model = self.model.ptr
        if view == SOLID_VIEW:
            if self._solid_renderer is None or self._solid_renderer.model is not model:
                self._solid_renderer = SolidRenderer(model)
            return self._solid_renderer.draw(self.data.ptr, view, size, out)
        if self._renderer is None or self._renderer.model is not model:
            self._renderer = Renderer(model)
        return self._renderer.draw(self.data.ptr, view, size, out)

    def free(self) -> None:
        """Frees the simulation and what it drew with."""
        for renderer in (self._renderer, self._solid_renderer):
            if renderer is not None:
                renderer.close()
        self._renderer = self._solid_renderer = None
        super().free()


def _update_sleep(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Updates what MuJoCo derives from `tree_asleep`; it has no public function for this."""
    data.tree_awake[:] = data.tree_asleep < 0
    in_tree = model.body_treeid >= 0
    data.body_awake[:] = np.where(in_tree, data.tree_awake[model.body_treeid], mujoco.mjtSleepState.mjS_STATIC.value)
    moves = data.body_awake != mujoco.mjtSleepState.mjS_ASLEEP.value
    parent_moves = moves[model.body_parentid]
    parent_moves[0] = False  # the world has no parent
    for name, which in (("body", moves), ("parent", parent_moves), ("dof", data.tree_awake[model.dof_treeid])):
        found = np.flatnonzero(which)
        getattr(data, f"{name}_awake_ind")[: len(found)] = found
        setattr(data, "nv_awake" if name == "dof" else f"n{name}_awake", len(found))
    data.ntree_awake = int(data.tree_awake.sum())
