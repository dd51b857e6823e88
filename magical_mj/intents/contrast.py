"""Scenes that refute rivals of an intent: several demo scenes, and the test scenes of the variant Diagnose.

Demo scenes are drawn like test scenes, or chosen to refute other readings.

In scenes of Diagnose, a policy that pursues a rival of the intent does not satisfy the intent. The rivals are the
simplest ones that are consistent with the first demo scene. Each scene is verified with a plan of the rival: its end
satisfies the rival, but not the intent.
"""

from __future__ import annotations

from collections.abc import Callable, Container
from functools import lru_cache
from itertools import compress, islice
from typing import Final

import numpy as np

from magical_mj.intents.ambiguity import Judge, rivals
from magical_mj.intents.intent import Intent
from magical_mj.intents.plans import planned, solved
from magical_mj.intents.scenes import ALL_RULES, colours_rule, redrawn
from magical_mj.scene import Scene

CHOICE_BITS: Final = 22.0
"""The longest rivals that demo scenes are chosen to refute, in bits."""
SIMPLEST: Final = 500
"""The number of the simplest remaining rivals that count in a choice."""
CANDIDATES: Final = 12
"""The number of scenes that are compared for each choice."""
DIAGNOSED_BITS: Final = 24.0
"""The longest rivals of Diagnose, in bits."""
RIVALS: Final = 10
"""The number of rivals of Diagnose."""
CHECKED: Final = 60
"""The rivals of Diagnose are among this number of the simplest ones. There are fewer if scenes refute fewer."""
SCENES: Final = 10
"""The number of scenes that show whether a rival can be refuted."""
DRAWS: Final = 100
"""The number of scenes that are drawn for a rival before another one is tried."""


def random_scene(intent: Intent, rng: np.random.Generator, first: Scene) -> Scene:
    """A further demo scene, with other colours and poses."""
    return redrawn(intent, rng, first, colours_rule)


def contrasting_scenes(
    intent: Intent,
    rng_of: Callable[[int, int], np.random.Generator],
    first: Scene,
    number: int,
    left_out: Container[str] = (),
) -> list[Scene]:
    """The contrasting demo scenes after the first one, with other colours, poses, shapes and counts.

    Each is the candidate that refutes the most of the simplest rivals that the earlier scenes have not refuted.

    Args:
        intent: the intent.
        rng_of: the random generator of each candidate, by the number of the scene and that of the candidate.
        first: the first demo scene.
        number: the number of further scenes.
        left_out: the digests of scenes that are not chosen.
    """
    chosen, left = list[Scene](), rivals([planned(intent, first)], CHOICE_BITS)
    while len(chosen) < number:
        rngs = (rng_of(len(chosen), each) for each in range(CANDIDATES))
        scenes = (redrawn(intent, rng, first, *ALL_RULES) for rng in rngs)
        candidates = [scene for scene in scenes if scene.digest() not in left_out]
        judge = Judge(left)
        reached = [judge.reached(*planned(intent, scene)) for scene in candidates]
        best = int(np.argmin([flags[:SIMPLEST].sum() for flags in reached]))
        chosen.append(candidates[best])
        left = list(compress(left, reached[best]))
    return chosen


def diagnosis(intent: Intent, rng: np.random.Generator, demo: Scene, seed: int) -> Scene:
    """A scene that refutes one of the simplest rivals, which the seed selects. Without rivals, any scene.

    Args:
        intent: the intent.
        rng: the random generator.
        demo: the first demo scene, perhaps with another body of the robot.
        seed: selects the rival. If no scene is found for it, the next one is tried.
    """
    simplest = simplest_rivals(intent, demo)
    for number in range(len(simplest)):
        rival = simplest[(seed + number) % len(simplest)]
        for _ in range(DRAWS):
            scene = redrawn(intent, rng, demo, *ALL_RULES)
            if refutes(intent, rival, scene):
                return scene
    return redrawn(intent, rng, demo, *ALL_RULES)


@lru_cache(maxsize=512)
def simplest_rivals(intent: Intent, demo: Scene) -> tuple[Intent, ...]:
    """The simplest rivals that are consistent with a demonstration in the demo scene, and that scenes can refute."""
    rng = np.random.Generator(np.random.PCG64(0))
    scenes = [redrawn(intent, rng, demo, *ALL_RULES) for _ in range(SCENES)]
    found = rivals([planned(intent, demo)], DIAGNOSED_BITS)[:CHECKED]
    refuted = (rival for rival in found if any(refutes(intent, rival, scene) for scene in scenes))
    return tuple(islice(refuted, RIVALS))


def refutes(intent: Intent, rival: Intent, scene: Scene) -> bool:
    """Whether a plan of the rival satisfies it in a scene, but not the intent."""
    if not rival.grounded(scene) or rival.holds(scene, scene):
        return False
    end = solved(rival, scene)
    return end is not None and not intent.holds(scene, end)
