"""Plans of tasks: subgoals and their target places. Pure geometry, without a simulator.

A plan says which block should go where; experts find the actions for it. It is part of a task (`TaskSpec.plan`).
"""

from __future__ import annotations

from magical_mj.tasks.planning.subgoals import (
    Noise,
    Subgoal,
    bring,
    drive,
    each_to,
    places_anywhere,
    places_inside,
    places_outside,
    scene_after,
)

__all__ = [
    "Noise",
    "Subgoal",
    "bring",
    "drive",
    "each_to",
    "places_anywhere",
    "places_inside",
    "places_outside",
    "scene_after",
]
