"""Bounds for imitation from states: memory, corrections, and demonstrations of the test variant.

- `Replay` plays the actions of a demonstration and ignores the scene. It shows what memory alone scores.
- The oracle clones demonstrations that the expert makes in other scenes of a test variant (`split="dev"`). It shows
  what the network of behavioural cloning scores with the right data. No method of the benchmark may see these scenes.
- `dagger` may ask the expert while it learns (Kelly et al. 2019, HG-DAgger, arXiv:1810.02890, with a random step
  instead of a person's choice). It sees the demo scene only. In each episode the policy acts up to a random step, and
  the expert acts from there. The expert's part is added to the ten demonstrations.

    $ magical-mj evaluate --policy replay=tools.bounds:Replay --out runs/replay
    $ python tools/bounds.py oracle MoveToRegion Layout --out scores/oracle
    $ python tools/bounds.py dagger MoveToRegion --out scores/dagger-MoveToRegion
"""

from __future__ import annotations

import argparse
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from magical_mj import Engine, demos, evaluate
from magical_mj.actions import NOOP
from magical_mj.demos import Transitions
from magical_mj.demos.recording import demonstrate
from magical_mj.experts import Expert
from magical_mj.learners import clone, load_settings
from magical_mj.learners.data import drawn
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.policies.interface import Episode, begin
from magical_mj.tasks.registry import SPLITS, task_spec

DEMONSTRATIONS = 25
ROUNDS, CORRECTIONS = 3, 20
"""How often `dagger` trains and corrects a policy, and in how many episodes each time."""


class Replay:
    """Plays one of a task's 25 demonstrations without looking, and then does nothing. The seed chooses which one."""

    uses_observations = False

    def reset(self, episode: Episode) -> None:
        """Chooses the episode's demonstration."""
        shown = known(episode.task)
        self._actions = iter(shown[episode.seed % len(shown)])

    def __call__(self, _: Any) -> int:
        """The next action of the demonstration."""
        return next(self._actions, NOOP)


@cache
def known(task: str) -> list[list[int]]:
    """The actions of each of a task's demonstrations."""
    return [demonstration.actions.tolist() for demonstration in demos.load(task)]


def oracle(task: str, variant: str, out: Path) -> float:
    """The mean score in a variant of a policy cloned from demonstrations in other scenes of that variant."""
    shown = [demonstrate(task, variant, SPLITS["dev"] + number) for number in range(DEMONSTRATIONS)]
    policy = cloned(task, shown)
    frame = evaluate({"Oracle": policy}, tasks=task, variants=variant, preset="State", jobs=1, out=out)
    return float(frame["score"].mean())


def cloned(task: str, shown: list[Any]) -> TrainedPolicy:
    """A policy trained on all of these demonstrations."""
    return clone(load_settings("bc", task, preset="State", device="cpu", demonstrations=len(shown)), {task: shown})


def dagger(task: str, out: Path) -> float:
    """The mean score over all variants of a policy that the expert corrected in the demo scene."""
    shown = demos.load(task)
    data: list[Any] = [shown[number] for number in drawn(task, 0, 10, len(shown))]
    for number in range(ROUNDS):
        policy, first = cloned(task, data), SPLITS["dev"] + number * CORRECTIONS
        data += [corrected(task, policy, seed) for seed in range(first, first + CORRECTIONS)]
    policy = cloned(task, data)
    frame = evaluate({"DAgger": policy}, tasks=task, preset="State", episodes=50, jobs=1, out=out)
    print(frame.groupby("variant", observed=True)["score"].mean().round(2).to_dict())
    return float(frame["score"].mean())


def corrected(task: str, policy: TrainedPolicy, seed: int) -> Transitions:
    """An episode of the demo scene that the policy begins and the expert ends.

    The policy's own actions are stored as no-ops, which cloning leaves out.
    """
    with closing(Engine(task, "Demo", seed=seed)) as engine:
        begin(policy, episode := Episode(task, "Demo", seed))
        taken_over = episode.rng().integers(task_spec(task).horizon())
        states, actions, over, expert = [], [], False, Expert(engine, task, seed)
        while not over:
            states.append(engine.state_vector())
            learning = len(actions) >= taken_over
            action = expert() if learning else policy(states[-1])
            actions.append(action if learning else NOOP)
            over = engine.step(action)
    return Transitions(np.array(states), np.array(actions))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bound", choices=["oracle", "dagger"])
    parser.add_argument("task")
    parser.add_argument("variant", nargs="?", default="Layout", help="the oracle's test variant")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    if given.bound == "oracle":
        print(given.task, given.variant, f"{oracle(given.task, given.variant, given.out):.2f}")
    else:
        print(given.task, f"{dagger(given.task, given.out):.2f}")
