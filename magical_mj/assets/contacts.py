"""How things touch: softness, friction and who meets whom. Fitted to roll-outs of the original simulation.

Contacts of flat shapes are reduced to what a 2-D engine knows: vertices (small spheres) against edges (capsules and
boxes) and discs (spheres). Of two geoms in contact the larger friction counts, so walls stand twice, once for the
fingers and once for everything else; that gives the products of coefficients that the original uses.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from magical_mj import constants as c
from magical_mj.assets import style
from magical_mj.assets.mjcf import comment, numbers

SUBSTEPS: Final = 10
"""Physics steps per action."""
TIMESTEP: Final = 1 / c.CONTROL_RATE / SUBSTEPS
"""Seconds per physics step."""

# Collision bits: two geoms meet if the contype of one has a bit of the other's conaffinity.
TOUCHES: Final = 1  # vertices and discs
FINGER_TOUCHES: Final = 2  # vertices of the fingers

# A foot cannot move vertically, so it presses on the floor with this force whatever happens: friction = cap / PRESS.
PRESS: Final = 1e4
FOOT_RADIUS, FOOT_DEPTH = 0.02, 0.01


@dataclass(frozen=True)
class PhysicsSettings:
    """What the original does not dictate: how stiff, how round, how soft. `research/fit_physics.py` finds them."""

    contact_impedance: float = 0.9973
    """Share of the relative velocity that a contact removes; below 1 it gives way a little."""
    contact_damping: float = 1.03
    """Approach speed removed per substep; 1 is all of it (inelastic)."""
    contact_stiffness: float = 1320.0
    """1/s^2: how fast overlap is pushed out; the original hardly does so below 0.01."""
    impratio: float = 0.0813
    """How stiff friction is against the normal direction; the original's gives way under load."""
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
    """The three for whatever a finger touches."""
    foot_impedance: float = 0.9999
    """Of what stands on the floor: the nearer to 1, the less it creeps below its force cap."""
    vertex_radius: float = 0.001
    """Of the sphere at a corner, world units."""
    edge_radius: float = 0.013
    """Of the capsule behind an edge, world units."""
    star_edge_radius: float = 0.015
    star_tip_radius: float = 0.00955
    """Blunt: a tip that starts inside a finger must leave on the star's side of it."""
    star_tip_depth: float = 0.002
    """World units by which a tip is shorter than drawn."""
    finger_overlap: float = 0.00351
    """Surfaces lie this far inside the drawn ones: the overlap that the original tolerates."""
    block_overlap: float = 0.0
    body_overlap: float = 0.00241
    """The same for blocks, and for the robot's body."""
    dry_impedance: float = 0.99
    """Of dry friction: turning, and the spin of blocks."""
    motor_impedance: float = 0.928
    """Of the dry friction between a finger and its motor."""
    limit_impedance: float = 0.9999
    limit_stiffness: float = 5000.0
    """Both of the fingers' joint limits."""
    finger_armature: float = 0.0142
    """Inertia that a finger's joint has besides the finger's."""
    sway_damping: float = 0.15
    """N m s: holds back fingers that move to the same side, as a block between them makes them do when the robot stops
    turning. Both motors push alike, so nothing else does, and without it the block swings up to twice too far."""
    loaded_share: float = 0.251
    """A closed gripper that drags a block slows the original's servos, though their caps are not reached. So this
    share of the drive, while the gripper is told to close, pulls towards a lower speed only; without load the larger
    share still reaches full speed."""
    loaded_turn_share: float = 0.224
    loaded_forward: float = 0.733
    loaded_backward: float = 0.446
    loaded_turn: float = 2.16
    """The lower speeds, in units/s and rad/s."""
    iterations: int = 20
    tolerance: float = 1e-8
    """Newton steps: as many as contacts need, which is about five in a heap."""


SETTINGS: Final = PhysicsSettings()


def softness(kind: str, stiffness: float, impedance: float, damping: float = 1.0) -> str:
    """`solref` and `solimp` that remove `damping` of a velocity in one substep; kind: "", "friction" or "limit"."""
    solref = numbers(-stiffness, -damping * impedance / TIMESTEP)
    return f'solref{kind}="{solref}" solimp{kind}="{numbers(impedance, impedance, 0.001)}"'


def foot(name: str) -> str:
    """A sphere that stands on the floor; `floor_pair` says how."""
    return f'<geom name="{name}" class="foot"/>'


def floor_pair(name: str, friction_force: float, mass: float, settings: PhysicsSettings = SETTINGS) -> str:
    """Lets a foot press on the floor with `PRESS` and so resist sliding with at most `friction_force`.

    Its friction is that of a disc, the same in all directions. A pair that is named costs no search for what the foot
    might touch. `mass` is what it carries: MuJoCo's inverse mass of a body is the mean of three directions, and
    vertically this one cannot move.
    """
    stiffness = PRESS * (1 - settings.foot_impedance) * 2 / 3 / mass / FOOT_DEPTH
    soft = softness("", stiffness, settings.foot_impedance)
    friction = numbers(friction_force / PRESS, friction_force / PRESS)
    return f'<pair name="{name}" geom1="floor" geom2="{name}" condim="3" friction="{friction}" {soft}/>'


def vertex(x: float, y: float, radius: float, kind: str = "vertex") -> str:
    """A small sphere that touches edges, discs and walls."""
    return f'<geom class="{kind}" size="{numbers(radius)}" pos="{numbers(x, y, 0)}"/>'


def geom_classes(settings: PhysicsSettings = SETTINGS) -> str:
    """The defaults of all geoms."""
    soft = softness("", settings.contact_stiffness, settings.contact_impedance, settings.contact_damping)
    finger = softness("", settings.finger_stiffness, settings.finger_impedance, settings.finger_damping)
    sphere, ground = 'type="sphere"', f'group="{style.SOLID_GROUP}" rgba="{style.rgba(style.LIGHT_GREY)}"'
    meets_all = TOUCHES | FINGER_TOUCHES

    def kind(name: str, what: str, friction: float, contype: int, conaffinity: int, more: str = "") -> str:
        return (
            f'{comment(what)}<default class="{name}"><geom friction="{numbers(friction)}" contype="{contype}" '
            f'conaffinity="{conaffinity}" mass="0" {more}/></default>'
        )

    return (
        f'<geom condim="3" group="{style.COLLISION_GROUP}" {soft}/>'
        + kind("visual", "flat polygons, only drawn", 0, 0, 0, f'type="mesh" group="{style.DRAWN_GROUP}"')
        + kind("solid", "what stands under them, only drawn", 0, 0, 0, f'group="{style.SOLID_GROUP}"')
        + kind("floor", "the ground: feet press on it, by named pairs", 0, 0, 0, ground)
        + kind(
            "disc",
            "round things: meet corners, edges and each other",
            settings.friction_block,
            TOUCHES,
            meets_all,
            sphere,
        )
        + kind("vertex", "a block's corners: meet edges, discs and walls", settings.friction_block, TOUCHES, 0, sphere)
        + kind("edge", "a block's edges: meet corners and discs", settings.friction_block, 0, meets_all)
        + kind(
            "finger_vertex",
            "a finger's corners",
            settings.friction_finger_block,
            FINGER_TOUCHES,
            0,
            f'{sphere} priority="1" {finger}',
        )
        + kind("finger_edge", "a finger's edges", settings.friction_finger_block, 0, TOUCHES, f'priority="1" {finger}')
        + kind("wall", "walls for all but fingers", settings.friction_wall, 0, TOUCHES)
        + kind(
            "finger_wall",
            "walls for fingers",
            settings.friction_finger_wall,
            0,
            FINGER_TOUCHES,
            f'priority="2" {finger}',
        )
        + kind("foot", "feet of blocks, and the robot's wheels", 0, 0, 0, f'{sphere} size="{FOOT_RADIUS}"')
    )
