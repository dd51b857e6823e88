"""An encoder that learns from episodes of any policy which action leads from one observation to the next.

    magical-mj demos rollouts --policy random --variants all --steps 240 --out runs/episodes
    rm runs/episodes/FixColour-*    # if its policies shall be tested there
    python -m tools.research.inverse_dynamics runs/episodes --out runs/encoder.safetensors
    magical-mj train bc --tasks FixColour --quick --set bc.encoder=runs/encoder.safetensors --out runs/fixed

Both stacks of frames have the same augmentation. The logits of the action are linear in the difference of their
features. With `--batches 0`, the encoder is random apart from batch norm's averages. The pictures of 1,000 steps take
110 MB of memory.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import pandas as pd
import torch
from torch import Tensor, nn

from magical_mj import TASKS
from magical_mj.demos import Demonstration, load
from magical_mj.learners import TrainingSettings, load_settings
from magical_mj.learners.bc import BehaviouralCloning, successive, usable
from magical_mj.learners.encoder import Encoder, save_encoder
from magical_mj.learners.networks import Torso
from magical_mj.utils.errors import DemonstrationError
from magical_mj.variants import VARIANTS


class InverseDynamics(BehaviouralCloning):
    """Predicts actions from the observations before and after them. No-ops are left out."""

    drop_noop = False

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss of a new batch, the logits (n, 18), and the actions (n,)."""
        numbers = [usable(self._data, task) for task in range(len(self.settings.tasks))]
        batch, following = successive(self._data, numbers, self.settings.bc.batch_size, self._draw)
        pairs = self._augmented(torch.cat([batch.observations, following], 3), self._noise)
        before, after = self._actor.torso(torch.cat(pairs.chunk(2, 1))).chunk(2)  # with the same batch norm
        actions, tasks = (values.to(self.device) for values in batch[1:])
        logits = self._actor.head(after - before, tasks)
        return nn.functional.cross_entropy(logits, actions), logits, actions, {}


def episodes_in(folder: Path) -> dict[str, list[Demonstration]]:
    """Task -> its episodes in a folder, for the tasks that have some."""
    found: dict[str, list[Demonstration]] = {}
    for task in TASKS:
        try:
            found[task] = load(task, folder)
        except DemonstrationError:
            if any(folder.rglob(f"{task}-*.npz")):
                raise
    return found


def learnt(episodes: Mapping[str, Sequence[Demonstration]], batches: int, seed: int, *, quick: bool) -> Encoder:
    """The encoder after this number of batches. Prints how well the network predicted actions in the last tenth."""
    settings: TrainingSettings = load_settings(
        "bc", tuple(episodes), quick=quick, seed=seed, **{"bc.batches": max(1, batches), "bc.heads": "uniform"}
    )
    learner = InverseDynamics(settings, episodes)
    metrics = pd.DataFrame([learner.update() for _ in range(batches)])
    if batches:
        print(metrics.tail(max(1, batches // 10)).mean().round(3).to_dict())
    learner.recalibrate()
    played = ",".join(sorted({demo.variant for found in episodes.values() for demo in found}, key=list(VARIANTS).index))
    weights = cast("Torso", learner.actor.torso).convolutions.state_dict()
    return Encoder(weights, tuple(episodes), played, demonstration_set=0)


def main(arguments: Sequence[str] | None = None) -> None:
    """Writes the encoder. By default, the arguments are those of the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("episodes", type=Path, help="a folder by magical-mj demos rollouts")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--batches", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--paper", action="store_true", help="the paper's network instead of the quick one")
    options = parser.parse_args(arguments)
    if options.out.exists():
        parser.error(f"{options.out} exists already; give another path, or remove it first")
    torch.set_num_threads(1)
    found = episodes_in(options.episodes)
    if not found:
        parser.error(f"{options.episodes} contains no episodes of {', '.join(TASKS)}")
    save_encoder(options.out, learnt(found, options.batches, options.seed, quick=not options.paper))


if __name__ == "__main__":
    main()
