"""Contacts: softness, friction and collision filters, fitted to roll-outs of the original simulation.

Contacts of flat shapes are reduced to those of a 2-D engine: vertices (small spheres) against edges (capsules and
boxes) and discs (spheres). MuJoCo uses the larger friction coefficient of two geoms, the original the product. So there
are two sets of walls, one for the fingers and one for everything else, with the coefficients that give these products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.mjcf import comment, numbers
from magical_mj.scene import constants as c

Floats = TypeVar("Floats", float, NDArray[np.float64])
"""A number, or one for each of several worlds."""

SUBSTEPS: Final = 10
"""Physics steps per action."""
TIMESTEP: Final = 1 / c.CONTROL_RATE / SUBSTEPS
"""Seconds per physics step."""

DEBRIS_MASS: Final = 0.05
"""Blocks below this mass overlap with what they touch; those of x-magical have 0.01."""

# Collision bits: two geoms collide if the contype of one shares a bit with the conaffinity of the other.
TOUCHES: Final = 1  # vertices and discs
FINGER_TOUCHES: Final = 2  # vertices of the fingers

# A foot cannot move vertically, so it always presses on the floor with this force; friction coefficient = cap / PRESS.
PRESS: Final = 1e4
FOOT_RADIUS, FOOT_DEPTH = 0.02, 0.01


@dataclass(frozen=True)
class PhysicsSettings:
    """Stiffness, rounding, softness: fitted by `tools/research/fit_physics.py`, as the original does not state them."""

    contact_impedance: float = 0.9973
    """Share of the relative velocity that a contact removes; below 1 it gives way a little."""
    contact_damping: float = 1.03
    """Approach speed removed per substep; 1 is all of it (inelastic)."""
    contact_stiffness: float = 1320.0
    """1/s^2: how strongly overlap is corrected; the original hardly corrects overlaps below 0.01."""
    impratio: float = 0.0813
    """Stiffness of friction relative to the normal direction; the original's friction yields under load."""
    friction_finger_block: float = 1.34
    """2.5 in the original."""
    friction_finger_wall: float = 4.0
    friction_block: float = 0.19
    """Block with block, and block with robot; 0.25 in the original."""
    friction_wall: float = 0.4
    """Block or robot with wall."""
    finger_impedance: float = 0.9939
    finger_damping: float = 1.16
    finger_stiffness: float = 1740.0
    """The same three for contacts of fingers."""
    foot_impedance: float = 0.9999
    """For contacts with the floor: the closer to 1, the less things creep below their force cap."""
    vertex_radius: float = 0.001
    """Of the sphere at a corner, world units."""
    edge_radius: float = 0.013
    """Of the capsule behind an edge, world units."""
    star_edge_radius: float = 0.015
    star_tip_radius: float = 0.00955
    """Blunt, so that a tip that starts inside a finger is pushed out on the star's side."""
    star_tip_depth: float = 0.002
    """World units by which a colliding tip is shorter than the drawn one."""
    finger_overlap: float = 0.00351
    """Distance of collision surfaces inside the drawn ones: the overlap that the original tolerates."""
    block_overlap: float = 0.0
    body_overlap: float = 0.00241
    """The same for blocks, and for the robot's body."""
    debris_overlap: float = 0.0095
    """The same for blocks lighter than `DEBRIS_MASS`, which the original pushes into things as far as it tolerates."""
    dry_impedance: float = 0.99
    """For dry friction of the robot's turning and of the blocks' rotation."""
    motor_impedance: float = 0.928
    """For the dry friction between a finger and its motor."""
    limit_impedance: float = 0.9999
    limit_stiffness: float = 5000.0
    """Both of the fingers' joint limits."""
    finger_armature: float = 0.0142
    """Additional inertia (armature) of a finger's joint."""
    sway_damping: float = 0.15
    """N m s: damps fingers that swing to the same side, which a block between them causes when the robot stops turning.
    Since both motors push equally, nothing else damps this, and the block would swing up to twice too far."""
    loaded_share: float = 0.251
    """A closed gripper that drags a block slows the original's servos, although their caps are not reached. Therefore,
    while the gripper is commanded to close, this share of the drive targets a lower speed; without load, the larger
    share still reaches full speed."""
    loaded_turn_share: float = 0.224
    loaded_forward: float = 0.733
    loaded_backward: float = 0.446
    loaded_turn: float = 2.16
    """The lower speeds, in units/s and rad/s."""
    iterations: int = 20
    tolerance: float = 1e-8
    """The limits of the Newton solver; a pile of blocks needs about five iterations."""


SETTINGS: Final = PhysicsSettings()


def softness(kind: str, stiffness: float, impedance: float, damping: float = 1.0) -> str:
    """`solref` and `solimp` that remove `damping` of a velocity in one substep; kind: "", "friction" or "limit"."""
    solref = numbers(-stiffness, -damping * impedance / TIMESTEP)
    return f'solref{kind}="{solref}" solimp{kind}="{numbers(impedance, impedance, 0.001)}"'


def foot(name: str) -> str:
    """A sphere that stands on the floor; its contact is defined by `floor_pair`."""
    return f'<geom name="{name}" class="foot"/>'


def foot_friction(force: Floats) -> Floats:
    """The friction coefficient of a foot that resists with at most this force; of arrays, too."""
    return force / PRESS


def floor_pair(name: str, friction_force: float, mass: float, settings: PhysicsSettings) -> str:
    """The contact of a foot with the floor: it presses with `PRESS`, so friction resists with at most `friction_force`.

    Friction is the same in all directions. An explicit pair saves the search for contacts of the foot. `mass` is the
    mass of the body; MuJoCo's inverse mass of a body is a mean over three directions, of which this body can move in
    two.
    """
    stiffness = PRESS * (1 - settings.foot_impedance) * 2 / 3 / mass / FOOT_DEPTH
    soft = softness("", stiffness, settings.foot_impedance)
    friction = numbers(*[foot_friction(friction_force)] * 2)
    return f'<pair name="{name}" geom1="floor" geom2="{name}" condim="3" friction="{friction}" {soft}/>'


def vertex(x: float, y: float, radius: float, kind: str = "vertex") -> str:
    """A small sphere that collides with edges, discs and walls."""
    return f'<geom class="{kind}" size="{numbers(radius)}" pos="{numbers(x, y, 0)}"/>'


def geom_classes(settings: PhysicsSettings = SETTINGS) -> str:
    """The defaults of all geoms, and a class of geoms for each purpose."""
    soft = softness("", settings.contact_stiffness, settings.contact_impedance, settings.contact_damping)
    finger = softness("", settings.finger_stiffness, settings.finger_impedance, settings.finger_damping)
    meets_all = TOUCHES | FINGER_TOUCHES
    classes = (
        comment("flat polygons, only drawn"),
        _geom_class("visual", type="mesh", group=style.DRAWN_GROUP),
        comment("what stands under them, only drawn"),
        _geom_class("solid", group=style.SOLID_GROUP),
        comment("the ground: feet press on it, by named pairs"),
        _geom_class("floor", group=style.SOLID_GROUP, rgba=style.rgba(style.LIGHT_GREY)),
        comment("round things: meet corners, edges and each other"),
        _geom_class("disc", friction=settings.friction_block, contype=TOUCHES, conaffinity=meets_all, type="sphere"),
        comment("a block's corners: meet edges, discs and walls"),
        _geom_class("vertex", friction=settings.friction_block, contype=TOUCHES, type="sphere"),
        comment("a block's edges: meet corners and discs"),
        _geom_class("edge", friction=settings.friction_block, conaffinity=meets_all),
        comment("a finger's corners"),
        _geom_class(
            "finger_vertex",
            finger,
            friction=settings.friction_finger_block,
            contype=FINGER_TOUCHES,
            type="sphere",
            priority=1,
        ),
        comment("a finger's edges"),
        _geom_class("finger_edge", finger, friction=settings.friction_finger_block, conaffinity=TOUCHES, priority=1),
        comment("walls for all but fingers"),
        _geom_class("wall", friction=settings.friction_wall, conaffinity=TOUCHES),
        comment("walls for fingers"),
        _geom_class(
            "finger_wall", finger, friction=settings.friction_finger_wall, conaffinity=FINGER_TOUCHES, priority=2
        ),
        comment("feet of blocks, and the robot's wheels"),
        _geom_class("foot", type="sphere", size=FOOT_RADIUS),
    )
    return f'<geom condim="3" group="{style.COLLISION_GROUP}" {soft}/>' + "".join(classes)


def _geom_class(name: str, softness: str = "", **attributes: float | str) -> str:
    """A class of geoms, which have no mass and, but for these attributes, touch nothing."""
    values: dict[str, float | str] = {"friction": 0, "contype": 0, "conaffinity": 0, "mass": 0}
    text = " ".join(
        f'{attribute}="{value if isinstance(value, str) else numbers(value)}"'
        for attribute, value in (values | attributes).items()
    )
    return f'<default class="{name}"><geom {text} {softness}/></default>'
