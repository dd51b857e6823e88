"""Cues: what the final scenes of a question show without an understanding of the intent.

A cue prefers some of the options, such as those with the most moved blocks. If the right option were preferred
more often than by chance, answers by this cue would be right more often than by chance. So the wrong options of each
question are selected such that each cue prefers the right one with a probability of a quarter.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.intents.ambiguity import Ends
from magical_mj.intents.readings import READINGS, DemonstratedBlocks, moved_blocks, readings
from magical_mj.intents.relations import STAYED
from magical_mj.scene import Block, Scene

CUES: Final = ("most moved", "fewest moved", *READINGS, "same ends", "most typical", "least typical")
"""The blocks that a cue looks for: many moved ones, few, those of a reading, those that end where the demonstrated ones
do; or the option itself, which differs from the others in few blocks, or in many."""
FAR: Final = 3.0
"""The distance (world units) of the demonstrated ends if no block has moved."""
_Array = NDArray[np.float64]


def preferences(cue: str, demonstrations: Sequence[Ends], scene: Scene, ends: Sequence[Scene]) -> _Array:
    """How much a cue prefers each of the final scenes, shape (ends,). It chooses the greatest."""
    if cue in ("most typical", "least typical"):
        differences = different_blocks(ends).sum(axis=1)
        return differences if cue == "least typical" else -differences
    return alone(cue, demonstrations, scene, ends)


def alone(cue: str, demonstrations: Sequence[Ends], scene: Scene, ends: Sequence[Scene]) -> _Array:
    """The same for cues that look at each final scene by itself."""
    moved = [frozenset(moved_blocks(scene, end)) for end in ends]
    if cue in ("most moved", "fewest moved"):
        counts = np.array([float(len(blocks)) for blocks in moved])
        return counts if cue == "most moved" else -counts
    demonstrated = DemonstratedBlocks.of(demonstrations[:1])
    if cue == "same ends":
        final = demonstrations[0][1]
        targets = [final.blocks[index] for index in demonstrated.moved]
        return np.array(
            [-_distance(targets, [end.blocks[i] for i in blocks]) for end, blocks in zip(ends, moved, strict=True)]
        )
    wanted = readings(demonstrated, scene)[cue]
    return np.array([float(len(blocks & wanted) - len(blocks - wanted)) for blocks in moved])


def by_words(sentence: str, scene: Scene, ends: Sequence[Scene]) -> _Array:
    """How much the words of a sentence prefer each final scene, shape (ends,): moved blocks that they name.

    A block is named if the words contain its colour or shape.
    """
    words = set(re.findall(r"[a-z]+?(?=s?\b)", sentence.lower()))
    named = {index for index, block in enumerate(scene.blocks) if {block.colour, block.shape} & words}
    moved = [set(moved_blocks(scene, end)) for end in ends]
    return np.array([float(len(blocks & named) - len(blocks - named)) for blocks in moved])


def different_blocks(ends: Sequence[Scene]) -> _Array:
    """The number of blocks with other positions in each two of the final scenes, shape (ends, ends)."""
    places = np.array([[(block.x, block.y) for block in end.blocks] for end in ends]).reshape(len(ends), -1, 2)
    gaps = np.linalg.norm(places[:, None] - places[None], axis=-1)
    return (gaps > STAYED).sum(axis=-1).astype(float)


def success(values: _Array) -> _Array:
    """The probability that a cue chooses the first option, whose rivals are the others: shape (...,).

    Args:
        values: its preferences, shape (..., options). It chooses one of the greatest at random.
    """
    best = values == values.max(axis=-1, keepdims=True)
    return best[..., 0] / best.sum(axis=-1)


def _distance(targets: Sequence[Block], blocks: Sequence[Block]) -> float:
    """The sum of the distances from each target to the nearest block."""
    return sum(min((math.dist(a.pose[:2], b.pose[:2]) for b in blocks), default=FAR) for a in targets)
