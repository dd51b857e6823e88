"""The shapes that the page draws: outlines and colours of everything, from a compiled model, in drawing order."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np

from magical_mj.assets import style
from magical_mj.assets.meshes import loops
from magical_mj.assets.robot import SIGN
from magical_mj.assets.world import world_mjcf
from magical_mj.rendering.canvas import drawn
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.constants import COLOURS, SHAPES

DECIMALS = 6


def look() -> dict[str, Any]:
    """How to draw any scene, as JSON data.

    Outlines are lists of closed loops, each a flat list x, y, x, y, ... in world units, in the frame of their part:
    the world, a block, the robot or one of its fingers. Parts and their layers are listed in drawing order.
    """
    blocks = tuple(Block(shape, "red", 0.5 * index, 0.5, 0.0) for index, shape in enumerate(SHAPES))
    model = mujoco.MjModel.from_xml_string(world_mjcf(Scene(Robot(0.0, -0.5, 0.0), blocks)))
    shown = drawn(model.geom_group) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    layers = [_layer(model, geom) for geom in shown.nonzero()[0].tolist()]
    return {
        "visible": c.VISIBLE_SIZE,
        "anchor": c.EGO_ANCHOR,
        "paper": css(style.WHITE),
        "arena": [layer for layer in layers if layer["part"] == "world"],
        "regions": {
            "fill": _palette(style.REGION_FILL),
            "border": _palette(style.REGION_BORDER),
            "line": style.REGION_BORDER_WIDTH,
            "dash": style.DASH_LENGTH,
        },
        "blocks": {
            shape: [layer["loops"] for layer in layers if layer["part"] == f"block{index}"]
            for index, shape in enumerate(SHAPES)
        },
        "blockColours": [_palette(style.BLOCK_OUTLINE), _palette(style.BLOCK_FILL)],
        "robot": [layer for layer in layers if layer["part"] in ("left_finger", "right_finger", "face")],
        "fingerRoots": {f"{side}_finger": [sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1]] for side, sign in SIGN.items()},
    }


def css(rgb: style.Rgb) -> str:
    """A colour as style sheets write it."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _palette(palette: style.Palette) -> dict[str, str]:
    return {colour: css(palette[colour]) for colour in COLOURS}


def _layer(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    """A geom's body, colour and outline."""
    mesh = model.mesh(model.geom_dataid[geom])
    first, count = mesh.vertadr[0], mesh.vertnum[0]
    turned = np.empty(9)
    # the compiler moves meshes to their centre of mass and turns them
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    vertices = model.mesh_vert[first : first + count] @ turned.reshape(3, 3).T + model.geom_pos[geom]
    faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
    red, green, blue = (round(255 * float(level)) for level in model.geom_rgba[geom, :3])
    return {
        "part": model.body(model.geom_bodyid[geom]).name,
        "colour": css((red, green, blue)),
        "loops": [np.round(vertices[loop, :2], DECIMALS).ravel().tolist() for loop in loops(faces)],
    }
