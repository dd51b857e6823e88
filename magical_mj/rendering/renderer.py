"""Renderers: each draws the pictures of one model.

On software OpenGL every drawn pixel costs time. Frames are cheap because of this:

- They are drawn at twice the size and averaged 2 x 2: cheaper than multisampling, and closer to the original.
- Geoms are drawn in the order in which the model lists them, static ones first, so no depth buffer is needed. Their
  heights have the same order, so other MuJoCo viewers, which use a depth buffer, show the same picture.
- The floor, which is white, is not drawn: pixels without a geom (alpha 0) become white afterwards.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import mujoco
import numpy as np

from magical_mj.rendering import gl
from magical_mj.rendering.backend import check_renderer
from magical_mj.rendering.canvas import CANVAS, DRAWN_GROUPS, FORKED, Context, Picture
from magical_mj.scene.state_vector import SEGMENTATIONS, SOLID_VIEW
from magical_mj.utils.errors import RenderingError, SettingsError, as_integer, short_repr

if TYPE_CHECKING:
    from magical_mj.rendering.software import SoftwareRenderer

_FLAT: Final = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)
"""Ambient and diffuse light with which pixels have exactly the colours of the palette."""
_STILL, _MOVING = mujoco.mjtCatBit.mjCAT_STATIC.value, mujoco.mjtCatBit.mjCAT_DYNAMIC.value
LARGEST: Final = 2048
"""Side of the largest picture, in pixels."""

OVERSAMPLING: Final = 2
"""Drawn pixels per side of a picture's pixel."""

_EACH: Final = np.uint64(0x0001_0001_0001_0001)
"""One in each quarter of a word: red, green, blue, alpha, lowest first."""
_EACH_COLOUR: Final = np.uint64(0x0000_0001_0001_0001)


def check_size(value: Any, name: str = "image_size") -> int:
    """The side of a picture as an int.

    Raises:
        SettingsError: unless it is an integer in 1..LARGEST; the error calls it `name`.
    """
    size = as_integer(value, 1, LARGEST)
    if size is None:
        raise SettingsError(f"{name} must be an integer in 1..{LARGEST} (pixels per side), not {short_repr(value)}")
    return size


def check_out(out: Any, size: int, channels: tuple[int, ...] = (3,)) -> None:
    """Raises a `SettingsError` unless a picture of this size can be written to the array, if there is one."""
    if out is None:
        return
    shape = (size, size, *channels)
    if not isinstance(out, np.ndarray):
        raise SettingsError(f"out must be an array of shape {shape}, uint8, not {short_repr(out)}")
    if out.shape != shape or out.dtype != np.uint8:
        raise SettingsError(f"out must be of shape {shape}, uint8, not {out.shape}, {out.dtype}")
    if not out.flags.writeable:
        raise SettingsError("out is a read-only array; give one that can be written to, or a copy")


class Views:
    """Draws all views of one model; what each needs is made when it is first drawn.

    Args:
        model: the model.
        renderer: "opengl" or "software" for the flat views. None: as MAGICAL_MJ_RENDERER says, else OpenGL if it works
            here, else software with a warning. What users have added to a model is drawn by OpenGL alone.
        cameras: the names of the model's cameras where they are not those of the views.
    """

    def __init__(
        self, model: mujoco.MjModel, renderer: str | None = None, cameras: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self.model, self._cameras = model, cameras
        self._wanted = check_renderer(renderer)
        self._flat: Renderer | SoftwareRenderer | None = None
        self._segments: SoftwareRenderer | None = None
        self._solid: SolidRenderer | None = None

    def draw(
        self, data: mujoco.MjData, view: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """The view of the present state, top row first, fresh or in `out`: RGB, shape (size, size, 3), uint8.

        Args:
            data: the state; its positions must be current (as after `mj_forward`).
            view: "ego", "allo", "scene", or a segmentation such as "ego-segmentation", which has shape (size, size).
            size: pixels per side.
            out: where to write it.
            bare: where to write how many of the four samples of each pixel of a flat view nothing covers, shape
                (size, size); None: nowhere.

        Raises:
            RenderingError: if OpenGL is needed and does not work here; it says what to do.
            SettingsError: if `out` cannot hold it.
        """
        if view in SEGMENTATIONS:
            check_out(out, size, ())
            self._segments = self._segments or _software(self.model)
            return self._segments.draw(data, view, size, out)
        check_out(out, size)
        if view == SOLID_VIEW:
            self._solid = self._solid or SolidRenderer(self.model)
            return self._solid.draw(data, view, size, out)
        self._flat = self._flat or self._choose()
        return self._flat.draw(data, self._cameras.get(view, view), size, out, bare)

    def _choose(self) -> Renderer | SoftwareRenderer:
        if self._wanted == "software":
            with contextlib.suppress(RenderingError):  # of a model that users have changed
                return _software(self.model)
            return Renderer(self.model)
        try:
            with CANVAS:
                return Renderer(self.model)
        except RenderingError as error:
            if self._wanted != "opengl" and str(error) != FORKED:
                with contextlib.suppress(RenderingError):
                    renderer = _software(self.model)
                    _warn(str(error))
                    return renderer
            raise


def _software(model: mujoco.MjModel) -> SoftwareRenderer:
    from magical_mj.rendering.software import SoftwareRenderer  # imported late: it compiles

    return SoftwareRenderer(model)


@cache
def _warn(error: str) -> None:
    """Says once that pictures come from the software renderer."""
    text = f'{error} Until then the software renderer draws the flat views; renderer="software" says that you want it'
    warnings.warn(text, stacklevel=5)


class Renderer:
    """Draws the states of one model. Cheap to make; OpenGL starts at the first frame."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self.model = model
        self._context: Context | None = None
        self._scene: mujoco.MjvScene | None = None
        self._cameras: dict[str, mujoco.MjvCamera] = {}
        self._perturbation = mujoco.MjvPerturb()
        self._option = mujoco.MjvOption()
        self._option.geomgroup[:] = self._option.skingroup[:] = [group in DRAWN_GROUPS for group in range(6)]
        self._option.sitegroup[:] = self._option.tendongroup[:] = 0

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """A picture from a camera of the model, as `Views.draw`."""
        with CANVAS:
            try:
                pixels = self.paint(data, camera, size)
            except gl.functions().error:
                CANVAS.restart()
                pixels = self.paint(data, camera, size)
        if bare is not None:
            empty = (pixels[::-1, :, 3] == 0).reshape(size, OVERSAMPLING, size, OVERSAMPLING)
            empty.sum(axis=(1, 3), dtype=np.uint8, out=bare)
        return on_white(pixels, out)

    def paint(self, data: mujoco.MjData, camera: str, size: int) -> Picture:
        """The pixels for `on_white`, which the next call overwrites. The canvas must be current."""
        context, scene, option = self._context, self._scene, self._option
        if context is None or scene is None or context not in CANVAS.contexts:
            context = self._context = CANVAS.context_for(self.model)
            scene = self._scene = context.scene_for(self.model)
        mujoco.mjv_updateScene(self.model, data, option, None, self._get_camera(camera), _STILL, scene)
        mujoco.mjv_addGeoms(self.model, data, option, self._perturbation, _MOVING, scene)
        scene.nlight, light = 1, scene.lights[0]
        light.ambient, light.diffuse = _FLAT
        return CANVAS.draw(context, scene, OVERSAMPLING * size, OVERSAMPLING * size)

    def _get_camera(self, name: str) -> mujoco.MjvCamera:
        if name not in self._cameras:
            camera = mujoco.MjvCamera()
            camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            camera.fixedcamid = self.model.camera(name).id
            self._cameras[name] = camera
        return self._cameras[name]


class SolidRenderer(Renderer):
    """Draws one model as MuJoCo's viewers do: in 3-D, with lights and shadows, from the initial free camera."""

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__(model)
        self._option = mujoco.MjvOption()
        self._camera = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, self._camera)

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, bare: Picture | None = None
    ) -> Picture:
        """As `Renderer.draw`, but averaged from twice as many pixels per side, for smooth slanted edges; no `bare`."""
        del bare
        drawn = super().draw(data, camera, 2 * size).reshape(size, 2, size, 2, 3)
        picture = np.empty((size, size, 3), np.uint8) if out is None else out
        picture[:] = (drawn.sum(axis=(1, 3), dtype=np.uint16) + 2) >> 2
        return picture

    def paint(self, data: mujoco.MjData, camera: str, size: int) -> Picture:
        """As `Renderer.paint`, always from the free camera; `camera` is ignored."""
        del camera
        model, context = self.model, CANVAS.context_for(self.model, lit=True)
        scene = context.scene_for(model)
        mujoco.mjv_updateScene(model, data, self._option, None, self._camera, mujoco.mjtCatBit.mjCAT_ALL.value, scene)
        return CANVAS.draw(context, scene, OVERSAMPLING * size, OVERSAMPLING * size)


def on_white(pixels: Picture, out: Picture | None = None) -> Picture:
    """The finished picture of drawn pixels: averaged 2 x 2, on a white background, top row first.

    The four numbers of a pixel are added as one 64-bit word: each has 16 bits, which the sum of four cannot exceed.

    Args:
        pixels: red, green, blue (all 0 where nothing was drawn) and alpha (0 there, else 255), bottom row first.
            Shape (2 * height, 2 * width, 4).
        out: where to write it, shape (height, width, 3); None: into a fresh array.
    """
    height, width = pixels.shape[0] // OVERSAMPLING, pixels.shape[1] // OVERSAMPLING
    rows = pixels.reshape(height, OVERSAMPLING, -1)[::-1]
    columns = np.add(rows[:, 0], rows[:, 1], dtype=np.uint16).view(np.uint64)
    average = columns[:, ::2] + columns[:, 1::2]
    average += 2 * _EACH  # to round
    average >>= np.uint64(2)
    average &= 0xFF * _EACH
    paper = average >> np.uint64(48)  # alpha
    paper ^= np.uint64(0xFF)  # 255 - alpha; colour + paper is at most 255
    paper *= _EACH_COLOUR
    average += paper
    levels = average.view(np.uint8).reshape(height, width, -1)
    picture = np.empty((height, width, 3), np.uint8) if out is None else out
    for channel in range(3):  # three strided copies are faster than one of triples
        picture[..., channel] = levels[..., 2 * channel]
    return picture
