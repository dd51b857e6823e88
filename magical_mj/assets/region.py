"""Goal regions: drawn, without collisions. Each consists of two flat skins: its fill and its border.

Regions change their size between episodes. A mesh would have to be uploaded again to the drawing context, which
environments share. The vertices of a skin are uploaded with every frame, so changing them in the model is enough.
"""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.meshes import Faces, mesh_mjcf
from magical_mj.assets.mjcf import numbers, single
from magical_mj.assets.style import DASH_LENGTH, REGION_BORDER, REGION_BORDER_WIDTH, REGION_FILL, rgba
from magical_mj.scene import GoalRegion

BONE = "regions"
"""The static body at the origin of the world frame. The vertices of all regions' skins are bound to it."""

DASHES = 42
"""The minimum number of quads for the border of a region: enough for 0.8 x 0.8 world units."""

_AHEAD: Final = np.array([[1.0, 0], [0, -1], [-1, 0], [0, 1]])
"""Unit vectors along the top, right, bottom and left side, clockwise."""
_OUTWARD: Final = REGION_BORDER_WIDTH / 2 * np.array([[0, 1.0], [1, 0], [0, -1], [-1, 0]])
"""Vectors from the centre line of each side's border to its outer edge."""
_ACROSS: Final = np.stack([-_OUTWARD, -_OUTWARD, _OUTWARD, _OUTWARD], axis=1)


@lru_cache(16)
def dash_quads(region: GoalRegion) -> NDArray[np.float64]:
    """The dashes of a region's border, clockwise from its top left corner. A solid border has one for each side.

    Returns:
        Shape (n, 4, 2): the corners of each dash, counter-clockwise; a dash around a corner is two quads.
    """
    x0, y0, x1, y1 = region.box
    corners = np.array([[x0, y1], [x1, y1], [x1, y0], [x0, y0]])
    length = np.array([x1 - x0, y1 - y0, x1 - x0, y1 - y0])
    end_of_side = length.cumsum()
    start_of_side = end_of_side - length
    start = 2 * DASH_LENGTH * np.arange(np.ceil(end_of_side[-1] / (2 * DASH_LENGTH)))[:, None]  # along the border
    end = start + DASH_LENGTH
    if region.border == "solid":
        start, end = np.full((1, 1), -1.0), end_of_side[-1:, None]  # starts before the corner, to get a mitre joint
    first, last = np.maximum(start, start_of_side), np.minimum(end, end_of_side)  # each dash's part on each side
    dash, side = (last > first).nonzero()
    first, last = first[dash, side], last[dash, side]
    start_of_side, end_of_side = start_of_side[side], end_of_side[side]
    half = REGION_BORDER_WIDTH / 2
    first -= half * (start[dash, 0] < start_of_side)  # a dash around a corner gets a mitre joint
    last += half * ((end[dash, 0] > end_of_side) & (side < 3))
    along = np.stack([first, last, last, first], axis=1) - start_of_side[:, None]
    quads = corners[side, None] + along[..., None] * _AHEAD[side, None] + _ACROSS[side]
    quads.setflags(write=False)
    return quads


def dash_count(region: GoalRegion) -> int:
    """The number of quads for the region's border in a model."""
    return max(DASHES, len(dash_quads(region)))


def regions_mjcf(regions: tuple[GoalRegion, ...]) -> str:
    """The skins of all regions."""
    text = ""
    for index, region in enumerate(regions):
        for name, palette, count in (("fill", REGION_FILL, 1), ("border", REGION_BORDER, dash_count(region))):
            corners = single(region_corners(region, index, count).ravel().tolist())
            text += _skin(f"region{index}_{name}", palette[region.colour], corners, count)
    return text


def region_mjcf(index: int, region: GoalRegion) -> tuple[str, str, str]:
    """A region of geoms instead of skins, as MJCF: the mesh of its border, the geom of its fill, that of its border."""
    name, (x, y), z = f"region{index}_{region.colour}", region.centre, style.Z_REGION + index * style.REGION_STEP
    box = f'pos="{numbers(x, y, z)}" size="{numbers(region.width / 2, region.height / 2, 1)}"'
    fill = f'<geom name="{name}_fill" class="visual" type="plane" {box} rgba="{rgba(REGION_FILL[region.colour])}"/>'
    count, mesh = len(dash_quads(region)), f"region{index}_border"
    border = style.visual_geom(f"{name}_border", mesh, REGION_BORDER[region.colour])
    corners = region_corners(region, index, count).astype(np.float64)
    return mesh_mjcf(mesh, (corners, _quad_faces(count))), fill, border


def blank_regions_mjcf(dashes: tuple[int, ...]) -> str:
    """The skins of regions with these numbers of quads; `SceneModel.rewrite` writes vertices and colours later."""
    parts = ((index, *part) for index, count in enumerate(dashes) for part in (("fill", 1), ("border", count)))
    return "".join(
        _skin(f"region{index}_{name}", style.WHITE, "0 " * 12 * count, count) for index, name, count in parts
    )


def _skin(name: str, rgb: style.Rgb, corners: str, count: int) -> str:
    """A flat skin of `count` quads."""
    look = f'rgba="{rgba(rgb)}" group="{style.DRAWN_GROUP}"'
    return f'<skin name="{name}" {look} vertex="{corners}" {_connection(count)}</skin>'


@lru_cache(16)
def region_corners(region: GoalRegion, index: int, count: int) -> NDArray[np.float32]:
    """Corners of the fill (`count` 1) or of the border. Unused quads collapse into one point. Shape (4 * count, 3)."""
    z = style.Z_REGION + index * style.REGION_STEP
    if count == 1:
        x0, y0, x1, y1 = region.box
        flat = np.array([[x1, y1], [x0, y1], [x0, y0], [x1, y0]])
    else:
        flat = dash_quads(region).reshape(-1, 2)
        z += style.BORDER_ABOVE_FILL
    corners = np.empty((4 * count, 3), np.float32)
    corners[: len(flat), :2], corners[len(flat) :, :2], corners[:, 2] = flat, flat[-1], z
    corners.setflags(write=False)
    return corners


@cache
def _connection(count: int) -> str:
    """The attribute `face` and the bone of a skin with `count` quads, as MJCF."""
    faces, ids = " ".join(map(str, _quad_faces(count).ravel())), " ".join(map(str, range(4 * count)))
    bone = f'<bone body="{BONE}" bindpos="0 0 0" bindquat="1 0 0 0" vertid="{ids}" vertweight="{"1 " * 4 * count}"/>'
    return f'face="{faces}">{bone}'


def _quad_faces(count: int) -> Faces:
    """Two triangles for each quad; a quad has four successive corners. Shape (2 * count, 3)."""
    return (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(count)[:, None, None]).reshape(-1, 3)
