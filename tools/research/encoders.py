"""Encoders that learn from episodes of any policy how actions change observations.

    magical-mj demos rollouts --policy random --variants all --steps 240 --out runs/episodes
    python -m tools.research.encoders runs/episodes --without FixColour --objective next --out runs/next.safetensors
    magical-mj train bc --tasks FixColour --quick --set bc.encoder=runs/next.safetensors --out runs/fixed

The objectives:

- inverse: the action between two observations. Its logits are linear in the difference of their features;
- next: the next frame, averaged to 24 x 24 pixels. It is decoded from the product of the convolutions' output with a
  vector of the action (after Oh et al. 2015, arXiv:1507.08750). The accuracy says how often the prediction for the
  action that was taken is the best of all actions', and `explained` which part of the frame's change is predicted: 0
  for the last frame as the prediction, 1 without error.

All frames have the same augmentation. With `--batches 0`, the encoder is random apart from batch norm's averages. The
pictures of 1,000 steps take 110 MB of memory. A file next to the encoder, here runs/next.json, describes its training.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, cast

import pandas as pd
import torch
from torch import Tensor, nn

from magical_mj import TASKS
from magical_mj.actions import ACTIONS
from magical_mj.demos import Demonstration, load, stored
from magical_mj.learners import TrainingSettings, load_settings
from magical_mj.learners.bc import BehaviouralCloning, successive, usable
from magical_mj.learners.data import Demonstrations
from magical_mj.learners.encoder import Encoder, save_encoder
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import Torso
from magical_mj.utils.errors import DemonstrationError
from magical_mj.variants import VARIANTS

FRAME: Final = 3
"""The number of channels of a frame."""
POOLED: Final = 24
"""The side of the pictures that "next" predicts, in pixels."""
COMPARED: Final = 4
"""For the accuracy, "next" predicts the frames after all 18 actions for this number of samples of each batch."""


class InverseDynamics(BehaviouralCloning):
    """Predicts actions from the observations before and after them. No-ops are left out."""

    drop_noop = False

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss of a new batch, the logits (n, 18), the actions (n,), and other metrics."""
        frames, actions, tasks = self.drawn()
        stacks = torch.cat([frames[:, :-FRAME], frames[:, FRAME:]])
        before, after = self.actor.torso(stacks).chunk(2)  # with the same batch norm
        logits = self.actor.head(after - before, tasks)
        return nn.functional.cross_entropy(logits, actions), logits, actions, {}

    def drawn(self) -> tuple[Tensor, Tensor, Tensor]:
        """Augmented stacks and their next frame (n, 3k + 3, 96, 96), the actions before it (n,), and the tasks (n,)."""
        indices = [usable(self.data, task) for task in range(len(self.settings.tasks))]
        batch, following = successive(self.data, indices, self.settings.bc.batch_size, self.rng)
        frames = self.augmented(torch.cat([batch.observations, following[..., -FRAME:]], 3), self.noise_rng)
        return frames, batch.actions.to(self.device), batch.tasks.to(self.device)


class NextFrame(InverseDynamics):
    """Predicts the next frame from the observation and the action."""

    def __init__(self, settings: TrainingSettings, demonstrations: Demonstrations | None = None) -> None:
        super().__init__(settings, demonstrations)
        channels, flat = settings.network.channels, cast("Torso", self.actor.torso).flat
        with seeded(settings.seed):
            self.embedding = nn.Embedding(len(ACTIONS), flat)
            nn.init.normal_(self.embedding.weight, 1, 0.3)
            self.decoder = decoder(channels, math.isqrt(flat // channels))
        for layer in (self.embedding, self.decoder):
            self.optimizer.add_param_group({"params": layer.to(self.device).parameters()})

    def loss(self) -> tuple[Tensor, Tensor, Tensor, Mapping[str, float]]:
        """The loss relative to the frames' variance, and negative errors for all actions of the first samples."""
        frames, actions, _ = self.drawn()
        maps = cast("Torso", self.actor.torso).convolutions(frames[:, :-FRAME]).flatten(1)
        before, after = nn.functional.adaptive_avg_pool2d(frames[:, -2 * FRAME :], POOLED).chunk(2, 1)
        mean, still = after.mean(0), (after - before).square().mean()
        loss = (self.decoder(maps * self.embedding(actions)) + mean - after).square().mean()
        with torch.no_grad():
            every = maps[:COMPARED, None] * self.embedding.weight
            pictures = self.decoder(every.flatten(0, 1)).unflatten(0, every.shape[:2]) + mean
            errors = (pictures - after[:COMPARED, None]).square().flatten(2).mean(2)
        variance = (after - mean).square().mean()
        return loss / variance, -errors, actions[:COMPARED], {"explained": 1 - (loss / still).item()}


def decoder(channels: int, side: int) -> nn.Sequential:
    """Maps the flat output of convolutions, (n, channels * side * side), to pictures (n, 3, POOLED, POOLED)."""
    doublings = int(math.log2(POOLED / side))
    layers: list[nn.Module] = [nn.Unflatten(1, (channels, side, side)), nn.Upsample(size=POOLED >> doublings)]
    layers += [nn.Conv2d(channels, channels, 3, padding=1), nn.ReLU()]
    for _ in range(doublings - 1):
        layers += [nn.ConvTranspose2d(channels, channels, 4, 2, 1), nn.ReLU()]
    return nn.Sequential(*layers, nn.ConvTranspose2d(channels, FRAME, 4, 2, 1))


OBJECTIVES: Final = {"inverse": InverseDynamics, "next": NextFrame}


def episodes_in(path: Path, without: Collection[str] = ()) -> dict[str, list[Demonstration]]:
    """Task -> its episodes in a folder, or in a file experts.jsonl by tools.research.pretraining, if it has some."""
    found: dict[str, list[Demonstration]] = {}
    for task in TASKS:
        if task in without:
            continue
        if path.is_file():
            found[task] = [one.verified(path) for one in stored.read(path).values() if one.task == task]
            continue
        try:
            found[task] = load(task, path)
        except DemonstrationError:
            if any(path.rglob(f"{task}-*.npz")):
                raise
    return {task: episodes for task, episodes in found.items() if episodes}


def learnt(
    episodes: Mapping[str, Sequence[Demonstration]], objective: str, settings: Mapping[str, Any], *, quick: bool
) -> tuple[Encoder, dict[str, float]]:
    """The encoder, and the means of the metrics over the last tenth of the batches."""
    batches = settings["bc.batches"]
    changes = {**settings, "bc.batches": max(1, batches), "bc.heads": "uniform"}
    learner = OBJECTIVES[objective](load_settings("bc", tuple(episodes), quick=quick, **changes), episodes)
    metrics = pd.DataFrame([learner.update() for _ in range(batches)])
    learner.recalibrate()
    played = {demo.variant for found in episodes.values() for demo in found}
    weights = cast("Torso", learner.actor.torso).convolutions.state_dict()
    variants = ",".join(variant for variant in VARIANTS if variant in played)
    # Number 0: episodes that are not the package's demonstrations.
    encoder = Encoder(weights, tuple(episodes), variants, demonstration_set=0)
    return encoder, metrics.tail(max(1, batches // 10)).mean().round(4).to_dict()


def description(encoder: Path) -> dict[str, Any]:
    """The facts about an encoder's training."""
    return json.loads(encoder.with_suffix(".json").read_text())


def main(arguments: Sequence[str] | None = None) -> None:
    """Writes the encoder and its description. By default, the arguments are those of the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("episodes", type=Path, help="a folder by magical-mj demos rollouts, or a file experts.jsonl")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--objective", choices=list(OBJECTIVES), default="inverse")
    parser.add_argument("--without", default="", help="tasks whose episodes are left out, separated by commas")
    parser.add_argument("--batches", type=int, default=3_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--paper", action="store_true", help="the paper's network instead of the quick one")
    options = parser.parse_args(arguments)
    facts_path = options.out.with_suffix(".json")
    for path in (options.out, facts_path):
        if path.exists():
            parser.error(f"{path} exists already; give another path, or remove it first")
    if unknown := sorted({*filter(None, options.without.split(","))} - {*TASKS}):
        parser.error(f"--without has {', '.join(unknown)}, which is not among {', '.join(TASKS)}")
    torch.set_num_threads(1)
    found = episodes_in(options.episodes, options.without.split(","))
    if not found:
        parser.error(f"{options.episodes} contains no episodes of {', '.join(TASKS)}")
    settings = {"seed": options.seed, "bc.batches": options.batches}
    encoder, metrics = learnt(found, options.objective, settings, quick=not options.paper)
    players = "-".join(sorted({demo.demonstrator for episodes in found.values() for demo in episodes}))
    facts = {
        "start": f"{options.objective}-{players}" if options.batches else "untrained",
        "batches": options.batches,
        "tasks": list(found),
        "steps": sum(len(demo.actions) for episodes in found.values() for demo in episodes),
        **metrics,
    }
    save_encoder(options.out, encoder)
    facts_path.write_text(json.dumps(facts) + "\n")
    print(json.dumps(facts))


if __name__ == "__main__":
    main()
