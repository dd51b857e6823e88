"""Reference scores for the state track: memory, corrections by the expert, and demonstrations of test variants.

- `Replay` plays the actions of a demonstration and ignores observations. It shows what memory alone achieves.
- The oracle clones demonstrations of the expert in other scenes of a test variant (`split="dev"`). It shows what the
  network of behavioural cloning achieves with the right data. No method of the benchmark may see these scenes.
- `dagger` may query the expert during learning. In the demo scene, the only one that it sees, the policy acts up to a
  random step. Then the expert finishes the episode (Kelly et al. 2019, HG-DAgger, arXiv:1810.02890, with a random step
  instead of a person's choice). The expert's part is added to the ten demonstrations.

    $ magical-mj evaluate --policy Replay=tools.bounds:Replay --preset State --episodes 20 --out scores/replay
    $ python tools/bounds.py oracle MoveToRegion Layout --out scores/oracle
    $ python tools/bounds.py dagger MoveToRegion --out scores/dagger-MoveToRegion
"""

from __future__ import annotations

import argparse
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from magical_mj import Engine, evaluate
from magical_mj.demos import Transitions
from magical_mj.demos.recording import demonstrate
from magical_mj.learners import clone, load_settings
from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.policies.expert import Expert
from magical_mj.policies.interface import Episode, begin
from magical_mj.scene.actions import NOOP
from magical_mj.tasks.registry import SPLITS, task_spec

DEMONSTRATIONS = 25
ROUNDS, CORRECTIONS = 3, 20
"""`dagger`: the number of rounds of training and correction, and the number of corrected episodes in each round."""


class Replay:
    """Plays one of 10 demonstrations, then no-ops. It is chosen at random, since all begin in the demo scene."""

    preset = "State"

    def reset(self, episode: Episode) -> None:
        """Starts an episode and draws its demonstration."""
        shown = shipped(episode.task)
        chosen = episode.rng().choice(drawn(episode.task, episode.run, 10, len(shown)))
        self._actions = iter(shown[chosen].actions.tolist())

    def __call__(self, state: NDArray[Any]) -> int:
        """The next action of the demonstration."""
        del state
        return next(self._actions, NOOP)


def oracle(task: str, variant: str, out: Path) -> float:
    """The mean score in a variant of a policy that was cloned from demonstrations in other scenes of that variant."""
    shown = [demonstrate(task, variant, SPLITS["dev"] + number) for number in range(DEMONSTRATIONS)]
    policy = cloned(task, shown)
    frame = evaluate({"Oracle": policy}, tasks=task, variants=variant, preset="State", jobs=1, out=out)
    return float(frame["score"].mean())


def cloned(task: str, shown: list[Any]) -> TrainedPolicy:
    """A policy that was trained by behavioural cloning on all of these demonstrations."""
    return clone(load_settings("bc", task, preset="State", device="cpu", demonstrations=len(shown)), {task: shown})


def dagger(task: str, out: Path) -> float:
    """The mean score in all variants of a policy that was trained with corrections in the demo scene."""
    shown = shipped(task)
    data: list[Any] = [shown[number] for number in drawn(task, 0, 10, len(shown))]
    for number in range(ROUNDS):
        policy, first = cloned(task, data), SPLITS["dev"] + number * CORRECTIONS
        data += [corrected(task, policy, seed) for seed in range(first, first + CORRECTIONS)]
    policy = cloned(task, data)
    frame = evaluate({"DAgger": policy}, tasks=task, preset="State", episodes=50, jobs=1, out=out)
    print(frame.groupby("variant", observed=True)["score"].mean().round(2).to_dict())
    return float(frame["score"].mean())


def corrected(task: str, policy: TrainedPolicy, seed: int) -> Transitions:
    """An episode in the demo scene. The policy begins it, recorded as no-ops, and the expert finishes it."""
    with closing(Engine(task, "Demo", seed=seed)) as engine:
        begin(policy, episode := Episode(task, "Demo", seed))
        taken_over = episode.rng().integers(task_spec(task).horizon())
        states, actions, over, expert = [], [], False, Expert(engine, task, seed)
        while not over:
            states.append(engine.state_vector())
            learning = len(actions) >= taken_over
            action = expert() if learning else policy(states[-1])
            actions.append(action if learning else NOOP)  # cloning leaves out no-ops
            over = engine.step(action)
    return Transitions(np.array(states), np.array(actions))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bound", choices=["oracle", "dagger"])
    parser.add_argument("task")
    parser.add_argument("variant", nargs="?", default="Layout", help="the oracle's variant")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if given.bound == "oracle":
        print(given.task, given.variant, f"{oracle(given.task, given.variant, given.out):.2f}")
    else:
        print(given.task, f"{dagger(given.task, given.out):.2f}")
