"""The robot: a disc that drives and turns, two hinged fingers, and the motors of all.

What stands for what of the original's 2-D engine:

- its velocity servo, a force of any direction with one cap that also brakes and stops side-slip: a driven wheel
  under the robot's centre, which grips the floor with a constant normal force, for Coulomb friction is a disc;
- its turning servo with a torque cap: dry friction between the ground and a heavy rotor that spins against the robot;
- its finger motors: a speed in proportion to the way to go, clipped; the joint's force range is the cap;
- its latency of one substep: each command passes through a filter of one substep, and the wheel hangs on a light
  castor that keeps the heading of the substep before.
"""

from __future__ import annotations

import math
from typing import Final, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj import constants as c
from magical_mj.actions import ACTIONS
from magical_mj.assets import style
from magical_mj.assets.arena import EGO_CAMERA
from magical_mj.assets.contacts import (
    FOOT_DEPTH,
    FOOT_RADIUS,
    PRESS,
    SETTINGS,
    TIMESTEP,
    Settings,
    foot,
    softness,
    vertex,
)
from magical_mj.assets.markup import bend_body, move_body, numbers, planar_body, quaternion
from magical_mj.scene import Dynamics, Robot

Side = Literal["left", "right"]
SIGN: Final[dict[Side, int]] = {"left": -1, "right": 1}
"""On which side of the body's x axis a finger is."""
FINGER_INERTIA: Final[dict[Side, float]] = {"left": 0.00500649436186835, "right": 0.004983019517209476}
"""About the root, where the mass sits; the original's two fingers differ a little."""
JOINTS: Final = ("robot_x", "robot_y", "robot_angle", "castor", "wheel", "rotor", "left_finger", "right_finger")
"""In the order of the model's coordinates."""

ROTOR_INERTIA: Final = 40.0  # of wheel and rotor: so heavy that friction cannot slow them
CASTOR_INERTIA: Final = 1e-5  # so light that nobody feels it
MOTOR_MASS: Final = 1e-6
FINGER_RATE: Final = 10.0  # 1/s: a finger's speed is this times the way to go, up to c.SPEED_FINGER


def robot_mjcf(robot: Robot, dynamics: Dynamics, settings: Settings = SETTINGS) -> str:
    """The body `robot` with its motors, fingers, face and the ego camera."""
    castor = f'armature="{numbers(CASTOR_INERTIA)}" stiffness="{numbers(CASTOR_INERTIA / TIMESTEP**2)}"'
    motor = f'<inertial pos="0 0 0" mass="{MOTOR_MASS}" diaginertia="1e-7 1e-7 1e-7"/>'
    content = (
        f'<inertial pos="0 0 0" mass="{c.ROBOT_MASS}" diaginertia="{numbers(*[c.ROBOT_INERTIA] * 3)}"/>'
        f'<geom name="robot" class="disc" size="{numbers(c.ROBOT_RADIUS - settings.body_overlap)}"/>{EGO_CAMERA}'
        f'<body name="wheel"><joint name="castor" type="hinge" axis="0 0 1" {castor}/>'
        f'<joint name="wheel" type="hinge" axis="-1 0 0" armature="{ROTOR_INERTIA}"/>{motor}'
        f"{foot('wheel', dynamics.drive_force, c.ROBOT_MASS + 2 * c.FINGER_MASS, settings)}</body>"
        f'<body name="rotor"><joint name="rotor" type="hinge" axis="0 0 1" armature="{ROTOR_INERTIA}"/>{motor}</body>'
        f"{_finger('left', robot.fingers[0], dynamics, settings)}"
        f"{_finger('right', robot.fingers[1], dynamics, settings)}"
        f'<body name="face">{_face()}</body>'
    )
    return planar_body("robot", robot.pose, content)


def _face() -> str:
    """Body and eyes, listed after the fingers: MuJoCo draws in this order, and the disc hides the fingers' roots."""
    return (
        style.visual_geom("robot_outline", style.DARK_GREY, style.Z_BODY)
        + style.visual_geom("robot_fill", style.GREY, style.Z_BODY + style.FILL_ABOVE_OUTLINE)
        + style.visual_geom("eyes", style.WHITE, style.Z_EYES)
        + style.visual_geom("pupils", style.BLACK, style.Z_PUPILS)
    )


def _finger(side: Side, angle: float, dynamics: Dynamics, settings: Settings) -> str:
    """The body `<side>_finger`: a box for each segment, and spheres at the three corners that stick out."""
    sign, name, inertia = SIGN[side], f"{side}_finger", FINGER_INERTIA[side]
    half, bend = c.FINGER_THICKNESS / 2, SIGN[side] * c.FINGER_BEND

    def forearm(inwards: float, onwards: float) -> tuple[float, float]:
        """A point of the forearm, from its hinge: the outer corner of the upper segment's tip."""
        cosine, sine = math.cos(bend), math.sin(bend)
        return (
            sign * half - cosine * sign * inwards - sine * onwards,
            c.FINGER_UPPER_LENGTH - sine * sign * inwards + cosine * onwards,
        )

    thin, rim = half - settings.finger_overlap, settings.vertex_radius + settings.finger_overlap
    length = c.FINGER_FOREARM_LENGTH
    corners = (forearm(rim, length - rim), forearm(c.FINGER_THICKNESS - rim, length - rim), forearm(rim, 0))
    low, high = sorted((0.0, -sign * c.FINGER_OPEN))
    return (
        f'<body name="{name}" pos="{numbers(sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1], 0)}" '
        f'quat="{numbers(*quaternion(angle))}">'
        f'<joint name="{name}" type="hinge" axis="0 0 1" ref="{numbers(angle)}" range="{numbers(low, high)}" '
        f'armature="{numbers(settings.finger_armature)}" '
        f'actuatorfrcrange="{numbers(-dynamics.finger_torque, dynamics.finger_torque)}" '
        f"{softness('limit', settings.limit_stiffness, settings.limit_impedance)}/>"
        f'<inertial pos="0 0 0" mass="{c.FINGER_MASS}" diaginertia="{numbers(inertia, inertia, inertia)}"/>'
        + style.visual_geom(f"{name}_outline", style.GREY, style.Z_FINGER)
        + style.visual_geom(f"{name}_fill", style.LIGHT_GREY, style.Z_FINGER + style.FILL_ABOVE_OUTLINE)
        + f'<geom class="finger_edge" type="box" size="{numbers(thin, c.FINGER_UPPER_LENGTH / 2, 0.1)}" '
        f'pos="0 {numbers(c.FINGER_UPPER_LENGTH / 2)} 0"/>'
        f'<geom class="finger_edge" type="box" size="{numbers(thin, length / 2 - settings.finger_overlap, 0.1)}" '
        f'pos="{numbers(*forearm(half, length / 2), 0)}" quat="{numbers(*quaternion(bend))}"/>'
        + "".join(vertex(*corner, settings.vertex_radius, "finger_vertex") for corner in corners)
        + "</body>"
    )


def tendons_mjcf(dynamics: Dynamics, settings: Settings = SETTINGS) -> str:
    """Dry friction between rotor and ground, the turning servo; drag that holds the castor's heading for a substep."""
    return (
        f'<fixed name="turn" frictionloss="{numbers(dynamics.turn_torque)}" '
        f"{softness('friction', 1, settings.dry_impedance)}>"
        '<joint joint="robot_angle" coef="1"/><joint joint="rotor" coef="1"/></fixed>'
        f'<fixed name="castor" damping="{numbers(CASTOR_INERTIA / TIMESTEP)}">'
        '<joint joint="robot_angle" coef="1"/><joint joint="castor" coef="1"/></fixed>'
    )


def actuators_mjcf(settings: Settings = SETTINGS) -> str:
    """Four commands: drive (units/s), turn (rad/s), left and right finger (0 open, 1 closed). Two dampers follow."""
    latency = 'dyntype="filterexact" dynprm="1e-9"'  # the command acts one substep after it was written
    gain = ROTOR_INERTIA / TIMESTEP  # reaches the commanded speed in one substep
    drive = gain / (FOOT_RADIUS - FOOT_DEPTH / 2)  # the contact is midway between the wheel's rim and the floor
    text = (
        f'<general name="drive" joint="wheel" {latency} gainprm="{numbers(drive)}" biastype="affine" '
        f'biasprm="0 0 {numbers(-gain)}"/>'
        f'<general name="turn" joint="rotor" {latency} gainprm="{numbers(-gain)}" biastype="affine" '
        f'biasprm="0 0 {numbers(-gain)}"/>'
    )
    # torque = strength * (clip(FINGER_RATE * (target - angle), +-SPEED_FINGER) - speed), then the joint's force range
    strength = {side: (settings.finger_armature + FINGER_INERTIA[side]) / TIMESTEP for side in SIGN}
    for side, sign in SIGN.items():
        opened, rate = -sign * c.FINGER_OPEN, FINGER_RATE * strength[side]
        cap = strength[side] * c.SPEED_FINGER
        text += (
            f'<general name="{side}_finger" joint="{side}_finger" {latency} gainprm="{numbers(-rate * opened)}" '
            f'biastype="affine" biasprm="{numbers(rate * opened, -rate, 0)}" forcerange="{numbers(-cap, cap)}"/>'
        )
    for side in SIGN:
        text += (
            f'<general name="{side}_finger_damper" joint="{side}_finger" gainprm="0" biastype="affine" '
            f'biasprm="0 0 {numbers(-strength[side])}"/>'
        )
    return text


def rewrite_robot(model: mujoco.MjModel, robot: Robot, dynamics: Dynamics) -> None:
    """Give the robot of a compiled model another pose and other force caps, as if compiled with them."""
    move_body(model, "robot", robot.pose)
    model.geom_friction[model.geom("wheel").id, 0] = dynamics.drive_force / PRESS
    model.tendon_frictionloss[model.tendon("turn").id] = dynamics.turn_torque
    for side, angle in zip(SIGN, robot.fingers, strict=True):
        bend_body(model, f"{side}_finger", angle)
        model.jnt_actfrcrange[model.joint(f"{side}_finger").id] = (-dynamics.finger_torque, dynamics.finger_torque)


_SPEED = (0.0, c.SPEED_FORWARD, -c.SPEED_BACKWARD)
_TURN = (0.0, c.SPEED_TURN, -c.SPEED_TURN)
_CONTROLS = np.array([(_SPEED[a.drive], _TURN[a.turn], a.gripper, a.gripper, 0.0, 0.0) for a in ACTIONS])
_CONTROLS.setflags(write=False)


def control_signal(action: int) -> NDArray[np.float64]:
    """What an action (0..17) writes into MuJoCo's `ctrl`. Shape (6,)."""
    return _CONTROLS[action]
