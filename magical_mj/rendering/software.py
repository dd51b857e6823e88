"""The software renderer: flat pictures without OpenGL, about five times as fast as with Mesa's, the same everywhere.

It draws the same polygons as OpenGL, in the same order and with samples at the same positions: the flat meshes and
skins of a compiled model that the cameras ego and allo see. It also draws segmentations. It needs no depth, since the
scene is flat.
"""

from __future__ import annotations

import re
import threading
from functools import lru_cache
from types import MappingProxyType
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.meshes import loops
from magical_mj.rendering.picture import Picture, drawn
from magical_mj.scene.bodies import is_convex
from magical_mj.utils.errors import RenderingError

FLOOR, WALL, ROBOT, FINGER, REGION, BLOCK = 0, 1, 2, 3, 16, 64
"""Values of a segmentation. Region i is REGION + i, block i is BLOCK + i. Everything beyond the walls is WALL."""
SEGMENTS: Final = MappingProxyType({"world": WALL, "face": ROBOT, "left_finger": FINGER, "right_finger": FINGER})
"""Body -> its value in a segmentation."""
SEGMENTATION: Final = "-segmentation"
"""The suffix of a camera's name that selects its segmentation."""
NOT_OURS: Final = (
    "the software renderer draws the flat meshes and regions of the benchmark's own models, not {what}; use OpenGL"
)
_MESH: Final = mujoco.mjtGeom.mjGEOM_MESH.value
_SCRATCH: Final = threading.local()


class SoftwareRenderer:
    """Draws the states of one model. Numba compiles when the first renderer is made.

    Args:
        model: the model. Colours and the corners of regions are read for each picture.

    Raises:
        RenderingError: if the cameras see a geom that is not a flat mesh.
    """

    def __init__(self, model: mujoco.MjModel) -> None:
        from magical_mj.rendering import scanlines  # imported late: numba takes 0.3 s, and may compile for seconds

        self.model = model
        self._scanlines = scanlines
        none = np.zeros((0, 4), np.float32)
        polygons, corners, self._segments = polygons_of(model)
        self._scene = polygons, corners, model.skin_vert if model.nskin else none
        self._colours = model.geom_rgba, model.skin_rgba if model.nskin else none, np.zeros(len(polygons), np.uint32)
        self._fields = model.cam_fovy
        self._cameras = {_name(model, mujoco.mjtObj.mjOBJ_CAMERA, index): index for index in range(model.ncam)}
        self._data: mujoco.MjData | None = None
        self._poses: tuple[NDArray[np.float64], ...] = ()
        self._views: list[tuple[NDArray[np.float64], NDArray[np.float64]]] = []

    def draw(
        self, data: mujoco.MjData, camera: str, size: int, out: Picture | None = None, uncovered: Picture | None = None
    ) -> Picture:
        """A picture from a camera of the model that looks straight down, as `rendering.renderer.Views.draw`.

        If the camera's name ends in "-segmentation": the value FLOOR, WALL, ROBOT, FINGER, REGION + i or BLOCK + i at
        each pixel's centre, shape (size, size).
        """
        if data is not self._data:
            self._data, self._poses = data, (data.xpos, data.xmat)
            self._views = [(data.cam_xpos[index], data.cam_xmat[index]) for index in range(self.model.ncam)]
        name = camera.removesuffix(SEGMENTATION)
        index = self._cameras[name]
        world = self._scene, self._poses, (*self._views[index], float(self._fields[index]))
        if name != camera:
            picture = np.empty((size, size), np.uint8) if out is None else out
            self._scanlines.draw_segments(*world, scratch(size), self._segments, picture)
            return picture
        picture = np.empty((size, size, 3), np.uint8) if out is None else out
        samples = scratch(2 * size)
        pairs = samples[0].view(np.uint64)
        self._scanlines.draw_picture(*world, samples, *self._colours, pairs, picture)
        if uncovered is not None:
            self._scanlines.count_uncovered(samples[0], uncovered)
        return picture


def scratch(side: int) -> tuple[NDArray[np.uint32], NDArray[np.int64], NDArray[np.int64]]:
    """This thread's arrays for a square of side x side samples: the samples, and the first and last ones of each row.

    They are kept until another size is needed.
    """
    if getattr(_SCRATCH, "side", 0) != side:
        _SCRATCH.arrays = np.empty(side * side, np.uint32), np.empty(side, np.int64), np.empty(side, np.int64)
        _SCRATCH.side = side
    return _SCRATCH.arrays


def polygons_of(model: mujoco.MjModel) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.uint32]]:
    """The polygons of a model in drawing order: geoms that cannot move, skins, geoms that can.

    Returns:
        The table of polygons for `scanlines.paint`, the corners of geoms (those of skins are in the model), and the
        value of each polygon in segmentations.
    """
    bodies, roots = model.geom_bodyid.tolist(), model.body_weldid.tolist()
    still, moving = [], []  # rows of the table, with the values in segmentations
    corners, end = list[NDArray[np.float64]](), 0
    for geom in np.flatnonzero(drawn(model.geom_group)).tolist():
        body = bodies[geom]
        segment = _segment(_name(model, mujoco.mjtObj.mjOBJ_BODY, body))
        group = moving if roots[body] else still
        for part in _parts(model, geom):
            corners.append(part)
            first, end = end, end + len(part)
            group.append((first, end, body, geom, 0, segment))
    spans = zip(model.skin_vertadr.tolist(), model.skin_vertnum.tolist(), strict=True)
    skins = [
        (start, start + 4, 0, skin, 1, min(REGION + skin // 2, BLOCK - 1))  # fill and border
        for skin, (first, count) in enumerate(spans)
        for start in range(first, first + count, 4)
    ]
    table = np.array([*still, *skins, *moving], np.int32)
    return table[:, :5].copy(), np.concatenate(corners), table[:, 5].astype(np.uint32)


def _name(model: mujoco.MjModel, kind: mujoco.mjtObj, index: int) -> str:
    """An object's name. The model's own accessors (`model.body(...)`) would leave a megabyte of views behind."""
    return mujoco.mj_id2name(model, kind.value, index) or ""


@lru_cache(maxsize=256)
def _segment(body: str) -> int:
    part = body.strip("/").rpartition("/")[2]  # composer's names begin with those of their trees
    block = re.fullmatch(r"block(\d+)", part)
    return min(BLOCK + int(block[1]), 255) if block else SEGMENTS.get(part, FLOOR)


def _parts(model: mujoco.MjModel, geom: int) -> list[NDArray[np.float64]]:
    """The convex polygons of a flat geom in its body's frame, counter-clockwise. Shapes (n, 2).

    They are the outlines of its mesh, or the mesh's triangles if an outline is not convex or has too many corners.
    """
    name = _name(model, mujoco.mjtObj.mjOBJ_GEOM, geom)
    if model.geom_type[geom] != _MESH:
        raise RenderingError(NOT_OURS.format(what=f"the geom {name!r}"))
    mesh = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
    faces = model.mesh_face[int(model.mesh_faceadr[mesh]) :][: int(model.mesh_facenum[mesh])]
    mesh_data = model.mesh_vert[first : first + count], faces, model.geom_quat[geom], model.geom_pos[geom]
    parts = _convex_parts(*(part.tobytes() for part in mesh_data))
    if parts is None:
        raise RenderingError(NOT_OURS.format(what=f"the geom {name!r}, which is not flat,"))
    return parts


@lru_cache(maxsize=256)  # most resets compile a new model of the same few shapes
def _convex_parts(
    points: bytes, triangles: bytes, quaternion: bytes, position: bytes
) -> list[NDArray[np.float64]] | None:
    """The convex polygons of a mesh at the geom's pose, see `_parts`. None if it is not flat."""
    from magical_mj.rendering.scanlines import MAX_CORNERS

    turned = np.empty(9)
    mujoco.mju_quat2Mat(turned, np.frombuffer(quaternion))  # the compiler moves meshes to their centres and turns them
    vertices = np.frombuffer(points, np.float32).reshape(-1, 3) @ turned.reshape(3, 3).T + np.frombuffer(position)
    if np.ptp(vertices[:, 2]) > 1e-6:
        return None
    faces = np.frombuffer(triangles, np.int32).reshape(-1, 3).astype(np.int64)
    outlines = [vertices[loop, :2] for loop in loops(faces)]
    if all(len(outline) <= MAX_CORNERS and is_convex(outline) for outline in outlines):
        return outlines
    return [vertices[face, :2] for face in faces]
