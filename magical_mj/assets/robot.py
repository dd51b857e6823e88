"""The robot: a body that drives and turns, and the two hinged fingers of a gripper.

The original's 2-D engine has four features that MuJoCo lacks. They are modelled as follows:

- The velocity servo applies a force in any direction with one cap. It also brakes and prevents side-slip. Here, driven
  wheels under the robot's centre press on the floor with a constant force: Coulomb friction has the same cap in all
  directions.
- The turning servo has a torque cap. Here, dry friction couples the robot to heavy spinning rotors.
- The finger motors have a torque cap. Here, dry friction couples each finger to a heavy rotor. The original
  slows down over the last 0.1 rad; here the finger stops at its limit.
- Commands act one substep late. Here, each command passes through a filter of one substep, and the wheels are mounted
  on a light castor that has the robot's heading of the previous substep.

There are two wheels and two rotors because a load slows the original's servos; see `PhysicsSettings.loaded_share`.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS, Gripper
from magical_mj.assets import style
from magical_mj.assets.block import polygon_geoms
from magical_mj.assets.contacts import (
    SETTINGS,
    SUBSTEPS,
    TIMESTEP,
    Floats,
    PhysicsSettings,
    floor_pair,
    foot,
    vertex,
)
from magical_mj.assets.mjcf import comment, numbers, planar_body
from magical_mj.scene import Dynamics, Robot
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER, Body, body_named
from magical_mj.scene.geometry import quaternion

Side = Literal["left", "right"]
SIGN: Final[dict[Side, int]] = {"left": -1, "right": 1}
"""The sign of the x coordinate of a finger in the robot's frame."""
FINGER_INERTIA: Final[dict[Side, float]] = {"left": 0.00500649436186835, "right": 0.004983019517209476}
"""Moments of inertia about the pivot, which is the centre of mass. The original's two fingers differ slightly."""
WHEELS: Final = ("wheel", "loaded_wheel")
ROTORS: Final = ("rotor", "loaded_rotor")
MOTORS: Final[dict[Side, str]] = {"left": "left_motor", "right": "right_motor"}
_PLANAR: Final = ("robot_x", "robot_y", "robot_angle")
JOINTS: Final = (*_PLANAR, "castor", *WHEELS, *ROTORS, *MOTORS.values(), "left_finger", "right_finger")
"""The gripper's joints in the order of the model's coordinates."""


def joints(body: str) -> tuple[str, ...]:
    """The joints of a robot with this body, in the order of the model's coordinates."""
    return JOINTS if body_named(body).fingers else JOINTS[: JOINTS.index(MOTORS["left"])]


def actuators(body: str) -> tuple[str, ...]:
    """The actuators of a robot with this body, in the order of the model's controls."""
    return (*WHEELS, *ROTORS, *(MOTORS.values() if body_named(body).fingers else ()))


CASTOR_INERTIA: Final = 1e-5  # light enough to have no effect on the robot
LIGHT: Final = '<inertial pos="0 0 0" mass="1e-6" diaginertia="1e-7 1e-7 1e-7"/>'


def robot_mjcf(robot: Robot, settings: PhysicsSettings, half: float = c.ARENA_HALF_WIDTH) -> str:
    """The body `robot` with its motors, fingers, face and camera ego, in an arena of this half width."""
    body = body_named(robot.body)
    disc = f'<geom name="robot_disc" class="disc" size="{numbers(body.radius - settings.body_overlap)}"/>'
    castor = f'armature="{numbers(CASTOR_INERTIA)}" stiffness="{numbers(CASTOR_INERTIA / TIMESTEP**2)}"'
    wheels = "".join(_spinner(name, "-1 0 0", foot(name)) for name in WHEELS)
    fingers = ""
    if body.fingers:
        fingers = f"""<!-- Finger motors: a heavy rotor for each finger -->
{"".join(_spinner(name, "0 0 1") for name in MOTORS.values())}
{_finger("left", robot.fingers[0], settings)}
{_finger("right", robot.fingers[1], settings)}"""
    content = f"""
<inertial pos="0 0 0" mass="{numbers(body.mass)}" diaginertia="{numbers(*[body.inertia] * 3)}"/>
{polygon_geoms("robot", body.corners, settings) if body.outline else disc}
<!-- The robot's camera: in its picture the robot is near the bottom and heads up -->
{style.ego_camera(half)}
<!-- The drive: wheels that press on the ground with a constant force. They are too heavy to be slowed. -->
<!-- The second wheel and the second rotor have a lower speed while the gripper closes, as under a load -->
<!-- A light castor keeps the wheels in the heading of the previous step, since commands act one step late -->
<body name="castor"><joint name="castor" type="hinge" axis="0 0 1" {castor}/>{LIGHT}{wheels}</body>
<!-- Turning: heavy rotors, which spin in the opposite direction; dry friction with them turns the robot -->
{"".join(_spinner(name, "0 0 1") for name in ROTORS)}
{fingers}
<!-- Body and eyes, listed after the fingers: in flat pictures they cover the fingers' roots -->
<body name="face">{_face(body)}</body>"""
    return comment("The robot") + planar_body("robot", robot.pose, content)


def _spinner(name: str, axis: str, geom: str = "") -> str:
    """The body of a heavy wheel, rotor or motor."""
    joint = f'<joint name="{name}" class="rotor" axis="{axis}"/>'
    return f'<body name="{name}">{joint}{LIGHT}{geom}</body>'


def _face(body: Body) -> str:
    """The visual geoms of body and eyes. They are drawn after the fingers: the body covers the fingers' roots."""
    sides = style.cylinder_shape(body.radius, style.ROBOT_HEIGHT)
    if body.outline:
        sides = 'type="mesh" mesh="robot_sides"'
    return (
        style.visual_geom("robot_outline", "robot_outline", style.DARK_GREY)
        + style.visual_geom("robot_fill", "robot_fill", style.GREY)
        + style.solid("robot_sides", sides, style.DARK_GREY)
        + style.visual_geom("eyes", "eyes", style.WHITE)
        + style.visual_geom("pupils", "pupils", style.BLACK)
    )


def _finger(side: Side, angle: float, settings: PhysicsSettings) -> str:
    """The body `<side>_finger`: a box for each segment, and spheres at the three convex corners."""
    sign, name, inertia = SIGN[side], f"{side}_finger", FINGER_INERTIA[side]
    half, bend = c.FINGER_THICKNESS / 2, SIGN[side] * c.FINGER_BEND

    def forearm(inwards: float, onwards: float) -> tuple[float, float]:
        """A point of the forearm, relative to the outer corner of the upper segment's tip, where the two meet."""
        cosine, sine = math.cos(bend), math.sin(bend)
        return (
            sign * half - cosine * sign * inwards - sine * onwards,
            c.FINGER_UPPER_LENGTH - sine * sign * inwards + cosine * onwards,
        )

    thin, rim = half - settings.finger_overlap, settings.vertex_radius + settings.finger_overlap
    length = c.FINGER_FOREARM_LENGTH
    corners = (forearm(rim, length - rim), forearm(c.FINGER_THICKNESS - rim, length - rim), forearm(rim, 0))
    upper = style.box_shape(0, c.FINGER_UPPER_LENGTH / 2, half, c.FINGER_UPPER_LENGTH / 2, style.FINGER_HEIGHT)
    lower = style.box_shape(*forearm(half, length / 2), half, length / 2, style.FINGER_HEIGHT, bend)
    low, high = sorted((0.0, -sign * c.FINGER_OPEN))
    return (
        f'<body name="{name}" pos="{numbers(sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1], 0)}" '
        f'quat="{numbers(*quaternion(angle))}">'
        f'<joint name="{name}" class="finger" axis="0 0 1" ref="{numbers(angle)}" range="{numbers(low, high)}"/>'
        f'<inertial pos="0 0 0" mass="{c.FINGER_MASS}" diaginertia="{numbers(inertia, inertia, inertia)}"/>'
        + style.visual_geom(f"{name}_outline", f"{name}_outline", style.GREY)
        + style.visual_geom(f"{name}_fill", f"{name}_fill", style.LIGHT_GREY)
        + style.solid(f"{name}_upper_sides", upper, style.GREY)
        + style.solid(f"{name}_forearm_sides", lower, style.GREY)
        + f'<geom name="{name}_upper_edges" class="finger_edge" type="box" '
        f'size="{numbers(thin, c.FINGER_UPPER_LENGTH / 2, 0.1)}" '
        f'pos="0 {numbers(c.FINGER_UPPER_LENGTH / 2)} 0"/>'
        f'<geom name="{name}_forearm_edges" class="finger_edge" type="box" '
        f'size="{numbers(thin, length / 2 - settings.finger_overlap, 0.1)}" '
        f'pos="{numbers(*forearm(half, length / 2), 0)}" quat="{numbers(*quaternion(bend))}"/>'
        + "".join(
            vertex(f"{name}_corner{k}", *corner, settings.vertex_radius, "finger_vertex")
            for k, corner in enumerate(corners)
        )
        + "</body>"
    )


def robot_pairs(robot: Robot, dynamics: Dynamics, settings: PhysicsSettings) -> str:
    """The contacts of the wheels with the floor."""
    mass = body_named(robot.body).total_mass
    return comment("The wheels' friction with the ground, up to the drive's force cap") + "".join(
        floor_pair(wheel, force, mass, settings) for wheel, force in wheel_caps(dynamics.drive_force, settings).items()
    )


def wheel_caps(drive_force: Floats, settings: PhysicsSettings = SETTINGS) -> dict[str, Floats]:
    """Wheel -> its largest driving force. Accepts arrays."""
    return {WHEELS[0]: (1 - settings.loaded_share) * drive_force, WHEELS[1]: settings.loaded_share * drive_force}


def torque_caps(turn_torque: Floats, finger_torque: Floats, settings: PhysicsSettings = SETTINGS) -> dict[str, Floats]:
    """Rotor or finger motor -> the largest torque of its tendon. Accepts arrays."""
    loaded = settings.loaded_turn_share
    rotors = {ROTORS[0]: (1 - loaded) * turn_torque, ROTORS[1]: loaded * turn_torque}
    return rotors | dict.fromkeys(MOTORS.values(), finger_torque)


def tendons_mjcf(robot: Robot, dynamics: Dynamics, settings: PhysicsSettings) -> str:
    """Dry friction of the turning servo and the finger motors, and damping of the fingers' sway and of the castor.

    The castor's damping makes it lag one substep behind the robot.
    """
    caps = torque_caps(dynamics.turn_torque, dynamics.finger_torque, settings)
    turns = "".join(
        f'<fixed name="{rotor}" class="rotor" frictionloss="{numbers(caps[rotor])}">'
        f'<joint joint="robot_angle" coef="1"/><joint joint="{rotor}" coef="1"/></fixed>'
        for rotor in ROTORS
    )
    castor = (
        f'<fixed name="castor" damping="{numbers(CASTOR_INERTIA / TIMESTEP)}">'
        '<joint joint="robot_angle" coef="1"/><joint joint="castor" coef="1"/></fixed>'
    )
    friction, grips = "Dry friction up to the torque cap: rotors with the robot", ""
    damping, sway = "Damping that makes the castor lag one step", ""
    if body_named(robot.body).fingers:
        friction = "Dry friction up to the torque caps: rotors with the robot, motors with fingers"
        grips = "".join(
            f'<fixed name="{motor}" class="motor" frictionloss="{numbers(caps[motor])}">'
            f'<joint joint="{side}_finger" coef="1"/><joint joint="{motor}" coef="-1"/></fixed>'
            for side, motor in MOTORS.items()
        )
        damping = "Damping: of fingers that swing to the same side, and of the castor, so that it lags one step"
        sway = (
            f'<fixed name="sway" damping="{numbers(settings.sway_damping)}">'
            '<joint joint="left_finger" coef="1"/><joint joint="right_finger" coef="1"/></fixed>'
        )
    return f"{comment(friction)}{turns}{grips}{comment(damping)}{sway}{castor}"


def actuators_mjcf(body: str = GRIPPER) -> str:
    """Actuators that reach their speed in one substep: two wheels (units/s), two rotors and two finger motors (rad/s).

    A body without fingers has the first four.
    """
    classes: dict[tuple[str, ...], str] = {WHEELS: "wheel", ROTORS: "rotor"}
    text = "Speeds of wheels (units/s) and rotors (rad/s), one step late"
    if body_named(body).fingers:
        classes[tuple(MOTORS.values())] = "motor"
        text = "Speeds of wheels (units/s), rotors and finger motors (rad/s), one step late"
    return comment(text) + "".join(
        f'<general name="{joint}" class="{kind}" joint="{joint}"/>'
        for joints, kind in classes.items()
        for joint in joints
    )


@lru_cache(16)
def controls(body: str = GRIPPER, veer: float = 0.0, settings: PhysicsSettings = SETTINGS) -> NDArray[np.float64]:
    """The values of `ctrl` for each of the 18 actions: speeds of wheels, rotors and finger motors. Shape (18, 6).

    Without fingers, the shape is (18, 4), and the gripper's part of an action is ignored. `veer` is `Dynamics.veer`.
    """
    rows = []
    fingers = body_named(body).fingers
    for action in ACTIONS:
        speed = (0.0, c.SPEED_FORWARD, -c.SPEED_BACKWARD)[action.drive]
        turn = (0.0, c.SPEED_TURN, -c.SPEED_TURN)[action.turn]
        loaded_speed, loaded_turn, grip = speed, turn, c.SPEED_FINGER
        if action.gripper is Gripper.CLOSE and fingers:
            loaded_speed = (0.0, settings.loaded_forward, -settings.loaded_backward)[action.drive]
            loaded_turn = (0.0, settings.loaded_turn, -settings.loaded_turn)[action.turn]
            grip = -c.SPEED_FINGER
        turns = turn + veer * speed, loaded_turn + veer * loaded_speed
        rows.append((speed, loaded_speed, *turns, *((grip, -grip) if fingers else ())))
    signals = np.array(rows)
    signals.setflags(write=False)
    return signals


TURN_GAIN: Final = 0.5 / TIMESTEP
"""Gain of x-magical's heading servo: turning speed (rad/s) per radian between its target and the robot's heading."""
FINGER_GAIN: Final = 10.0
"""Gain of x-magical's finger motors: speed (rad/s) per radian between the finger and its target."""


def speed_signal(
    action: NDArray[np.floating], fingers: NDArray[np.float64] | None, before: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The values of `ctrl` for one of x-magical's actions: speed (units/s), turn (rad) and, with fingers, grip (rad).

    The top speed is the same forwards and backwards. In x-magical, finger motors slow down near their target in every
    substep. Here, a motor has one speed for the whole action. It is chosen so that a free finger ends at the same angle
    as in x-magical.

    Args:
        action: the vector, shape (2,), with fingers (3,).
        fingers: angles of the left and the right finger, rad, shape (2,); None without fingers.
        before: the current values of `ctrl`, which still act for one substep.
    """
    speed = float(np.clip(action[0], -c.SPEED_FORWARD, c.SPEED_FORWARD))
    turn = float(np.clip(TURN_GAIN * action[1], -c.SPEED_TURN, c.SPEED_TURN))
    signal = [speed, speed, turn, turn]
    if fingers is not None:
        opening = float(np.clip(c.FINGER_OPEN - action[2], 0.0, c.FINGER_OPEN))
        for sign, angle, rate in zip((1, -1), fingers.tolist(), before[4:6].tolist(), strict=True):
            end, last = angle, rate
            for _ in range(SUBSTEPS):
                next_rate = min(max(FINGER_GAIN * (sign * opening - end), -c.SPEED_FINGER), c.SPEED_FINGER)
                end, last = end + TIMESTEP * last, next_rate
            signal.append(((end - angle) / TIMESTEP - rate) / (SUBSTEPS - 1))
    return np.array(signal)
