"""Contacts: softness, friction and collision filters, fitted to rollouts of the original simulation.

Flat shapes collide as in a 2-D engine: vertices (small spheres) against edges (capsules and boxes) and discs (spheres).
MuJoCo uses the larger of two friction coefficients, the original their product. So there are two sets of walls, one for
the fingers and one for everything else, with the coefficients that give these products.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from magical_mj.assets import style
from magical_mj.assets.mjcf import numbers
from magical_mj.scene import constants as c

Floats = TypeVar("Floats", float, NDArray[np.float64])
"""A number, or an array with a number for each environment of a batch."""

SUBSTEPS: Final = 10
"""Physics steps per action."""
TIMESTEP: Final = 1 / c.CONTROL_RATE / SUBSTEPS
"""Seconds per substep."""

DEBRIS_MASS: Final = 0.05
"""Blocks below this mass overlap with objects that they touch; those of x-magical have 0.01."""

# Collision bits: two geoms collide if the contype of one shares a bit with the conaffinity of the other.
TOUCHES: Final = 1  # vertices and discs
FINGER_TOUCHES: Final = 2  # vertices of the fingers

# A foot cannot move vertically, so it always presses on the floor with this force. Its friction is force cap / PRESS.
PRESS: Final = 1e4
FOOT_RADIUS, FOOT_DEPTH = 0.02, 0.01
ROTOR_INERTIA: Final = 40.0
"""The inertia of wheels, rotors and motors, so large that friction does not slow them."""
CLASS: Final = "magical_mj"
"""The default class that contains all others."""


@dataclass(frozen=True)
class PhysicsSettings:
    """Stiffness, rounding and softness. The original does not state them: `tools/research/fit_physics.py` fits them."""

    contact_impedance: float = 0.9973
    """Share of the relative velocity that a contact removes; below 1 it yields a little."""
    contact_damping: float = 1.03
    """Approach speed removed per substep; 1 is all of it (inelastic)."""
    contact_stiffness: float = 1320.0
    """1/s^2: how strongly an overlap is corrected. The original hardly corrects overlaps below 0.01."""
    impratio: float = 0.0813
    """Stiffness of friction relative to the normal direction; the original's friction yields under load."""
    friction_finger_block: float = 1.34
    """Friction of fingers with blocks; 2.5 in the original."""
    friction_finger_wall: float = 4.0
    friction_block: float = 0.19
    """Friction of blocks with blocks and with the robot; 0.25 in the original."""
    friction_wall: float = 0.4
    """Friction of blocks and the robot with walls."""
    finger_impedance: float = 0.9939
    finger_damping: float = 1.16
    finger_stiffness: float = 1740.0
    """Impedance, damping and stiffness of contacts of fingers."""
    foot_impedance: float = 0.9999
    """Impedance of contacts with the floor: the closer to 1, the less objects creep below their force cap."""
    vertex_radius: float = 0.001
    """Radius of the sphere at a corner, world units."""
    edge_radius: float = 0.013
    """Radius of the capsule behind an edge, world units."""
    star_edge_radius: float = 0.015
    star_tip_radius: float = 0.00955
    """Radius of a star's tip: blunt, so that a tip that starts inside a finger is pushed back towards the star."""
    star_tip_depth: float = 0.002
    """How much shorter the colliding tip is than the drawn one, world units."""
    finger_overlap: float = 0.00351
    """Distance between drawn and collision surface, world units: the overlap that the original tolerates."""
    block_overlap: float = 0.0
    body_overlap: float = 0.00241
    """Overlap of blocks and of the robot's body, like `finger_overlap`."""
    debris_overlap: float = 0.0095
    """Overlap of blocks lighter than `DEBRIS_MASS`. The original pushes them into objects as far as it tolerates."""
    dry_impedance: float = 0.99
    """Impedance of the dry friction of the turning servo and of the blocks' rotation."""
    motor_impedance: float = 0.928
    """Impedance of the dry friction between a finger and its motor."""
    limit_impedance: float = 0.9999
    limit_stiffness: float = 5000.0
    """Impedance and stiffness of the limits of the fingers' joints."""
    finger_armature: float = 0.0142
    """Additional inertia (armature) of a finger's joint."""
    sway_damping: float = 0.15
    """N m s: damps fingers that swing to the same side. A gripped block causes this when the robot stops turning. Both
    motors push equally, so nothing else damps the swing, and the block would swing up to twice as far."""
    loaded_share: float = 0.251
    """In the original, a closed gripper that drags a block slows the servos, although their caps are not reached.
    Therefore, while the gripper is commanded to close, this share of the drive has a lower target speed. Without a
    load, the larger share still reaches full speed."""
    loaded_turn_share: float = 0.224
    loaded_forward: float = 0.733
    loaded_backward: float = 0.446
    loaded_turn: float = 2.16
    """The lower target speeds, in units/s and rad/s."""
    iterations: int = 20
    tolerance: float = 1e-8
    """Limits of the Newton solver; a pile of blocks needs about five iterations."""


SETTINGS: Final = PhysicsSettings()


def softness(kind: str, stiffness: float, impedance: float, damping: float = 1.0) -> str:
    """Attributes that remove the share `damping` of a velocity per substep; kind: "", "friction" or "limit"."""
    solimp = numbers(impedance, impedance, 0.001)
    return f'solref{kind}="{_solref(stiffness, impedance, damping)}" solimp{kind}="{solimp}"'


def _solref(stiffness: float, impedance: float, damping: float = 1.0) -> str:
    return numbers(-stiffness, -damping * impedance / TIMESTEP)


def foot(name: str) -> str:
    """A sphere that touches the floor; `floor_pair` defines its contact."""
    return f'<geom name="{name}" class="foot"/>'


def floor_pair(name: str, friction_force: float, mass: float, settings: PhysicsSettings) -> str:
    """The contact of a foot with the floor: it presses with `PRESS`, so friction resists with at most `friction_force`.

    Friction is the same in all directions. An explicit pair saves MuJoCo the search for the foot's contacts. `mass` is
    the mass of the body.
    """
    friction = numbers(*[friction_force / PRESS] * 2)
    stiffness = _foot_stiffness(mass, settings)
    own = "" if mass == c.BLOCK_MASS else f'solref="{_solref(stiffness, settings.foot_impedance)}"'
    return f'<pair name="{name}" class="foot" geom1="floor" geom2="{name}" friction="{friction}" {own}/>'


def _foot_stiffness(mass: float, settings: PhysicsSettings) -> float:
    """The contact stiffness that makes a foot under this mass press with `PRESS`.

    MuJoCo takes a body's inverse mass as a mean over three directions. A planar body moves in two of them, hence 2/3.
    """
    return PRESS * (1 - settings.foot_impedance) * 2 / 3 / mass / FOOT_DEPTH


def vertex(name: str, x: float, y: float, radius: float, kind: str = "vertex") -> str:
    """A small sphere that collides with edges, discs and walls."""
    return f'<geom name="{name}" class="{kind}" size="{numbers(radius)}" pos="{numbers(x, y, 0)}"/>'


def default_classes(settings: PhysicsSettings = SETTINGS) -> str:
    """The default classes: one that contains all others, and in it one for each purpose.

    Elements that users add belong to none of them, so MuJoCo's own defaults apply.
    """
    soft = softness("", settings.contact_stiffness, settings.contact_impedance, settings.contact_damping)
    finger = softness("", settings.finger_stiffness, settings.finger_impedance, settings.finger_damping)
    limit = softness("limit", settings.limit_stiffness, settings.limit_impedance)
    foot_soft = softness("", _foot_stiffness(c.BLOCK_MASS, settings), settings.foot_impedance)
    dry, motor = (
        softness("friction", 1, impedance) for impedance in (settings.dry_impedance, settings.motor_impedance)
    )
    block, to_all = f'friction="{numbers(settings.friction_block)}"', TOUCHES | FINGER_TOUCHES
    gain = ROTOR_INERTIA / TIMESTEP
    servo = numbers(-gain)
    rolling = FOOT_RADIUS - FOOT_DEPTH / 2  # MuJoCo places a contact midway between the wheel's rim and the floor
    return f"""
<default class="{CLASS}">
  <geom group="{style.COLLISION_GROUP}" mass="0" contype="0" conaffinity="0" friction="0" {soft}/>
  <!-- visual: the flat polygons that the cameras ego and allo see -->
  <default class="visual"><geom type="mesh" group="{style.DRAWN_GROUP}"/></default>
  <!-- visual: the solids under these polygons -->
  <default class="solid"><geom group="{style.SOLID_GROUP}"/></default>
  <!-- the ground: feet touch it by named contact pairs -->
  <default class="floor"><geom group="{style.SOLID_GROUP}" rgba="{style.rgba(style.LIGHT_GREY)}"/></default>
  <!-- feet of blocks, and the robot's wheels -->
  <default class="foot">
    <geom type="sphere" size="{numbers(FOOT_RADIUS)}"/>
    <pair condim="3" {foot_soft}/>
  </default>
  <!-- round objects: collide with corners, edges and each other -->
  <default class="disc"><geom type="sphere" {block} contype="{TOUCHES}" conaffinity="{to_all}"/></default>
  <!-- a block's corners: collide with edges, discs and walls -->
  <default class="vertex"><geom type="sphere" {block} contype="{TOUCHES}"/></default>
  <!-- a block's edges: collide with corners and discs -->
  <default class="edge"><geom {block} conaffinity="{to_all}"/></default>
  <!-- walls for everything except fingers -->
  <default class="wall"><geom friction="{numbers(settings.friction_wall)}" conaffinity="{TOUCHES}"/></default>
  <!-- fingers -->
  <default class="finger">
    <geom priority="1" friction="{numbers(settings.friction_finger_block)}" {finger}/>
    <joint armature="{numbers(settings.finger_armature)}" {limit}/>
    <!-- a finger's corners -->
    <default class="finger_vertex"><geom type="sphere" contype="{FINGER_TOUCHES}"/></default>
    <!-- a finger's edges -->
    <default class="finger_edge"><geom conaffinity="{TOUCHES}"/></default>
    <!-- walls for fingers -->
    <default class="finger_wall">
      <geom priority="2" friction="{numbers(settings.friction_finger_wall)}" conaffinity="{FINGER_TOUCHES}"/>
    </default>
  </default>
  <!-- a block's rotation, slowed by dry friction -->
  <default class="spin"><joint {dry}/></default>
  <!-- heavy rotors, each with a speed servo that reaches its target in one step -->
  <default class="rotor">
    <joint armature="{numbers(ROTOR_INERTIA)}"/>
    <tendon {dry}/>
    <general dyntype="filterexact" dynprm="1e-9" gainprm="{servo}" biastype="affine" biasprm="0 0 {servo}"/>
    <!-- wheels, commanded by the speed of their rims -->
    <default class="wheel"><general gainprm="{numbers(gain * (1 / rolling))}"/></default>
    <!-- finger motors -->
    <default class="motor"><tendon {motor}/><general gainprm="{numbers(gain)}"/></default>
  </default>
</default>"""
