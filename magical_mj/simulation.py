"""A compiled world: composer's physics, which also draws."""

from __future__ import annotations

from dm_control import mjcf

from magical_mj.assets.world import World
from magical_mj.rendering.canvas import Picture
from magical_mj.rendering.renderer import Renderer


class Simulation(mjcf.Physics):
    """The simulation of a world, at rest in its scene after each reset."""

    _renderer: Renderer | None = None

    @classmethod
    def of(cls, world: World) -> Simulation:
        """Compiles a world: its text, or composer's tree where somebody asked for it."""
        if world.tree is not None:
            return cls.from_mjcf_model(world.tree)
        return cls.from_xml_string(world.mjcf())

    def draw(self, view: str, size: int) -> Picture:
        """A picture of the present state. Shape (size, size, 3), RGB, top row first."""
        if self._renderer is None:
            self._renderer = Renderer(self.model.ptr)
        return self._renderer.draw(self.data.ptr, view, size)

    def free(self) -> None:
        """Frees the simulation and what it drew with."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().free()
