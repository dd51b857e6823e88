"""Episodes of violent random actions, and measures of physical errors in them, with the limits of `test_physics.py`."""

from __future__ import annotations

import math
from collections.abc import Iterator

import mujoco
import numpy as np
import shapely
from numpy.typing import NDArray

import magical_mj
from magical_mj.assets.contacts import SETTINGS, SUBSTEPS, PhysicsSettings
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.scene_model import SceneModel
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.geometry import block_outline
from magical_mj.tasks.registry import task_spec
from magical_mj.variants.rules import draw_dynamics

WORST = {"broken": 0.0, "warnings": 0.0, "outside": 0.01, "overlap": 0.01}
"""The largest allowed values of `worst` in an episode."""
STEPS = 100
KINDS = ("random", "corner", "spin", "steady")
VARIANTS = [pair for pair in magical_mj.ENVIRONMENTS if pair[1] in ("Demo", "Dynamics", "All")]
ANGLES = np.linspace(0, np.pi, 60, endpoint=False)
DIRECTIONS = np.array([np.cos(ANGLES), np.sin(ANGLES)])


def crowd(rng: np.random.Generator) -> Scene:
    """Ten blocks around the robot, with dynamics of the Dynamics variant."""
    robot, blocks = Robot(*rng.uniform(-0.5, 0.5, 2).tolist(), float(rng.uniform(-np.pi, np.pi))), []
    while len(blocks) < 10:
        x, y = rng.uniform(-0.82, 0.82, 2).tolist()
        apart = [math.dist((x, y), (block.x, block.y)) for block in blocks]
        if math.dist((x, y), (robot.x, robot.y)) > 0.56 and min(apart, default=1) > 0.3:
            shape = c.SHAPES[rng.integers(4)]
            blocks.append(Block(shape, "red", x, y, float(rng.uniform(-np.pi, np.pi))))
    return Scene(robot, tuple(blocks), dynamics=draw_dynamics(rng, task_spec("MatchRegions").drive_forces))


def episode(number: int) -> tuple[Scene, str]:
    """The scene of an episode, and the kind of its actions."""
    rng = np.random.default_rng(number)
    kind = KINDS[number % 4]
    if kind in ("corner", "spin"):
        return crowd(rng), kind
    task, variant = VARIANTS[rng.integers(len(VARIANTS))]
    return magical_mj.sample_scene(task, variant, number), kind


def hands(kind: str, rng: np.random.Generator) -> Iterator[int]:
    """Yields actions without end. "corner" steers to a corner, and must be sent the robot's pose at each step."""
    if kind == "corner":
        goal, action = rng.choice([-1.0, 1.0], 2), 0
        while True:
            pose = yield action
            bearing = math.atan2(pose[0] - goal[0], goal[1] - pose[1])
            turn = (bearing - pose[2] + math.pi) % (2 * math.pi) - math.pi
            action = int(rng.choice([1, 10]) if abs(turn) < 0.3 else 4 if turn > 0 else 7)
            if rng.random() < 0.15:
                action = int(rng.integers(18))
    while True:
        action = int(rng.choice([3, 6, 12, 15, 4, 7]) if kind == "spin" and rng.random() < 0.8 else rng.integers(18))
        for _ in range({"random": 1, "spin": 3, "steady": 6}[kind]):
            yield action


def play(number: int, settings: PhysicsSettings = SETTINGS) -> tuple[Scene, NDArray[np.float64], int]:
    """The scene, the poses after each action, shape (steps, 1 + blocks, 3), and the number of MuJoCo's warnings."""
    scene, kind = episode(number)
    world = SceneModel(scene)
    model = mujoco.MjModel.from_xml_string(scene_mjcf(scene, settings=settings))
    data = mujoco.MjData(model)
    signal, actor = controls(settings=settings), hands(kind, np.random.default_rng(number))
    action, track = next(actor), []
    for _ in range(STEPS):
        data.ctrl[:] = signal[action]
        mujoco.mj_step(model, data, SUBSTEPS)
        track.append(world.poses(data.qpos))
        action = actor.send(track[-1][0])
    return scene, np.array(track), sum(warning.number for warning in data.warning)


def outlines(shape: c.Shape, poses: NDArray[np.float64]) -> NDArray[np.object_]:
    """A block's outline at each of many poses."""
    cosine, sine = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    turned = np.einsum("kj,ijn->nki", block_outline(shape), np.array([[cosine, -sine], [sine, cosine]]))
    return shapely.polygons(turned + poses[:, None, :2])


def depth(overlap: shapely.Geometry) -> float:
    """The penetration depth of two bodies: the smallest width of the convex hull of each part of their intersection.

    If a part has a notch, such as between two arms of a star, this overestimates the depth.
    """
    hulls = [part.convex_hull for part in shapely.get_parts(overlap) if part.area > 0]
    return max((float(np.ptp(np.array(hull.exterior.coords) @ DIRECTIONS, axis=0).min()) for hull in hulls), default=0)


def worst(number: int, settings: PhysicsSettings = SETTINGS) -> dict[str, float]:
    """The physical errors in an episode: non-finite states, warnings, and distances in world units."""
    scene, track, warnings = play(number, settings)
    shapes = [outlines(block.shape, track[:, i]) for i, block in enumerate(scene.blocks, 1)]
    robot = np.abs(track[:, 0, :2]).max() + c.ROBOT_RADIUS - c.ARENA_HALF_WIDTH
    bounds = [np.abs(shapely.bounds(shape)).max() - c.ARENA_HALF_WIDTH for shape in shapes]
    overlap = 0.0
    for i, first in enumerate(shapes, 1):
        for j, second in enumerate(shapes[: i - 1], 1):
            near = np.flatnonzero(np.hypot(*(track[:, i] - track[:, j])[:, :2].T) < 2 * c.STAR_OUTER_RADIUS)
            overlap = max([overlap, *map(depth, shapely.intersection(first[near], second[near]))])
    broken = float(not np.isfinite(track).all())
    return {"broken": broken, "warnings": warnings, "outside": max(robot, *bounds, 0.0), "overlap": overlap}
