"""Trains `relational` with samples by hindsight, and plays it in scenes that no result is about.

    python -m research.hindsight FixColour [--seed 0] [--episodes 40] [--set relational.loss=0.15 ...]

Hindsight takes the place of `detours`, and the robot is displaced with its block. Prints what the demo scene said of
each assumption, and mean scores in Demo, Layout and All (docs/results.md). Two minutes of a quiet core.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping

import torch

from magical_mj.evaluation import evaluate
from magical_mj.learners import load_settings
from magical_mj.learners.assumptions import mirror, rename
from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.relational import NOISE, Relational
from magical_mj.learners.settings import TrainingSettings
from research.hindsight.displacement import displace
from research.hindsight.plays import demonstrated
from research.hindsight.samples import joined

SETTINGS: Mapping[str, object] = {
    "preset": "State",
    "relational.assumptions": "egocentric,mirror,rename,detours,displace",
    "relational.trial": 160,
    "relational.sharpness": 3.0,
    "relational.loss": 0.15,
}
SAMPLES, PLAYS = 30_000, 8
"""By hindsight; and plays of each demonstration, free and with each block that it moves."""


class Hindsight(Relational):
    """`relational` whose `detours` are samples by hindsight."""

    def __init__(self, settings: TrainingSettings) -> None:
        super().__init__(settings)
        (task,) = settings.tasks
        shown = shipped(task)
        chosen = [shown[i] for i in drawn(task, settings.seed, settings.demonstrations, len(shown))]
        self._shown, self._played = demonstrated(chosen, SAMPLES, PLAYS, settings.seed)

    def _draw_samples(self, assumed: list[str], size: int) -> tuple[torch.Tensor, torch.Tensor]:
        played = size // 2 if "detours" in assumed else 0
        parts = [
            source.of(torch.randint(len(source.way), (count,), generator=self._draw))
            for source, count in ((self._shown, size - played), (self._played, played))
        ]
        samples = joined(parts).of(torch.randperm(size, generator=self._draw))
        states, actions = samples.shown.states, samples.shown.actions
        if "displace" in assumed:
            displace(samples, self._draw)
        if "mirror" in assumed:
            actions = mirror(states, actions, self._draw)
        if "rename" in assumed:
            rename(states, self._draw)
        states[:, :3] += torch.randn((size, 3), generator=self._draw) * torch.tensor(NOISE)
        return states, actions


def main() -> None:
    """Trains and plays."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("task")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--episodes", type=int, default=40)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE")
    asked = parser.parse_args()
    torch.set_num_threads(1)
    changes = {**SETTINGS, **dict(change.split("=") for change in asked.set)}
    learner = Hindsight(load_settings("relational", asked.task, seed=asked.seed, device="cpu", **changes))
    for _ in range(learner.updates):
        learner.update()
    for trial in learner.get_state()["report"]:
        print(trial, flush=True)
    variants = "Demo,All" if asked.task == "MoveToCorner" else "Demo,Layout,All"
    frame = evaluate(
        learner.policy(), tasks=asked.task, variants=variants, preset="State", episodes=asked.episodes, split="dev"
    )
    print(asked.task, asked.seed, frame.groupby("variant")["score"].mean().round(3).to_dict())


if __name__ == "__main__":
    main()
