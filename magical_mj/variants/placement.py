"""The jitter and layout axes: rejection sampling of poses with exact outlines.

Objects are placed in this order: the goal regions, the robot with its open fingers, the blocks that start outside the
regions, and the blocks that belong in a region. A draw is rejected if the object touches a wall or an object placed
before. For the robot and the outer blocks, every region is an obstacle. A block that belongs in a region (or the robot,
in a user's task) avoids the other regions and has its centre in its own one, but may stick out of it. So each pose is
uniform given the earlier ones, as in the original.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Final

import numpy as np

from magical_mj.scene import Block, GoalRegion, Pose, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.bodies import GRIPPER
from magical_mj.scene.geometry import Solid, block_solid, inside_walls, region_solid, robot_solid, solids, touch
from magical_mj.utils.errors import PlacementError

MAX_TRIES: Final = 10_000
"""The number of draws for one object before placement starts over."""
MAX_ROUNDS: Final = 11
"""The number of rounds before placement fails."""


STRIDE: Final = 0.001
"""The growth of the range of poses with each try in `along`, in world units and in rad."""

Object = Robot | Block | GoalRegion
Draw = Callable[[Object, GoalRegion | None, int], Pose]
"""(an object, the placed region that it belongs in, or None, the number of tries so far) -> a random pose."""


def jitter(scene: Scene, rng: np.random.Generator, region_size: tuple[float, float]) -> Scene:
    """The scene with small random changes of all poses and of the regions' sizes, which stay in `region_size`.

    Raises:
        PlacementError: if no legal placement was found.
    """
    step = c.JITTER_REGION_SIZE
    low, high = region_size
    regions = []
    for region in scene.regions:  # resized with the left and top edge fixed, as in the original
        height = min(max(region.height + _between(rng, -step, step), low), high)
        width = min(max(region.width + _between(rng, -step, step), low), high)
        regions.append(replace(region, x_max=region.x_min + width, y_min=region.y_max - height))
    return _place(scene, regions, partial(_around, rng))


def layout(scene: Scene, rng: np.random.Generator, region_size: tuple[float, float], inner_margin: float) -> Scene:
    """The scene with new poses in the whole workspace and new sizes of the regions.

    Args:
        scene: the scene.
        rng: draws poses and sizes.
        region_size: the least and the greatest height and width of regions, in world units.
        inner_margin: see `VariationRules.inner_margin`.

    Raises:
        PlacementError: if no legal placement was found.
    """
    regions = []
    for region in scene.regions:
        height, width = _between(rng, *region_size), _between(rng, *region_size)
        regions.append(replace(region, x_max=region.x_min + width, y_max=region.y_min + height))

    def anywhere(_: Object, home: GoalRegion | None, tries: int) -> Pose:
        del tries
        (x, y), half = (0.0, 0.0), scene.half_width
        if home is not None:
            (x, y), half = home.centre, min(home.height, home.width) / 2 - inner_margin
        return (
            _between(rng, x - half, x + half),
            _between(rng, y - half, y + half),
            _between(rng, -math.pi, math.pi),
        )

    return _place(scene, regions, anywhere)


def along(scene: Scene, other: Scene, fraction: float, rng: np.random.Generator) -> Scene:
    """The scene with all poses and region sizes interpolated between it and `other`.

    If objects would touch, they are moved aside, by the smallest distance that a random search finds.

    Args:
        scene: the scene.
        other: a scene with the same objects at other poses, and regions of other sizes.
        fraction: from 0, the scene itself, to 1, exactly the poses and sizes of `other`.
        rng: the generator of the random search.

    Raises:
        PlacementError: if no legal placement was found.
    """

    def between(start: float, end: float) -> float:
        return start * (1 - fraction) + end * fraction

    def turned(start: float, end: float) -> float:
        return end if fraction == 1 else start + fraction * math.remainder(end - start, 2 * math.pi)

    def moved(here: Robot | Block, there: Robot | Block) -> Pose:
        return between(here.x, there.x), between(here.y, there.y), turned(here.angle, there.angle)

    sides = ("x_min", "y_min", "x_max", "y_max")
    regions = tuple(
        replace(region, **{side: between(getattr(region, side), getattr(there, side)) for side in sides})
        for region, there in zip(scene.regions, other.regions, strict=True)
    )
    robot = moved(scene.robot, other.robot)
    blocks = [moved(block, there) for block, there in zip(scene.blocks, other.blocks, strict=True)]
    direct = replace(scene.moved(robot, blocks), regions=regions)
    if contact(direct) is None and _homes(direct) == _homes(scene):
        return direct
    poses: dict[Object, Pose] = {region: (*region.centre, 0.0) for region in regions}
    poses |= dict(zip((scene.robot, *scene.blocks), (robot, *blocks), strict=True))
    return _place(scene, regions, lambda item, home, tries: _near(rng, poses[item], home, tries))


@lru_cache(maxsize=100)
def with_room(scene: Scene) -> Scene:
    """The scene with the robot moved aside if it touches a wall, a block or a region, as a longer body may.

    A random search finds about the smallest move. It is the same for all seeds.

    Raises:
        PlacementError: if no free pose was found.
    """
    if contact(scene) is None:
        return scene
    areas = list(map(region_solid, scene.regions))
    others = list(solids(scene).values())[1:]
    rng = np.random.Generator(np.random.PCG64(0))
    try:
        draw = partial(_near, rng, scene.robot.pose, None)
        pose, _ = _find(scene.robot, draw, areas + others, scene.half_width)
    except _NoRoomError as error:
        raise PlacementError(f"found no room for {error} in the demo scene: move blocks and regions apart") from None
    return scene.moved(robot=pose)


def contact(scene: Scene, regions: bool = True) -> str | None:
    """The first contact that placement would reject, such as "block 1 touches a wall". None if there is none.

    Without `regions`, only the robot, blocks and walls count.
    """
    scene = scene if regions else replace(scene, regions=())
    areas = {f"region {number}": region_solid(region) for number, region in enumerate(scene.regions)}
    bodies = solids(scene)
    walled = {name: areas[name] for name, region in zip(areas, scene.regions, strict=True) if not region.is_zone}
    for name, solid in (walled | bodies).items():
        if not inside_walls(solid, half_width=scene.half_width):
            return f"{name} touches a wall"
    pairs = [*itertools.combinations(areas.items(), 2), *itertools.combinations(bodies.items(), 2)]
    for home, body in zip(_homes(scene), bodies.items(), strict=True):
        pairs += [(body, area) for number, area in enumerate(areas.items()) if number != home]
    return next((f"{name} touches {other}" for (name, a), (other, b) in pairs if touch(a, b)), None)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return low + (high - low) * rng.random()


def _around(rng: np.random.Generator, item: Object, home: GoalRegion | None, tries: int) -> Pose:
    """A pose close to that of an object. If it belongs in a region, its centre stays there."""
    del tries
    x, y, angle = (*item.centre, 0.0) if isinstance(item, GoalRegion) else item.pose
    step, turn = c.JITTER_POSITION, c.JITTER_ANGLE
    xs, ys = (x - step, x + step), (y - step, y + step)
    if home is not None:
        xs = [min(max(x, home.x_min), home.x_max) for x in xs]
        ys = [min(max(y, home.y_min), home.y_max) for y in ys]
    return _between(rng, *xs), _between(rng, *ys), _between(rng, angle - turn, angle + turn)


def _near(rng: np.random.Generator, pose: Pose, home: GoalRegion | None, tries: int) -> Pose:
    """The pose itself at first, then random poses that differ at most by `STRIDE` times the tries in each coordinate.

    The centre stays in `home`.
    """
    x, y, angle = pose
    u, v, w = (min(STRIDE * tries, c.ARENA_HALF_WIDTH) * (2 * rng.random(3) - 1)).tolist()
    x, y = x + u, y + v
    if home is not None:
        x, y = min(max(x, home.x_min), home.x_max), min(max(y, home.y_min), home.y_max)
    return x, y, angle + w


class _NoRoomError(Exception):
    """No legal pose was found for an object, which is the argument."""


def _place(scene: Scene, regions: Sequence[GoalRegion], draw: Draw) -> Scene:
    """The scene with its regions replaced by `regions` and all poses drawn by `draw`."""
    stuck: object = None
    for _ in range(MAX_ROUNDS):
        try:
            return _place_once(scene, regions, draw)
        except _NoRoomError as error:
            stuck = error
    raise PlacementError(
        f"found no room for {stuck} among {len(scene.blocks)} blocks and {len(regions)} goal regions, in "
        f"{MAX_ROUNDS} rounds of placement. Use fewer blocks, fewer or smaller regions, or another seed; and let no "
        "object overlap a region that does not contain its centre"
    )


def _place_once(scene: Scene, regions: Sequence[GoalRegion], draw: Draw) -> Scene:
    """One round of `_place`. Raises `_NoRoomError` if no legal pose is found for an object."""
    areas: list[Solid] = []
    placed_regions: list[GoalRegion] = []
    for region in regions:
        pose, area = _find(region, partial(draw, region, None), areas, scene.half_width)
        placed_regions.append(_at(region, pose))
        areas.append(area)

    items, homes = (scene.robot, *scene.blocks), _homes(scene)
    poses, placed = dict[int, Pose](), list[Solid]()
    for index in sorted(range(len(items)), key=lambda index: index > 0 and homes[index] is not None):  # the robot is 0
        item, home = items[index], homes[index]
        own_region = None if home is None else placed_regions[home]
        obstacles = placed + areas if home is None else placed + areas[:home] + areas[home + 1 :]
        poses[index], solid = _find(item, partial(draw, item, own_region), obstacles, scene.half_width)
        placed.append(solid)
    robot, *blocks = map(poses.__getitem__, range(len(items)))
    return replace(scene.moved(robot, blocks), regions=tuple(placed_regions))


def _homes(scene: Scene) -> list[int | None]:
    """For the robot, then each block: the index of the region that it belongs in, or None.

    It belongs in the first region that contains its centre.
    """
    homes: list[int | None] = []
    for item in (scene.robot, *scene.blocks):
        inside = (number for number, region in enumerate(scene.regions) if region.contains(item))
        homes.append(next(inside, None))
    return homes


def _at(region: GoalRegion, pose: Pose) -> GoalRegion:
    """The region with its centre at the pose's position. The angle is ignored, since regions are never rotated."""
    (x, y, _), half_width, half_height = pose, region.width / 2, region.height / 2
    box = x - half_width, y - half_height, x + half_width, y + half_height
    return GoalRegion(region.colour, *box, region.border)


def _find(item: Object, draw: Callable[[int], Pose], obstacles: Sequence[Solid], half: float) -> tuple[Pose, Solid]:
    """The first drawn pose where an object touches neither walls nor obstacles, and the area that it covers there.

    The walls are at the distance `half` from the origin. Raises `_NoRoomError` if `MAX_TRIES` draws are not enough.
    """
    for tries in range(MAX_TRIES):
        pose = draw(tries)
        if isinstance(item, Robot) and item.body == GRIPPER and max(map(abs, pose[:2])) + c.ROBOT_RADIUS > half:
            continue  # a shortcut: the disc touches a wall, so the fingers' outlines are not needed
        if isinstance(item, Robot):
            solid = robot_solid(pose, item.fingers, item.body)
        elif isinstance(item, Block):
            solid = block_solid(item.shape, pose)
        else:
            solid = region_solid(_at(item, pose))
        if inside_walls(solid, half_width=half) and not any(touch(solid, other) for other in obstacles):
            return pose, solid
    raise _NoRoomError(item)
