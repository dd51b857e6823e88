"""Practice for the skill: the experts' manoeuvres bring random objects to random places, in scenes of training intents.

The manoeuvres are tried in a copy of the simulation, and the best is performed. If a skill is given, it acts first,
so that the data contains the states that it leads to, with what the experts do there.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_intents.guide import Guide
from magical_intents.scenes import ROBOT
from magical_mj.engine import Engine
from magical_mj.experts.driving import Lookahead
from magical_mj.experts.manoeuvres import manoeuvres, obstacles, perform
from magical_mj.experts.navigation import EMPTY, cell_costs, explore
from magical_mj.intents import SETS
from magical_mj.intents.scenes import drawn_scene
from magical_mj.scene import Scene
from magical_mj.tasks.planning import APART, REACHABLE, Noise, Point, Subgoal
from magical_mj.utils import files

SCENES: Final = 12
"""The number of scenes in a file."""
BRINGS: Final = 8
"""The number of objects that are brought in a scene, one after the other."""
TRIES: Final = 3
"""The number of manoeuvres that are tried for each."""
LIMIT: Final = 90
"""The longest manoeuvre, in actions."""
DRIVES: Final = 0.15
"""The share of places that are for the robot."""
TOLERANCE: Final = {True: 0.03, False: 0.06}
"""The robot, or a block, has arrived if it is nearer to the place (units)."""
STIRRED: Final = 0.1
"""A manoeuvre that moves another block farther (units) is not used."""
FIRST_STEPS: Final = 60
"""The skill acts for at most this number of steps first."""
HELD: Final = 0.46
"""A block at most this far from the robot (units) may be between its fingers."""


Acts = Callable[[Tensor, Tensor, Tensor, Tensor], Tensor]
"""A skill."""


class Steps(NamedTuple):
    """The steps of bringing an object.

    Attributes:
        states: before each action, shape (steps, names).
        actions: numbers, shape (steps,).
        objects: the object, shape (steps,).
        places: where it arrived, shape (steps, 2).
        vias: the guide's points on the way, shape (steps, 2).
    """

    states: NDArray[np.float32]
    actions: NDArray[np.int64]
    objects: NDArray[np.int64]
    places: NDArray[np.float32]
    vias: NDArray[np.float32]


def kept(path: Path, make: Callable[[], Mapping[str, Any]]) -> dict[str, NDArray[Any]]:
    """The arrays in a file. If it does not exist, they are made and written."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = make()
        with files.new_file(path) as unfinished, unfinished.open("wb") as file:
            np.savez_compressed(file, **arrays)
    with np.load(path) as stored:
        return dict(stored)


def practised(folder: Path, number: int, skill: Acts | None = None) -> list[Steps]:
    """The steps of `number` files in a folder. Missing files are made."""
    found = []
    for index in range(number):
        arrays = kept(folder / f"{index}.npz", partial(_arrays, index, skill))
        cuts = np.cumsum(arrays["lengths"])[:-1]
        found += map(Steps, *(np.split(arrays[name], cuts) for name in Steps._fields))
    return found


def _arrays(number: int, skill: Acts | None) -> dict[str, Any]:
    """The arrays of a file: the steps, and the number of steps of each object."""
    rng = np.random.default_rng([number, skill is not None])
    every = [one for _ in range(SCENES) for one in brought(rng, skill)]
    steps = Steps(*map(np.concatenate, zip(*every, strict=True)))
    return {"lengths": [len(one.actions) for one in every], **steps._asdict()}


def brought(rng: np.random.Generator, skill: Acts | None) -> Iterator[Steps]:
    """Objects that are brought in a random scene."""
    with closing(Engine.of_scene(random_scene(rng))) as engine:
        for _ in range(BRINGS):
            subgoal = random_subgoal(engine.scene, rng)
            if skill is not None:
                _begin(engine, subgoal, skill, rng)
            before = engine.scene
            if actions := manoeuvre(engine, subgoal):
                states = []
                for action in actions:
                    states.append(engine.state_vector())
                    engine.step(action)
                if _succeeded(subgoal, before, engine.scene):
                    number, here = _number(subgoal), _position(engine.scene, subgoal.block)
                    guide = Guide(number, here)
                    yield Steps(
                        np.array(states, np.float32),
                        np.array(actions),
                        np.full(len(actions), number),
                        np.tile(np.array(here, np.float32), (len(actions), 1)),
                        np.array([guide(state) for state in states], np.float32),
                    )


def random_scene(rng: np.random.Generator) -> Scene:
    """A scene with the objects of a random training intent."""
    while True:
        if scene := drawn_scene(SETS["train"][int(rng.integers(len(SETS["train"])))], rng):
            return scene


def _begin(engine: Engine, subgoal: Subgoal, skill: Acts, rng: np.random.Generator) -> None:
    """Lets the skill act until it does not hold the block."""
    number, guide = _number(subgoal), Guide(_number(subgoal), subgoal.target)
    place, steps = torch.tensor([subgoal.target], dtype=torch.float32), int(rng.integers(FIRST_STEPS))
    for step in range(2 * FIRST_STEPS):
        here = _position(engine.scene, subgoal.block)
        if step >= steps and (subgoal.block is None or math.dist(here, engine.scene.robot.pose[:2]) > HELD):
            break
        with torch.inference_mode():
            state = engine.state_vector()
            logits = skill(torch.from_numpy(state)[None], torch.tensor([number]), place, torch.tensor([guide(state)]))
        shares = logits[0].double().softmax(0).numpy()
        engine.step(int(rng.choice(len(shares), p=shares / shares.sum())))


def random_subgoal(scene: Scene, rng: np.random.Generator) -> Subgoal:
    """Some object, and a random free place: anywhere, next to a block, or at a wall."""
    block = None if rng.random() < DRIVES else int(rng.integers(len(scene.blocks)))
    others = [one.pose[:2] for number, one in enumerate(scene.blocks) if number != block]
    apart = APART if block is not None else 0.34
    while True:
        x, y = rng.uniform(-REACHABLE, REACHABLE, 2).tolist()
        kind = rng.integers(3)
        if kind == 1 and others:
            (x, y), angle = others[int(rng.integers(len(others)))], rng.uniform(0, 2 * math.pi)
            distance = rng.uniform(apart, 0.42)
            x, y = x + distance * math.cos(angle), y + distance * math.sin(angle)
        elif kind == 2:
            side = REACHABLE if rng.random() < 0.5 else -REACHABLE
            x, y = (side, y) if rng.random() < 0.5 else (x, side)
        if block is None:
            x, y = 0.93 * x, 0.93 * y
        if max(abs(x), abs(y)) <= REACHABLE and all(math.dist((x, y), other) >= apart for other in others):
            return Subgoal(block, (x, y), TOLERANCE[block is None])


def manoeuvre(engine: Engine, subgoal: Subgoal) -> list[int]:
    """The actions of the most promising manoeuvre that reaches a subgoal; empty if the first few do not."""
    scene, ahead = engine.scene, Lookahead(engine)
    here, costs = ahead.state, cell_costs(obstacles(scene), EMPTY)
    tree = explore(scene.robot.pose, costs, LIMIT)
    options = manoeuvres(tree, costs, scene, subgoal, Noise(np.random.default_rng(0), 0.0), ahead.body)
    for option in sorted(options, key=lambda option: option.estimate)[:TRIES]:
        ahead.restore(here)
        perform(ahead, option, LIMIT)
        if _succeeded(subgoal, scene, ahead.scene()):
            return list(ahead.trace)
    return []


def _succeeded(subgoal: Subgoal, before: Scene, after: Scene) -> bool:
    pairs = zip(before.blocks, after.blocks, strict=True)
    moved = [math.dist(one.pose[:2], two.pose[:2]) for one, two in pairs]
    if subgoal.block is not None:
        moved[subgoal.block] = 0.0
    return subgoal.left(after) == 0.0 and max(moved, default=0.0) <= STIRRED


def _position(scene: Scene, block: int | None) -> Point:
    return (scene.robot if block is None else scene.blocks[block]).pose[:2]


def _number(subgoal: Subgoal) -> int:
    return ROBOT if subgoal.block is None else subgoal.block
