"""Symmetries of the arena: turned and mirrored scenes, with other colours and shapes, and the sentences for them.

An intent becomes another one in a changed scene: "to the left wall" becomes "to the top wall". So each demonstration
provides samples of many intents.
"""

from __future__ import annotations

import math
import re
import zlib
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from magical_mj.actions import ACTIONS, Turn
from magical_mj.learners.networks import COLOURS, SHAPES, blocks_of, regions_of
from magical_mj.observations import FINGERS
from magical_mj.scene.constants import COLOURS as COLOUR_NAMES
from magical_mj.scene.constants import SHAPES as SHAPE_NAMES

WORDS: Final = 1024
"""The number of word vectors. A word's number is its checksum modulo this, so no vocabulary has to be stored."""
LENGTH: Final = 64
"""The number of words of a sentence that are used. Later words are ignored."""
MIRRORED: Final = torch.tensor([a._replace(turn=Turn((0, 2, 1)[a.turn])).number for a in ACTIONS])
"""Action -> the action with left and right exchanged."""
_SIDES: Final[Mapping[str, tuple[int, int]]] = {"left": (-1, 0), "right": (1, 0), "top": (0, 1), "bottom": (0, -1)}


class Symmetry(NamedTuple):
    """n symmetries.

    Attributes:
        matrix: maps positions, shape (n, 2, 2).
        turn: the angle (rad) of the rotation, which follows the mirroring, shape (n,).
        mirrored: whether x is mirrored, shape (n,).
        colours: the new number of each colour, shape (n, 4).
        shapes: the new number of each shape.
    """

    matrix: Tensor
    turn: Tensor
    mirrored: Tensor
    colours: Tensor
    shapes: Tensor


def drawn(number: int, rng: np.random.Generator) -> Symmetry:
    """Random symmetries."""
    turn = rng.integers(4, size=number) * (math.pi / 2)
    mirrored = rng.random(number) < 0.5
    sin, cos = np.sin(turn).round(), np.cos(turn).round()
    sign = np.where(mirrored, -1.0, 1.0)
    matrix = np.stack([cos * sign, -sin, sin * sign, cos], 1).reshape(-1, 2, 2)
    order = [rng.permuted(np.tile(np.arange(len(names)), (number, 1)), axis=1) for names in (COLOUR_NAMES, SHAPE_NAMES)]
    return Symmetry(
        torch.from_numpy(matrix).float(),
        torch.from_numpy(turn).float(),
        torch.from_numpy(mirrored),
        *map(torch.from_numpy, order),
    )


def changed(states: Tensor, by: Symmetry) -> Tensor:
    """States (n, m, names), each of the n changed by its symmetry. Velocities are not changed."""
    states = states.clone()
    blocks, regions = blocks_of(states), regions_of(states)
    sign = torch.where(by.mirrored, -1.0, 1.0)[:, None]
    states[..., :2] = moved(states[..., :2], by)
    states[..., 2] = states[..., 2] * sign + by.turn[:, None]
    fingers = states[..., FINGERS]
    states[..., FINGERS] = torch.where(by.mirrored[:, None, None], -fingers.flip(-1), fingers)
    blocks[..., 1:3] = moved(blocks[..., 1:3], by) * blocks[..., :1]
    blocks[..., 3] = (blocks[..., 3] * sign[..., None] + by.turn[:, None, None]) * blocks[..., 0]
    one, other = moved(regions[..., 1:3], by), moved(regions[..., 3:5], by)
    regions[..., 1:5] = torch.cat([torch.minimum(one, other), torch.maximum(one, other)], -1)
    for rows, columns, order in (
        (blocks, SHAPES, by.shapes),
        (blocks, COLOURS, by.colours),
        (regions, slice(5, 9), by.colours),
    ):
        exchange = torch.nn.functional.one_hot(order, order.shape[1]).float()
        rows[..., columns] = torch.einsum("nmki,nij->nmkj", rows[..., columns], exchange)
    return states


def moved(positions: Tensor, by: Symmetry) -> Tensor:
    """Positions (n, ..., 2), changed."""
    return torch.einsum("nij,n...j->n...i", by.matrix, positions)


def words_of(sentence: str) -> NDArray[np.int64]:
    """The numbers of a sentence's words, shape (LENGTH,), 0 after the last one."""
    numbers = [number_of(word) for word in re.findall(r"\w+", sentence.lower())][:LENGTH]
    return np.array(numbers + [0] * (LENGTH - len(numbers)))


def number_of(word: str) -> int:
    """The number of a word."""
    return 1 + zlib.crc32(word.encode()) % (WORDS - 1)


def renamed(words: NDArray[np.int64], by: Symmetry) -> NDArray[np.int64]:
    """Sentences (n, LENGTH) with the words for the changed scenes."""
    names = {direction: name for name, direction in _SIDES.items()}
    result = words.copy()
    for row, (matrix, colours, shapes) in enumerate(zip(by.matrix, by.colours, by.shapes, strict=True)):
        pairs = {name: COLOUR_NAMES[colours[k]] for k, name in enumerate(COLOUR_NAMES)}
        for k, name in enumerate(SHAPE_NAMES):
            pairs |= {name: SHAPE_NAMES[shapes[k]], f"{name}s": f"{SHAPE_NAMES[shapes[k]]}s"}
        for name, direction in _SIDES.items():
            x, y = (matrix @ torch.tensor(direction).float()).round().int().tolist()
            pairs[name] = names[x, y]
        for old, new in pairs.items():
            result[row][words[row] == number_of(old)] = number_of(new)
    return result
