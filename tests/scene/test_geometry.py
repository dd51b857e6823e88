"""Outlines against known figures, exact touching, and the errors for illegal scenes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.constants import SHAPES, Shape
from magical_mj.scene.geometry import (
    OVERLAP_TOLERANCE,
    block_outline,
    block_solid,
    check_scene,
    inside_walls,
    region_solid,
    robot_solid,
    touch,
)
from magical_mj.utils.errors import InvalidSceneError

CIRCLE_AREA = math.pi * c.BLOCK_SIZE**2


@pytest.mark.parametrize("shape", SHAPES)
def test_outlines_are_centred_counter_clockwise_and_point_up(shape: Shape) -> None:
    outline = block_outline(shape)
    ring = shapely.LinearRing(outline)
    assert ring.is_simple
    assert ring.is_ccw
    assert np.allclose(shapely.Polygon(outline).centroid.coords[0], (0, 0), atol=1e-12)
    assert outline[:, 1].max() >= -outline[:, 1].min() - 1e-12
    assert not outline.flags.writeable


@pytest.mark.parametrize("shape", ["square", "pentagon"])
def test_square_and_pentagon_have_the_area_of_the_circle(shape: Shape) -> None:
    assert shapely.Polygon(block_outline(shape)).area == pytest.approx(CIRCLE_AREA)


def test_the_star_has_five_long_tips() -> None:
    radii = np.hypot(*block_outline("star").T)
    assert sorted(radii.round(6)) == [0.078] * 5 + [0.156] * 5


def test_open_and_closed_fingers_are_where_they_were_measured() -> None:
    """Forearm corners in the robot's frame, left and right, measured on the original."""
    for fingers, left, right in [
        ((c.FINGER_OPEN, -c.FINGER_OPEN), (-0.1973, 0.2137, -0.1473, 0.3537), (0.1473, 0.2137, 0.1973, 0.3537)),
        ((0.0, 0.0), (-0.115, 0.2209, -0.0152, 0.3693), (0.0152, 0.2209, 0.115, 0.3693)),
    ]:
        (_, radius), _, (left_forearm, _), _, (right_forearm, _) = robot_solid((0, 0, 0), fingers).parts
        assert radius == c.ROBOT_RADIUS
        assert left_forearm.bounds == pytest.approx(left, abs=6e-5)
        assert right_forearm.bounds == pytest.approx(right, abs=6e-5)


def test_a_solid_turns_and_moves_with_its_pose() -> None:
    """A robot that faces +x (angle -pi/2) has its fingers on that side."""
    solid = robot_solid((0.5, 0.1, -math.pi / 2))
    bounds = [core.bounds for core, _ in solid.parts[1:]]
    assert max(box[2] for box in bounds) == pytest.approx(0.5 + 0.3537, abs=1e-4)
    assert max(box[3] for box in bounds) == pytest.approx(0.1 + 0.1973, abs=1e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_reach_bounds_every_part(shape: Shape) -> None:
    for solid in (block_solid(shape, (0.3, -0.2, 0.7)), robot_solid((0.3, -0.2, 0.7))):
        centre = shapely.Point(solid.x, solid.y)
        farthest = max(shapely.hausdorff_distance(centre, core) + radius for core, radius in solid.parts)
        assert farthest == pytest.approx(solid.reach)


def test_touching_is_exact_for_circles_and_squares() -> None:
    def circle(x: float) -> Block:
        return Block("circle", "red", x, 0, 0)

    for gap, touches in [(-1e-9, True), (1e-9, False)]:
        one, other = (block_solid("circle", circle(x).pose) for x in (0, 2 * c.BLOCK_SIZE + gap))
        assert touch(one, other) is touches
        width = c.SQUARE_SIDE + 2 * c.SQUARE_MARGIN  # squares collide with a small margin
        assert touch(block_solid("square", (0, 0, 0)), block_solid("square", (width + gap, 0, 0))) is touches
        region = region_solid(GoalRegion("red", c.BLOCK_SIZE + gap, -0.5, 1, 0.5))
        assert touch(one, region) is touches


def test_a_block_may_stand_between_open_fingers() -> None:
    """The circles around robot and block overlap there, the bodies do not."""
    assert not touch(robot_solid((0, 0, 0)), block_solid("circle", (0, 0.33, 0)))
    assert touch(robot_solid((0, 0, 0)), block_solid("circle", (0, 0.31, 0)))
    assert touch(robot_solid((0, 0, 0), fingers=(0.0, 0.0)), block_solid("circle", (0, 0.33, 0)))


@pytest.mark.parametrize(
    ("shape", "width"), [("circle", 2 * c.BLOCK_SIZE), ("square", c.SQUARE_SIDE + 2 * c.SQUARE_MARGIN)]
)
def test_tolerance_is_the_depth_that_passes(shape: Shape, width: float) -> None:
    for depth, touches in [(0.019, False), (0.021, True)]:
        assert touch(block_solid(shape, (0, 0, 0)), block_solid(shape, (width - depth, 0, 0)), 0.02) is touches


def test_walls_are_at_one() -> None:
    assert inside_walls(block_solid("circle", (0.88, -0.88, 0)))
    assert not inside_walls(block_solid("circle", (0.8801, 0, 0)))
    assert inside_walls(block_solid("square", (0.89, 0, 0)))
    assert not inside_walls(block_solid("square", (0.89, 0, math.pi / 4)))
    assert inside_walls(robot_solid((0, 0.64, 0)))
    assert not inside_walls(robot_solid((0, 0.65, 0)))
    assert inside_walls(robot_solid((0, 0.79, math.pi)))


def _with(*blocks: Block, regions: tuple[GoalRegion, ...] = (), fingers: tuple[float, float] = (0.3, -0.3)) -> Scene:
    return Scene(Robot(0, 0, 0, fingers), blocks, regions)


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        (_with(Block("star", "red", 0.95, 0, 0)), "block 0 .* walls"),
        (_with(Block("star", "red", 0, 0.25, 0)), "robot and block 0"),
        (
            _with(Block("star", "red", 0.5, 0.5, 0), Block("circle", "blue", 0.6, 0.5, 0)),
            "block 0 and block 1",
        ),
        (_with(regions=(GoalRegion("red", 0.5, 0.5, 1.1, 0.9),)), "region 0"),
        (_with(fingers=(-0.3, 0.3)), "fingers"),
        (_with(fingers=(0.6, -0.3)), "fingers"),
        (Scene(Robot(0, 0, 2e9)), "angle"),
        (_with(Block("circle", "red", 0.5, 0.5, -2e9)), "angle"),
        (_with(Block("circle", "red", 1e10, -1e10, 0)), "walls"),
        (_with(regions=(GoalRegion("red", -1e10, -1e10, 1e10, 1e10),)), "region 0"),
    ],
)
def test_illegal_scenes_are_named(scene: Scene, message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        check_scene(scene)


def test_soft_contacts_of_a_running_world_pass() -> None:
    near = 2 * c.BLOCK_SIZE - OVERLAP_TOLERANCE / 2
    check_scene(_with(Block("circle", "red", 0.5, 0.5, 0), Block("circle", "blue", 0.5 + near, 0.5, 0)))
    check_scene(_with(Block("circle", "red", 1.0 - c.BLOCK_SIZE + OVERLAP_TOLERANCE / 2, 0.5, 0)))
