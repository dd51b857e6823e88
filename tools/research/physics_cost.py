"""Prints the cost and the errors of other settings of MuJoCo's solver.

    python tools/research/physics_cost.py

Costs are milliseconds per action with ten blocks: apart, at rest in a heap, and in a heap that the robot pushes. Each
action is timed `REPEATS` times, and the fastest counts, because other programs can only slow it down.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np
import rollouts
from rollouts import Rollouts, family_errors, recordings

from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene.constants import SHAPES

PROBES: Final = Path(__file__).parent.parent / "tests" / "data" / "probes.npz"
REPEATS: Final = 20
EDITS: Final[dict[str, tuple[str, str]]] = {
    "as it is": ("", ""),
    "dense matrices": ('jacobian="sparse"', 'jacobian="dense"'),
    "mid-phase": ('midphase="disable"', ""),
    "nothing sleeps": (' sleep="enable"', ""),
    "one island, nothing sleeps": ('sleep="enable"', 'island="disable"'),
    "at most 5 iterations": ('iterations="20"', 'iterations="5"'),
    "at most 2 iterations": ('iterations="20"', 'iterations="2"'),
    "tolerance 1e-4": ('tolerance="1e-08"', 'tolerance="1e-4"'),
    "pyramidal cones": ('cone="elliptic"', 'cone="pyramidal"'),
    "CG": ('solver="Newton"', 'solver="CG"'),
    "PGS, 10 iterations": ('solver="Newton" jacobian="sparse" iterations="20"', 'solver="PGS" iterations="10"'),
}
"""Name -> (old, new) text in the model."""


def ten(positions: Sequence[tuple[float, float]], turn: float) -> Scene:
    """A scene with ten blocks, and the robot below. Each block is rotated by `turn` (rad) more than the one before."""
    blocks = (Block(SHAPES[i % 4], "red", x, y, turn * i) for i, (x, y) in enumerate(positions))
    return Scene(Robot(0.0, -0.55, 0.0), tuple(blocks))


APART: Final = ten([(0.4 * column - 0.8, 0.8 - 0.4 * row) for row in range(2) for column in range(5)], 0.0)
HEAP: Final = ten([(0.26 * (k - row / 2), 0.235 * row - 0.1) for row in range(4) for k in range(row + 1)], 0.3)
REST: Final = (0,) * 15
PUSH: Final = (10,) * 6 + (4,) * 6 + (10,) * 12 + (13,) * 6


def cost(scene: Scene, actions: Sequence[int]) -> tuple[float, float]:
    """Milliseconds per action, and the mean number of contacts, including those of feet and wheels with the floor."""
    world, times, contacts = Rollouts(scene), np.full((REPEATS, len(actions)), np.inf), 0
    for repeat in range(REPEATS):
        world.roll(())
        for step, action in enumerate(actions):
            start = time.perf_counter()
            world.act(action)
            times[repeat, step] = time.perf_counter() - start
            contacts += world.data.ncon
    return 1000 * times.min(axis=0).mean(), contacts / times.size


def main() -> None:
    """Prints the tables."""
    cases = recordings(PROBES)
    print("| solver | apart | at rest | pushed | " + " | ".join(rollouts.AIMS) + " |")
    print("| --- |" + " --- |" * (3 + len(rollouts.AIMS)))
    for name, (old, new) in EDITS.items():
        if old not in scene_mjcf(HEAP):
            raise ValueError(f"the model no longer contains {old!r}, which {name!r} must replace")
        rollouts.scene_mjcf = lambda *args, old=old, new=new, **more: scene_mjcf(*args, **more).replace(old, new, 1)
        costs = [f"{cost(*case)[0]:.2f}" for case in ((APART, REST), (HEAP, REST), (HEAP, PUSH))]
        errors = [f"{mean:.3f} / {end:.3f}" for mean, end, _ in family_errors(cases).values()]
        print(f"| {name} | {' | '.join(costs + errors)} |", flush=True)
    rollouts.scene_mjcf = scene_mjcf
    print("contacts:", [round(cost(*case)[1], 1) for case in ((APART, REST), (HEAP, REST), (HEAP, PUSH))])


if __name__ == "__main__":
    main()
