"""Pictures for learning to see: the objects of training intents, and others, at random places, without simulation."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from magical_intents.practice import kept, random_scene
from magical_mj.engine.simulation import Simulation
from magical_mj.scene import Block, Robot
from magical_mj.scene.constants import COLOURS, FINGER_OPEN, SHAPES
from magical_mj.scene.scene import Pose

SIZE: Final = 96
"""The side of pictures in pixels."""
SCENES: Final = 100
"""The number of scenes in a file."""
POSES: Final = 8
"""The number of pictures of a scene."""
MORE: Final = 3
"""At most this number of blocks is added to a scene."""
LARGEST: Final = 8
"""The largest number of blocks."""
TIP: Final = 0.38
"""The distance of the fingers' tips from the robot's centre."""
REACH: Final = {True: 0.8, False: 0.89}
"""The largest coordinate of the robot, and of a block (units)."""
TOUCHING: Final = (0.225, 0.32)
"""The distances between the centres of blocks that touch, or nearly do."""
HELD: Final = (0.3, 0.38)
"""The distances of a block that the robot holds from its centre."""


class View(NamedTuple):
    """A picture (SIZE, SIZE, 3) and its state (names,)."""

    picture: NDArray[np.uint8]
    state: NDArray[np.float32]


def views(folder: Path, number: int) -> list[View]:
    """The pictures of `number` files in a folder. Missing files are made."""
    found: list[View] = []
    for index in range(number):
        arrays = kept(folder / f"{index}.npz", partial(_arrays, index))
        found += map(View, arrays["pictures"], arrays["states"])
    return found


def _arrays(number: int) -> dict[str, Any]:
    """The arrays of a file."""
    rng = np.random.default_rng(number)
    every = [one for _ in range(SCENES) for one in pictures_of_scene(rng)]
    return {"pictures": [one.picture for one in every], "states": [one.state for one in every]}


def pictures_of_scene(rng: np.random.Generator) -> Iterator[View]:
    """Pictures of the objects of a random scene at random places."""
    scene = random_scene(rng)
    more = min(int(rng.integers(MORE + 1)), LARGEST - len(scene.blocks))
    added = (Block(SHAPES[shape], COLOURS[0], 0, 0, 0) for shape in rng.integers(4, size=more).tolist())
    blocks = [replace(one, colour=COLOURS[int(rng.integers(4))]) for one in (*scene.blocks, *added)]
    scene = replace(scene, blocks=tuple(blocks))
    simulation = Simulation.of(scene, renderer="software")
    for _ in range(POSES):
        while (poses := _poses(len(blocks), rng)) is None:
            pass
        simulation.start(replace(scene, robot=Robot(*poses[0], _fingers(rng))).moved(None, poses[1:]))
        yield View(simulation.draw("allo", SIZE), simulation.state_vector())


def _fingers(rng: np.random.Generator) -> tuple[float, float]:
    """The angles of open fingers, or of others."""
    if rng.random() < 0.4:
        return FINGER_OPEN, -FINGER_OPEN
    left, right = rng.uniform(0, FINGER_OPEN, 2).tolist()
    return left, -right


def _poses(blocks: int, rng: np.random.Generator) -> list[Pose] | None:
    """Random poses of the robot and of the blocks, which do not overlap; None if this draw has no space."""
    x, y = rng.uniform(-REACH[True], REACH[True], 2).tolist()
    angle = float(rng.uniform(-math.pi, math.pi))
    if max(abs(x - TIP * math.sin(angle)), abs(y + TIP * math.cos(angle))) > 1.0:
        return None
    poses, held = [(x, y, angle)], int(rng.integers(2 * blocks))
    for number in range(blocks):
        for _ in range(20):
            if number == held:
                distance = rng.uniform(*HELD)
                aside = angle + rng.normal(0, 0.1)
                place = x - distance * math.sin(aside), y + distance * math.cos(aside)
            elif number and rng.random() < 0.4:
                base, turn = poses[1 + int(rng.integers(number))], rng.uniform(0, 2 * math.pi)
                distance = rng.uniform(*TOUCHING)
                place = base[0] + distance * math.cos(turn), base[1] + distance * math.sin(turn)
            else:
                place = tuple(rng.uniform(-REACH[False], REACH[False], 2).tolist())
            if max(map(abs, place)) <= REACH[False] and _free(place, poses):
                poses.append((float(place[0]), float(place[1]), float(rng.uniform(-math.pi, math.pi))))
                break
        else:
            return None
    return poses


def _free(place: Sequence[float], poses: Sequence[Pose]) -> bool:
    """Whether a place overlaps neither the robot, the first of the poses, nor a block."""
    gaps = [math.dist(place, pose[:2]) for pose in poses]
    return gaps[0] >= HELD[0] and min(gaps[1:], default=math.inf) >= TOUCHING[0]
