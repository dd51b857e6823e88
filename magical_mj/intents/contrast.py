"""Several demo scenes of an intent: drawn like test scenes, or chosen to refute other readings."""

from __future__ import annotations

from itertools import compress
from typing import Final

import numpy as np

from magical_mj.intents.ambiguity import Judge, rivals
from magical_mj.intents.intent import Intent
from magical_mj.intents.plans import planned
from magical_mj.intents.scenes import ALL_RULES, colours_rule, demo_scene, redrawn
from magical_mj.scene import Scene

BITS: Final = 22.0
"""The longest rivals that scenes are chosen to refute."""
SIMPLEST: Final = 500
"""The number of the simplest remaining rivals that count in a choice."""
CANDIDATES: Final = 12
"""The number of scenes that are compared for each choice."""


def demo_scenes(intent: Intent, rng: np.random.Generator, number: int, *, contrasting: bool) -> tuple[Scene, ...]:
    """Demo scenes of an intent. The first does not depend on the number; the others are `further_scenes`.

    Raises:
        IntentError: if no scene was found.
    """
    first = demo_scene(intent, rng)
    return (first, *further_scenes(intent, rng, first, number - 1, contrasting=contrasting))


def further_scenes(
    intent: Intent, rng: np.random.Generator, first: Scene, number: int, *, contrasting: bool
) -> list[Scene]:
    """Demo scenes after the first one, with other colours and poses.

    If `contrasting`, they also have other shapes and counts, and each is the one of `CANDIDATES` that refutes most of
    the simplest rivals which the scenes before leave.
    """
    if not contrasting:
        return [redrawn(intent, rng, first, colours_rule) for _ in range(number)]
    scenes, left = list[Scene](), rivals([planned(intent, first)], BITS) if number else []
    while len(scenes) < number:
        candidates = [redrawn(intent, rng, first, *ALL_RULES) for _ in range(CANDIDATES)]
        judge = Judge(left)
        reached = [judge.reached(*planned(intent, scene)) for scene in candidates]
        best = int(np.argmin([flags[:SIMPLEST].sum() for flags in reached]))
        left = list(compress(left, reached[best]))
        scenes.append(candidates[best])
    return scenes
