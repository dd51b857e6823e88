"""What the scores of the state track can be compared with: replaying a demonstration, and demonstrations of the test.

- `Replay` plays the actions of a demonstration, whatever happens: what memory alone does.
- The oracle clones demonstrations that the expert makes in other scenes of a test variant (`split="dev"`): what the
  network of behavioural cloning can do with the right data. It uses scenes that no method of the benchmark may see.

    $ magical-mj evaluate --policy Replay=tools.bounds:Replay --preset State --episodes 20 --out scores/replay
    $ python tools/bounds.py MoveToRegion Layout --out scores/oracle
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from magical_mj import evaluate
from magical_mj.demos.recording import demonstrate
from magical_mj.learners import clone, load_settings
from magical_mj.learners.data import drawn, shipped
from magical_mj.policies.interface import Episode
from magical_mj.scene.actions import NOOP
from magical_mj.tasks.registry import SPLITS

DEMONSTRATIONS = 25


class Replay:
    """Plays one of 10 demonstrations, and then nothing. All begin in the demo scene: none is nearer than others."""

    preset = "State"

    def reset(self, episode: Episode) -> None:
        """An episode begins, for which one is drawn."""
        shown = shipped(episode.task)
        chosen = episode.rng().choice(drawn(episode.task, episode.run, 10, len(shown)))
        self._actions = iter(shown[chosen].actions.tolist())

    def __call__(self, state: NDArray[Any]) -> int:
        """The next action of the demonstration."""
        del state
        return next(self._actions, NOOP)


def oracle(task: str, variant: str, out: Path) -> float:
    """The mean score in a variant of a policy that was cloned from demonstrations of other scenes of it."""
    shown = [demonstrate(task, variant, SPLITS["dev"] + number) for number in range(DEMONSTRATIONS)]
    settings = load_settings("bc", task, preset="State", device="cpu", demonstrations=DEMONSTRATIONS)
    policy = clone(settings, {task: shown})
    frame = evaluate({"Oracle": policy}, tasks=task, variants=variant, preset="State", jobs=1, out=out)
    return float(frame["score"].mean())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task")
    parser.add_argument("variant")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    print(given.task, given.variant, f"{oracle(given.task, given.variant, given.out):.2f}")
