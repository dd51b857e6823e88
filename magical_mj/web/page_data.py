"""The page's data as JSON: the tasks, the drawing style, and the scenes of each environment."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from inspect import cleandoc
from pathlib import Path
from textwrap import dedent
from types import MappingProxyType
from typing import Any, Final, Literal

import mujoco
import numpy as np

from magical_mj import demos
from magical_mj.assets import style
from magical_mj.assets.meshes import loops
from magical_mj.assets.robot import SIGN
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.engine.export import mjcf_text
from magical_mj.intents.names import EIGHT
from magical_mj.policies.interface import letters_of
from magical_mj.protocol import PROTOCOL
from magical_mj.rendering.picture import drawn
from magical_mj.scene import Block, GoalRegion, Pebble, Robot, Scene, geometry
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import BODIES, GRIPPER, Body, body_named
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.tasks import KNOWN, SPECS
from magical_mj.tasks.registry import Pair, sample_scene, task_spec
from magical_mj.web.pursued import demonstrated_data

Simulation = Literal["browser", "server"]

PAGE: Final = Path(__file__).parent / "page"
"""The folder of the page's files. When they are served, they need `catalogue.json` and `scenes/` next to them."""
EXPERT: Final = Path(__file__).parent / "expert.json"
"""Task-Variant -> an expert's actions in seeds 0, 1, ..., as letters. Written by ``tools/experts.py``."""
SCENES: Final = 20
"""The number of scenes that the page offers for each environment. Demo has only one."""
DEMONSTRATIONS: Final = 5
"""The number of a task's shipped demonstrations that the page can show."""
DECIMALS: Final = 6
HINTS: Final = {
    "MoveToCorner": "All points close to the corner, fewer towards the centre, none beyond it.",
    "MoveToRegion": "Only your own position counts, so stop inside.",
    "MatchRegions": "Each missing block costs points, and each wrong one.",
    "MakeLine": "Colours and shapes do not matter. If one block is out of line, half the points.",
    "FindDupe": "Same shape and same colour. Leave the block that is already there, and keep all others out.",
    "FixColour": "Each region starts with one block in it. All other blocks have to stay where they are.",
    "ClusterColour": "Blocks of one colour close together, away from other colours. Shapes do not matter.",
    "ClusterShape": "Blocks of one shape close together, away from other shapes. Colours do not matter.",
    "SweepToTop": "The debris is light: push it gently, and completely into the zone.",
}
"""Task -> advice for players about its score."""
ROBOT: Final = ("left_finger", "right_finger", "face")
"""The parts of the robot's drawing."""


def sections(task: str) -> dict[str, str]:
    """The sections of the docstring of a task's module, such as "Goal" and "Score". The first line is "Summary"."""
    text = sys.modules[task_spec(task).score.__module__].__doc__ or ""
    first, *lines = cleandoc(text).splitlines()
    parts: dict[str, list[str]] = {"Summary": [first.partition(": ")[2]]}
    heading = "Summary"
    for line in lines:
        if line and not line[0].isspace():
            heading = line
            parts[heading] = []
        else:
            parts[heading].append(line)
    return {name: dedent("\n".join(content)).strip() for name, content in parts.items()}


def catalogue(
    environments: Sequence[Pair],
    simulation: Simulation,
    shifts: Mapping[Pair, Mapping[str, Sequence[str]]] = MappingProxyType({}),
    puzzles: Sequence[Pair] = (),
) -> dict[str, Any]:
    """The data that the page needs before the first scene, as JSON data.

    Args:
        environments: the pairs (task, variant) that can be chosen.
        simulation: the simulation's location. In the browser, only the scenes of a few seeds are available.
        shifts: environment -> axis -> the strengths that can be chosen, or the names of bodies.
        puzzles: the environments of puzzles, with their names on the page.
    """
    return {
        "protocol": PROTOCOL,
        "simulation": simulation,
        "look": drawing_style(),
        "solids": solid_shapes(),
        "tasks": {
            task: {
                "summary": task_spec(task).summary,
                "hint": HINTS[task],
                "speeds": task_spec(task).speeds,
                "solved": scene_data(demos.load(task)[0].ends()[1]),
            }
            for task in dict.fromkeys(task for task, _ in environments)
        },
        "environments": [
            {"task": task, "variant": variant, "shifts": shifts.get((task, variant), {})}
            for task, variant in environments
        ],
        "demonstrated": {task: demonstrated_data(task) for task in dict(environments) if task in EIGHT},
        "puzzles": [{"task": name, "variant": variant, "shifts": {}} for name, variant in puzzles],
    }


def scene_data(scene: Scene) -> dict[str, Any]:
    """A scene as JSON data."""
    return json.loads(scene.to_json())


def environment_scenes(task: str, variant: str) -> dict[str, Any]:
    """The page's data of an environment as JSON data: its first scenes, or Demo's only one."""
    shipped = demos.load(task)[:DEMONSTRATIONS] if variant == "Demo" else []
    demonstrations = [letters_of(demo.actions) for demo in shipped]
    expert: list[str] = demonstrations[:1] or json.loads(EXPERT.read_text(encoding="utf-8"))[f"{task}-{variant}"]
    seeds = range(1 if variant == "Demo" else SCENES)
    return {
        "horizon": task_spec(task).horizon("paper"),
        "demonstrations": demonstrations,
        "scenes": [
            {"seed": seed, "expert": actions, "scene": scene_data(sample_scene(task, variant, seed))}
            for seed, actions in zip(seeds, expert, strict=True)
        ],
    }


def drawing_style() -> dict[str, Any]:
    """The drawing style of all scenes, as JSON data.

    Outlines are lists of closed loops, each a flat list x, y, x, y, ... in world units, in the frame of their part:
    the arena, a block, the robot or one of its fingers. Parts and their layers are listed in drawing order.
    """
    blocks = tuple(Block(shape, "red", 0.5 * index, 0.5, 0.0) for index, shape in enumerate(SHAPES))
    layers = _layers(Scene(Robot(0.0, -0.5, 0.0), blocks, pebbles=(Pebble(0.0, 0.0),)))
    halves = dict.fromkeys(spec.demo.half_width for spec in KNOWN.values())
    arenas = {half: _layers(Scene(Robot(0.0, 0.0, 0.0), half_width=half)) for half in halves}
    robots = {body: _layers(Scene(Robot(0.0, 0.0, 0.0, body=body))) for body in BODIES}
    return {
        "visible": c.VISIBLE_SIZE,
        "anchor": c.EGO_ANCHOR,
        "paper": css(style.WHITE),
        "arenas": {
            f"{half:g}": [layer for layer in parts if layer["part"] == "world"] for half, parts in arenas.items()
        },
        "regions": {
            "fill": _palette(style.REGION_FILL),
            "border": _palette(style.REGION_BORDER),
            "line": style.REGION_BORDER_WIDTH,
            "dash": style.DASH_LENGTH,
            "heights": [style.Z_REGION, style.REGION_STEP, style.BORDER_ABOVE_FILL],
        },
        "blocks": {
            shape: [layer["loops"] for layer in layers if layer["part"] == f"block{index}"]
            for index, shape in enumerate(SHAPES)
        },
        "blockColours": [_palette(style.BLOCK_OUTLINE), _palette(style.BLOCK_FILL)],
        "pebble": [layer for layer in layers if layer["part"] == "pebble0"],
        "robots": {body: [layer for layer in parts if layer["part"] in ROBOT] for body, parts in robots.items()},
        "fingerRoots": {f"{side}_finger": [sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1]] for side, sign in SIGN.items()},
    }


def solid_shapes() -> dict[str, Any]:
    """The data that `check_scene` uses, as JSON data: the outlines of solid objects, and the limits of legal scenes.

    A part is an outline (x, y of each corner, counter-clockwise, in the object's frame) enlarged by a radius.
    """

    def part(outline: Any, radius: float = 0.0) -> dict[str, Any]:
        return {"outline": np.asarray(outline).tolist(), "radius": radius}

    def robot(body: Body) -> dict[str, Any]:
        return {"part": part(body.corners) if body.outline else part([[0, 0]], body.radius), "fingers": body.fingers}

    margins = {"square": c.SQUARE_MARGIN}
    right = geometry.finger_outlines()
    left = [geometry.mirrored(outline) for outline in right]
    return {
        "blocks": {
            shape: part([[0, 0]], c.BLOCK_SIZE)
            if shape == "circle"
            else part(geometry.block_outline(shape), margins.get(shape, 0.0))
            for shape in SHAPES
        },
        "robots": {name: robot(body_named(name)) for name in BODIES},
        "fingers": [[outline.tolist() for outline in finger] for finger in (left, right)],
        "roots": [[sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1]] for sign in SIGN.values()],
        "pebble": part([[0, 0]], c.PEBBLE_RADIUS),
        "overlap": geometry.OVERLAP_TOLERANCE,
        "overhang": geometry.OVERHANG,
        "angle": geometry.MAX_ANGLE,
        "open": c.FINGER_OPEN,
        "slack": geometry.FINGER_SLACK,
    }


def sample_models() -> dict[str, str]:
    """Models with an object of each kind, by "BODY-HALF_WIDTH". The page takes the parts of other models from them."""
    others = [spec.demo for name, spec in KNOWN.items() if name not in SPECS]
    own = [(body, demo.half_width, demo.blocks[0].mass) for demo in others for body in BODIES]
    models = {}
    for body, half, mass in [(GRIPPER, c.ARENA_HALF_WIDTH, c.BLOCK_MASS), *own]:
        pairs = enumerate(zip(SHAPES, COLOURS, strict=True))
        blocks = [Block(shape, colour, 0.4 * index - 0.6, 0.5, 0.0, mass) for index, (shape, colour) in pairs]
        regions = [GoalRegion(colour, -0.5, -0.5, 0.0, 0.0) for colour in COLOURS]
        robot = Robot(0.0, -0.5, 0.0, body=body)
        sample = Scene(robot, tuple(blocks), tuple(regions), half_width=half, pebbles=(Pebble(0.8, 0.0),))
        models[f"{body}-{half:g}"] = mjcf_text(sample, rounded=False)
    return models


def _layers(scene: Scene) -> list[dict[str, Any]]:
    """The layers of a scene in drawing order, except goal regions."""
    model = mujoco.MjModel.from_xml_string(scene_mjcf(scene))
    is_drawn = drawn(model.geom_group) & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH)
    return [_layer(model, geom) for geom in is_drawn.nonzero()[0].tolist()]


def css(rgb: style.Rgb) -> str:
    """A colour in the form of style sheets."""
    return "#{:02x}{:02x}{:02x}".format(*rgb)


def _palette(palette: style.Palette) -> dict[str, str]:
    return {colour: css(palette[colour]) for colour in COLOURS}


def _layer(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    """A geom's body, colour and outline."""
    mesh = model.mesh(model.geom_dataid[geom])
    first, count = mesh.vertadr[0], mesh.vertnum[0]
    turned = np.empty(9)
    # The compiler moves meshes to their centre of mass and turns them.
    mujoco.mju_quat2Mat(turned, model.geom_quat[geom])
    vertices = model.mesh_vert[first : first + count] @ turned.reshape(3, 3).T + model.geom_pos[geom]
    faces = model.mesh_face[mesh.faceadr[0] : mesh.faceadr[0] + mesh.facenum[0]]
    red, green, blue = (round(255 * float(level)) for level in model.geom_rgba[geom, :3])
    return {
        "part": model.body(model.geom_bodyid[geom]).name,
        "colour": css((red, green, blue)),
        "loops": [np.round(vertices[loop, :2], DECIMALS).ravel().tolist() for loop in loops(faces)],
    }
