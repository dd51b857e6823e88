"""`relational`: behavioural cloning under assumptions about a task, which the score in the demo scene tests.

The network observes blocks and regions in the robot's frame (`network`). New networks are trained on the demonstrations
alone, and others under all assumptions (`samples`). After `relational.trial` updates, each policy plays in the
demo scene. The assumptions are kept if the mean score is at most `relational.loss` below the best so far. If they are
not kept, they are tried one after the other, each together with those kept before. The policy is that of the last
trial that was kept.

Every trial starts with new networks: networks that have learnt the demo scene rely on its positions, even
if they are then trained on more samples. `mirror` is tried only if `egocentric` was kept: a network that observes
positions in the arena can distinguish mirrored samples from the demo scene, so the demo score would not show whether
they are wrong.

The rules are the same for all tasks, and `assumptions.json` in the run's folder records the trials. No other scene
is used.

This needs more than the paper's methods: the states of demonstrations, the simulation of the demo scene (for
rollouts, hindsight and grips), and its score.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple

import numpy as np
import torch
from torch import nn

from magical_mj.actions import NOOP
from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners import data
from magical_mj.learners.learner import Method, restore_optimizer, seeded
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.learners.settings import STATE, TrainingSettings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError
from magical_relational.grips import gripped
from magical_relational.hindsight import by_hindsight
from magical_relational.network import Ensemble, graph
from magical_relational.policy import save_policy
from magical_relational.replay import CLOSING, Samples, joined, read
from magical_relational.samples import close, contrast, displace, exchange, mirror, rename
from magical_relational.settings import PREMISES, RelationalSettings, RelationalTrainingSettings

REPORT: Final = "assumptions.json"
"""The file in a run's folder with each trial's assumptions, its demo score, and whether it was kept."""
BATCHES: Final = 16
"""The number of batches in an update. Preparing many samples at once takes half the time of separate batches."""
SHOWN: Final = 0.35
"""The share of unchanged samples."""
GRIPPED: Final = 0.25
"""The share of `grips` among all other samples, if it is assumed. Half of the rest are from `hindsight`."""
RELEASED: Final = 0.12
"""The share of releases among all other samples, if `delivery` is assumed."""
EXCHANGED: Final = (0.1, 0.5)
"""The shares of exchanged blocks, if `contrast` is assumed: among blocks that are carried, and that are released."""
AVERAGED: Final = 0.2
"""The share of the latest weights in the moving average of weights. The average plays more consistently."""
NOISE: Final = (0.01, 0.01, 0.02)
"""The standard deviation of noise on the robot's pose in samples: units, units, rad."""


class Sources(NamedTuple):
    """The sources of samples: demonstrations without no-ops, paths from hindsight, grips, and releases.

    A source without samples is replaced by the demonstrations.
    """

    shown: Samples
    paths: Samples
    grips: Samples
    releases: Samples


def demonstrated(
    demonstrations: Sequence[Demonstration], chosen: RelationalSettings, seed: int, *, deliveries: bool = False
) -> Sources:
    """The samples of demonstrations; those of hindsight and grips only if `chosen` has these assumptions.

    With `deliveries`, the demonstrations are read as deliveries of blocks (see `magical_relational.replay`).
    """
    rng = np.random.default_rng(seed)
    found, taken = list[Samples](), list[Samples]()
    with closing(Engine.of_scene(demonstrations[0].scene)) as engine:
        replays = read(engine, demonstrations, deliveries=deliveries)
        if "hindsight" in chosen.assumptions:
            found = by_hindsight(engine, replays, chosen.ways, chosen.plays, rng)
        if "grips" in chosen.assumptions:
            taken = gripped(engine, replays, chosen.grips, rng)
    shown = joined([replay.samples(np.flatnonzero(replay.actions != NOOP)) for replay in replays])
    left = [replay.samples(replay.releases()) for replay in replays]
    left = left if sum(len(part.actions) for part in left) else [shown]
    return Sources(shown, joined(found or [shown]), joined(taken or [shown]), joined(left))


class Relational(Method):
    """Minimises -E log pi(a | s) over demonstrations that are changed under the kept assumptions."""

    parts: ClassVar[tuple[str, ...]] = ("relational",)
    settings_type: ClassVar[type[TrainingSettings]] = RelationalTrainingSettings
    settings: RelationalTrainingSettings

    def __init__(self, settings: RelationalTrainingSettings) -> None:
        self.check(settings)
        super().__init__(settings)
        chosen = settings.relational
        (task,) = settings.tasks
        self._assumptions = tuple(chosen.assumptions)
        self._demonstrations = data.chosen(settings, task)
        self._read: dict[bool, Sources] = {}
        self.draw = torch.Generator().manual_seed(settings.seed)
        with seeded(settings.seed):
            self._learning, self._actor = Ensemble(chosen).to(self.device), Ensemble(chosen).to(self.device)
        self._count = 0
        self._waiting = list(self._assumptions)
        self._report: list[dict[str, Any]] = []
        self._begin([])
        self._best = self._weights()

    @classmethod
    def check(cls, settings: TrainingSettings) -> None:
        """Checks the requirements of a training, and raises the errors of its start."""
        if not settings.states or len(settings.tasks) > 1:
            raise SettingsError(f"relational learns one task from states: give one task and the preset {STATE}")
        super().check(settings)

    @property
    def actor(self) -> Ensemble:
        """The current policy."""
        return self._actor

    @property
    def finished(self) -> bool:
        """Whether all trials have ended."""
        return self._count == self.updates

    @property
    def _kept(self) -> list[str]:
        """The assumptions of the last trial that was kept."""
        return next((trial["assumed"] for trial in reversed(self._report) if trial["kept"]), [])

    def samples(self, size: int, *, changed: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,) of demonstrations, changed under the kept assumptions."""
        return self._draw_samples(self._kept if changed else [], size)

    def update(self) -> Mapping[str, float]:
        """Trains each network on `BATCHES` separate batches. At the end of a trial, evaluates its assumptions."""
        chosen, assumed = self.settings.relational, self._assumed
        losses, right = [], []
        for network, optimizer in zip(self._learning.members, self._optimizers, strict=True):
            states, actions = self._draw_samples(assumed, BATCHES * chosen.batch_size)
            network.arena.fill_(float("egocentric" not in assumed))
            seen = graph(states, network.arena)
            for rows in torch.arange(len(actions)).split(chosen.batch_size):
                logits = network.act(*(part[rows] for part in seen))
                loss = nn.functional.cross_entropy(logits, actions[rows])
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                losses.append(loss.detach())
                right.append((logits.argmax(1) == actions[rows]).float().mean())
        with torch.no_grad():
            for mean, latest in zip(self._actor.parameters(), self._learning.parameters(), strict=True):
                mean.lerp_(latest, AVERAGED)
            for flag, latest in zip(self._actor.buffers(), self._learning.buffers(), strict=True):
                flag.copy_(latest)
        self._count += 1
        if self._count % chosen.trial == 0:
            self._judge()
        return {"loss": torch.stack(losses).mean().item(), "accuracy": torch.stack(right).mean().item()}

    def policy(self) -> TrainedPolicy:
        """The policy that draws actions from the networks' probabilities."""
        settings = self.settings
        return TrainedPolicy(self._actor, settings.tasks, settings.preset, self.learnt)

    def save_policy(self, folder: Path) -> None:
        """Writes the networks, and the report on assumptions."""
        save_policy(folder, self._actor, self.settings)
        self.write_report(folder)

    def fault(self) -> str | None:
        """A message if a weight is not finite."""
        finite = all(values.isfinite().all() for values in self._actor.state_dict().values())
        return None if finite else "a weight is no longer finite"

    def write_report(self, folder: Path) -> None:
        """Writes the report on assumptions."""
        files.write(folder / REPORT, json.dumps(self._report, indent=1) + "\n", overwrite=True)

    def get_state(self) -> dict[str, Any]:
        """The current weights, those of the last kept trial, the optimizers, the report, and the generator."""
        return {
            "count": self._count,
            "updates": self.updates,
            "assumed": self._assumed,
            "waiting": self._waiting,
            "report": self._report,
            "actor": self._actor.state_dict(),
            "learning": self._learning.state_dict(),
            "best": self._best,
            "optimizers": [optimizer.state_dict() for optimizer in self._optimizers],
            "draw": self.draw.get_state(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Restores a state from `get_state`."""
        self._count, self.updates, self._best = state["count"], state["updates"], state["best"]
        self._assumed, self._waiting = list(state["assumed"]), list(state["waiting"])
        self._report = list(state["report"])
        self._actor.load_state_dict(state["actor"])
        self._learning.load_state_dict(state["learning"])
        for optimizer, saved in zip(self._optimizers, state["optimizers"], strict=True):
            restore_optimizer(optimizer, saved)
        self.draw.set_state(state["draw"])

    def _sources(self, assumed: Sequence[str]) -> Sources:
        """The sources under these assumptions. Without any, both readings have the same states and actions."""
        deliveries = "delivery" in (assumed or self._assumptions)
        if deliveries not in self._read:
            settings = self.settings
            self._read[deliveries] = demonstrated(
                self._demonstrations, settings.relational, settings.seed, deliveries=deliveries
            )
        return self._read[deliveries]

    def _draw_samples(self, assumed: list[str], size: int) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,), in random order, changed under these assumptions."""
        shown = round(SHOWN * size)
        grips = round(GRIPPED * (size - shown)) if "grips" in assumed else 0
        releases = round(RELEASED * (size - shown)) if "delivery" in assumed else 0
        paths = (size - shown - grips - releases) // 2 if "hindsight" in assumed else 0
        parts = [
            source.of(torch.randint(len(source.actions), (count,), generator=self.draw))
            for source, count in zip(
                self._sources(assumed), (size - paths - grips - releases, paths, grips, releases), strict=True
            )
        ]
        samples = joined(parts)
        if "contrast" in assumed:
            first = size - paths - grips - releases
            chance = EXCHANGED[0] * (samples.actions >= CLOSING)
            chance[:first] = chance[first + paths :] = 0.0
            chance[size - releases :] = EXCHANGED[1]
            exchange(samples, chance, self.draw)
        if "displace" in assumed:
            displace(samples.of(slice(shown, None)), self.draw, pairs="egocentric" in assumed)
        if "contrast" in assumed:
            contrast(samples.of(slice(shown, None)), self.draw)
        if "delivery" in assumed:
            close(samples.of(slice(shown, None)), self.draw)
        samples = samples.of(torch.randperm(size, generator=self.draw))
        states, actions = samples.states, samples.actions
        if "mirror" in assumed:
            actions = mirror(states, actions, self.draw)
        if "rename" in assumed:
            rename(states, self.draw)
        states[:, :3] += torch.randn((size, 3), generator=self.draw) * torch.tensor(NOISE)
        return states.to(self.device), actions.to(self.device)

    def _judge(self) -> None:
        """Plays in the demo scene, decides whether the assumptions are kept, and begins the next trial."""
        chosen = self.settings.relational
        (score,) = self.demo_scores(chosen.rollouts).values()  # there is one task
        best = max((trial["score"] for trial in self._report if trial["kept"]), default=0.0)
        keep = score >= best - chosen.loss
        self._report.append({"assumed": self._assumed, "score": score, "kept": keep})
        if keep:
            self._best = self._weights()
        if (following := self._next()) is None:
            self._actor.load_state_dict(self._best)
            self.updates = self._count
        else:
            self._begin(following)

    def _next(self) -> list[str] | None:
        """The assumptions of the next trial: all, or one more than the kept ones. None if all trials are done."""
        every = list(self._assumptions)
        tried = [trial["assumed"] for trial in self._report]
        if every not in tried:
            return every
        if self._kept == every:
            return None
        while self._waiting:
            name = self._waiting.pop(0)
            following = [*self._kept, name]
            if PREMISES.get(name, name) in following and following not in tried:
                return following
        return None

    def _begin(self, assumed: list[str]) -> None:
        """Begins a trial, with new networks and optimizers."""
        chosen, self._assumed = self.settings.relational, assumed
        with seeded(self.settings.seed):
            self._learning.load_state_dict(Ensemble(chosen).state_dict())
        self._actor.load_state_dict(self._learning.state_dict())
        self._optimizers = [
            torch.optim.Adam(network.parameters(), chosen.learning_rate, fused=True)
            for network in self._learning.networks
        ]
        # The largest number. If assumptions are kept together, fewer trials follow.
        self.updates = self._count + (max(1, 2 - len(self._report)) + len(self._waiting)) * chosen.trial

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: values.clone() for name, values in self._actor.state_dict().items()}
