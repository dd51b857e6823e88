"""The constants of the simulation: sizes, masses, speeds and force caps.

Lengths are in world units: the workspace is 2 x 2. Other units are seconds, radians and mass units. The values are
those of the original benchmark (Toyer et al. 2020, appendix "Additional benchmark details", and measurements on its
released simulation). If the two differ, the paper's are used. Only for Jitter, the paper gives too little detail ("up
to 5% of the maximum possible range"): its values are those of the released code.
"""

from __future__ import annotations

import math
from typing import Final, Literal, get_args

Shape = Literal["square", "pentagon", "star", "circle"]
Colour = Literal["red", "green", "blue", "yellow"]
Border = Literal["dashed", "solid"]
SHAPES: Final[tuple[Shape, ...]] = get_args(Shape)
COLOURS: Final[tuple[Colour, ...]] = get_args(Colour)
BORDERS: Final[tuple[Border, ...]] = get_args(Border)

# Workspace
ARENA_HALF_WIDTH: Final = 1.0  # inner faces of the walls are at x, y = +-1
CONTROL_RATE: Final = 8  # Hz, actions per second

# Robot: a disc with two hinged fingers, each an upper segment and a forearm bent inwards
ROBOT_RADIUS: Final = 0.2
ROBOT_MASS: Final = 1.0
ROBOT_INERTIA: Final = 0.02  # solid disc
FINGER_ROOT: Final = (0.09, 0.02)  # pivot of the right finger in the robot's frame; the left is mirrored
FINGER_UPPER_LENGTH: Final = 0.22
FINGER_FOREARM_LENGTH: Final = 0.14
FINGER_THICKNESS: Final = 0.05
FINGER_BEND: Final = math.pi / 8  # rad, forearm against upper segment
FINGER_OPEN: Final = math.pi / 8  # rad, left finger positive, right finger negative; closed is 0
FINGER_MASS: Final = 0.125  # each, centred on the pivot
EYE_CENTRE: Final = (0.08, 0.06)  # right eye in the robot's frame
EYE_RADIUS: Final = 0.04
PUPIL_CENTRE: Final = (0.08, 0.074)
PUPIL_RADIUS: Final = 0.024

# Blocks
BLOCK_SIZE: Final = 0.12  # radius of the circle; square and pentagon have the circle's area
BLOCK_MASS: Final = 0.5
SQUARE_SIDE: Final = math.sqrt(math.pi) * BLOCK_SIZE
SQUARE_MARGIN: Final = 0.01 * SQUARE_SIDE  # only the square has a rounded margin for collisions
PENTAGON_RADIUS: Final = BLOCK_SIZE * math.sqrt(math.pi / (2.5 * math.sin(0.4 * math.pi)))
STAR_OUTER_RADIUS: Final = 1.3 * BLOCK_SIZE
STAR_INNER_RADIUS: Final = 0.5 * STAR_OUTER_RADIUS

# Pebbles, which only shifts add to scenes
PEBBLE_RADIUS: Final = 0.03
PEBBLE_MASS: Final = 0.02
PEBBLE_FRICTION_FORCE: Final = 0.1
PEBBLE_FRICTION_TORQUE: Final = 0.001

# Target speeds of the servos
SPEED_FORWARD: Final = 0.8  # units/s
SPEED_BACKWARD: Final = 0.6  # units/s
SPEED_TURN: Final = 2.5  # rad/s
SPEED_FINGER: Final = 1.0  # rad/s

# Force caps; the Dynamics variant draws each uniformly from its range
DRIVE_FORCE: Final = 3.0
TURN_TORQUE: Final = 1.0
FINGER_TORQUE: Final = 4.0
BLOCK_FRICTION_FORCE: Final = 1.5
BLOCK_FRICTION_TORQUE: Final = 0.1

# Ranges of the variants (the paper's section 2.2, "Test variants")
JITTER_POSITION: Final = 0.025  # per axis, +-
JITTER_ANGLE: Final = 0.05 * math.pi  # +- rad
JITTER_REGION_SIZE: Final = 0.0075  # height and width, +-
REGION_SIZE: Final = (0.5, 0.8)  # height and width
FIX_COLOUR_REGION_SIZE: Final = (0.4, 0.5)

# Camera
VISIBLE_SIZE: Final = 2.04  # side of both views' square, in half widths of the arena
EGO_ANCHOR: Final = 0.15  # the robot's centre in the ego view, as a fraction of the height from the bottom
