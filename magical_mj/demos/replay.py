"""Replaying demonstrations: playing the actions again, or drawing the recorded states; and how much they differ."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.world import World
from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import Recorder
from magical_mj.engine import Engine
from magical_mj.policies.interface import play
from magical_mj.tasks.registry import sample_scene

Picture = NDArray[np.uint8]

GLANCE: Final = 10  # steps between the pictures that are compared
SIZE: Final = 96  # pixels
ROUNDING: Final = 1e-9
TOUCHED: Final = 0.05  # world units; a block that moved less does not count as moved
SIDES: Final = 8  # from which a block can be taken
SAMPLES: Final = 50  # points of a path


class Verdict(NamedTuple):
    """The result of checking a demonstration."""

    scene: bool
    """The scene is still that of its seed, and the recorded states begin in it."""
    score: bool
    """The last state has the recorded score."""
    replay: bool
    """The same actions lead to the same score, and all of them are within the episode."""
    exact: bool
    """The same actions lead to exactly the same states: so with the machine and versions of the recording."""
    pictures: bool
    """The pictures of the replay equal those of the recorded states, pixel by pixel."""

    @property
    def good(self) -> bool:
        """Whether the demonstration is what it says it is."""
        return self.problem is None

    @property
    def problem(self) -> str | None:
        """What is wrong, to be said after the demonstration's name; None if nothing is."""
        if not self.scene:
            return "does not start in the scene that its variant and seed have in this version of the world"
        return None if self.score and self.replay else "does not replay to its score in this version of the world"


def verify(demo: Demonstration) -> Verdict:
    """Checks a demonstration with this version of the package and of MuJoCo."""
    drawn = [pictures["allo"] for pictures in itertools.islice(render_demo(demo), 0, None, GLANCE)]
    body = demo.scene.robot.body
    start: dict[str, Any] = {"seed": demo.scene_seed, "shifts": demo.shifts} if demo.shifts else {"scene": demo.scene}
    with closing(Engine(demo.task, demo.variant, body=body, **start)) as env:
        expected = env.initial_scene if demo.shifts else sample_scene(demo.task, demo.variant, demo.scene_seed, body)
        recorder, replayed = Recorder(env), [env.render("allo", SIZE)]
        for step, _ in enumerate(play(recorder, demo.actions.tolist()), start=1):
            if step % GLANCE == 0:
                replayed.append(env.render("allo", SIZE))
        positions, velocities = recorder.states()
        score = env.score()
    same_scene = expected == demo.scene and all(
        np.allclose(states[0], recorded[0], rtol=0, atol=ROUNDING)
        for states, recorded in ((positions, demo.qpos), (velocities, demo.qvel))
    )
    same_score = score == demo.score and len(positions) == len(demo.qpos)
    same_states = np.array_equal(positions, demo.qpos) and np.array_equal(velocities, demo.qvel)
    same_pictures = np.array_equal(replayed, drawn)
    return Verdict(same_scene, demo.rescored() == demo.score, same_score, same_states, same_pictures)


def render_demo(
    demo: Demonstration, views: Sequence[str] = ("allo",), size: int = SIZE, renderer: str | None = None
) -> Iterator[dict[str, Picture]]:
    """The pictures before the first action and after each action, drawn from the recorded states.

    Args:
        demo: the demonstration.
        views: any of "ego" and "allo", and of "ego-segmentation" and "allo-segmentation".
        size: side of the pictures in pixels.
        renderer: what draws them, as in `magical_mj.Engine`.

    Yields:
        View -> picture, shape (size, size, 3).
    """
    with closing(
        Engine(demo.task, demo.variant, scene=demo.scene, renderer=renderer, body=demo.scene.robot.body)
    ) as env:
        for positions in demo.qpos:
            env.data.qpos[:] = positions
            mujoco.mj_kinematics(env.model, env.data)
            mujoco.mj_camlight(env.model, env.data)
            yield {view: env.render(view, size) for view in views}


class Diversity(NamedTuple):
    """What differs in a set of demonstrations."""

    orders: int
    """Different orders in which blocks were moved."""
    strategies: int
    """Different orders, with the side from which each block was moved."""
    ways: float
    """Mean distance (world units) between two paths of the robot, at equal fractions of their lengths."""


def diversity(demos: Iterable[Demonstration]) -> Diversity:
    """Compares demonstrations of one environment."""
    demos = list(demos)
    plans = [strategy(demo) for demo in demos]
    orders = {tuple(block for block, _ in plan) for plan in plans}
    paths = [_path(demo) for demo in demos]
    gaps = [float(np.hypot(*(first - second).T).mean()) for first, second in itertools.combinations(paths, 2)]
    return Diversity(len(orders), len(set(plans)), sum(gaps) / len(gaps) if gaps else 0.0)


def strategy(demo: Demonstration) -> tuple[tuple[int, int], ...]:
    """The blocks that were moved, in order, each with the side (0..7, by compass) from which the robot came."""
    poses = _poses(demo)
    moves = []
    for block in range(1, poses.shape[1]):
        moved = np.hypot(*(poses[:, block, :2] - poses[0, block, :2]).T) > TOUCHED
        if moved.any():
            when = int(moved.argmax())
            dx, dy = poses[when, 0, :2] - poses[when, block, :2]
            side = round(math.atan2(dy, dx) * SIDES / (2 * math.pi)) % SIDES
            moves.append((when, block - 1, side))
    return tuple((block, side) for _, block, side in sorted(moves))


def _path(demo: Demonstration) -> NDArray[np.float64]:
    """Points at equal distances along the robot's path. Shape (SAMPLES, 2)."""
    places = _poses(demo)[:, 0, :2]
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
    at = np.linspace(0, length[-1], SAMPLES)
    return np.stack([np.interp(at, length, places[:, axis]) for axis in (0, 1)], axis=1)


def _poses(demo: Demonstration) -> NDArray[np.float64]:
    """The poses of the robot and the blocks at each time. Shape (steps + 1, 1 + blocks, 3)."""
    world = World(demo.scene)
    return np.array([world.poses(qpos) for qpos in demo.qpos])
