"""`relational`: behavioural cloning that assumes more about a task, as far as the demo scene bears it out.

A network sees blocks and regions from the robot (`network`). New networks are trained on the demonstrations
alone, and others under all assumptions (`samples`); each policy plays in the demo scene after
`relational.trial` updates. The assumptions are kept if the mean score there is no more than `relational.loss` below the
best so far. If they are not, they are tried one after the other, each beside those that were kept. The policy is that
of the last trial that was kept.

Every trial begins with new networks: those that have learnt the demo scene keep to what told them the way there, even
when they are shown more. `mirror` is tried only where `egocentric` was kept: whoever sees where in the arena things are
tells mirrored samples from the demo scene, which then cannot show whether they are wrong.

The rules are the same for all tasks, and `assumptions.json` in the run's folder says what came of them. No other scene
is ever seen.

This needs more than the paper's methods have: the states of demonstrations, the simulation of the demo scene (for
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

from magical_mj.demos import Demonstration
from magical_mj.engine import Engine
from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.learner import Method, restore_optimizer, seeded
from magical_mj.learners.policy import TrainedPolicy
from magical_mj.learners.settings import STATE, TrainingSettings
from magical_mj.scene.actions import NOOP
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError
from magical_relational.grips import gripped
from magical_relational.hindsight import by_hindsight
from magical_relational.network import Ensemble, graph
from magical_relational.policy import save_policy
from magical_relational.samples import Replay, Samples, displace, joined, mirror, rename
from magical_relational.settings import PREMISES, RelationalSettings, RelationalTrainingSettings

REPORT: Final = "assumptions.json"
"""In a run's folder: of each trial what was assumed, the score in the demo scene, and whether it was kept."""
BATCHES: Final = 16
"""In an update: changing and describing many samples at once costs half of what it costs batch by batch."""
SHOWN: Final = 0.35
"""The share of samples with everything in its place."""
GRIPPED: Final = 0.25
"""The share of all others that are of `grips`, where that is assumed. Half of the rest are by `hindsight`."""
AVERAGED: Final = 0.2
"""The share of the latest weights, after each update, in the moving average that plays: it plays more evenly."""
NOISE: Final = (0.01, 0.01, 0.02)
"""Deviation of what is added to the robot's pose in samples: units, units, rad."""


class Sources(NamedTuple):
    """From what samples are drawn: demonstrations without no-ops, ways by hindsight, and grips.

    Where no way can be laid anywhere, or no block is taken, these are demonstrations, too.
    """

    shown: Samples
    ways: Samples
    grips: Samples


def demonstrated(demonstrations: Sequence[Demonstration], chosen: RelationalSettings, seed: int) -> Sources:
    """What demonstrations show, and what trying in their scene adds, as far as that may be assumed."""
    rng = np.random.default_rng(seed)
    with closing(Engine.of_scene(demonstrations[0].scene)) as engine:
        replays = [Replay(engine, demonstration) for demonstration in demonstrations]
        shown = joined([replay.samples(np.flatnonzero(replay.actions != NOOP)) for replay in replays])
        found = (
            by_hindsight(engine, replays, chosen.ways, chosen.plays, rng) if "hindsight" in chosen.assumptions else []
        )
        taken = gripped(engine, replays, chosen.grips, rng) if "grips" in chosen.assumptions else []
    return Sources(shown, joined(found or [shown]), joined(taken or [shown]))


class Relational(Method):
    """Minimises -E log pi(a | s) over samples that the kept assumptions make of demonstrations."""

    parts: ClassVar[tuple[str, ...]] = ("relational",)
    settings_type: ClassVar[type[TrainingSettings]] = RelationalTrainingSettings
    settings: RelationalTrainingSettings

    def __init__(self, settings: RelationalTrainingSettings) -> None:
        self.check(settings)
        super().__init__(settings)
        chosen = settings.relational
        (task,) = settings.tasks
        self._assumptions = tuple(chosen.assumptions)
        shown = shipped(task)
        demonstrations = [shown[i] for i in drawn(task, settings.seed, settings.demonstrations, len(shown))]
        self._sources = demonstrated(demonstrations, chosen, settings.seed)
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
        """Checks what a training needs; raises the errors with which it would begin."""
        if not settings.states or len(settings.tasks) > 1:
            raise SettingsError(f"relational learns one task, and from states: give one task and the preset {STATE}")
        super().check(settings)

    @property
    def actor(self) -> Ensemble:
        """The policy as it is now."""
        return self._actor

    @property
    def finished(self) -> bool:
        """Whether all trials have ended."""
        return self._count == self.updates

    @property
    def _kept(self) -> list[str]:
        """What the last trial assumed that was kept."""
        return next((trial["assumed"] for trial in reversed(self._report) if trial["kept"]), [])

    def samples(self, size: int, *, changed: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,) of demonstrations, changed under the assumptions that were kept."""
        return self._draw_samples(self._kept if changed else [], size)

    def update(self) -> Mapping[str, float]:
        """Trains each network on `BATCHES` batches of its own; judges what is assumed when its trial ends."""
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
        """Draws from what the networks hold probable."""
        return TrainedPolicy(self._actor, self.settings.tasks, self.settings.preset)

    def save_policy(self, folder: Path) -> None:
        """Writes the networks, and what was assumed."""
        save_policy(folder, self._actor, self.settings)
        self.write_report(folder)

    def fault(self) -> str | None:
        """Whether a weight is not finite."""
        finite = all(values.isfinite().all() for values in self._actor.state_dict().values())
        return None if finite else "a weight is not finite any more"

    def write_report(self, folder: Path) -> None:
        """Writes what was assumed."""
        files.write(folder / REPORT, json.dumps(self._report, indent=1) + "\n", overwrite=True)

    def get_state(self) -> dict[str, Any]:
        """Weights, also those of the last trial that was kept, optimizers, what was judged, and the generator."""
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
        """Goes back to a state that `get_state` returned."""
        self._count, self.updates, self._best = state["count"], state["updates"], state["best"]
        self._assumed, self._waiting = list(state["assumed"]), list(state["waiting"])
        self._report = list(state["report"])
        self._actor.load_state_dict(state["actor"])
        self._learning.load_state_dict(state["learning"])
        for optimizer, saved in zip(self._optimizers, state["optimizers"], strict=True):
            restore_optimizer(optimizer, saved)
        self.draw.set_state(state["draw"])

    def _draw_samples(self, assumed: list[str], size: int) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,), in random order, as changed by what is assumed."""
        shown = round(SHOWN * size)
        grips = round(GRIPPED * (size - shown)) if "grips" in assumed else 0
        ways = (size - shown - grips) // 2 if "hindsight" in assumed else 0
        parts = [
            source.of(torch.randint(len(source.actions), (count,), generator=self.draw))
            for source, count in zip(self._sources, (size - ways - grips, ways, grips), strict=True)
        ]
        samples = joined(parts)
        if "displace" in assumed:
            displace(samples.of(slice(shown, None)), self.draw, pairs="egocentric" in assumed)
        samples = samples.of(torch.randperm(size, generator=self.draw))
        states, actions = samples.states, samples.actions
        if "mirror" in assumed:
            actions = mirror(states, actions, self.draw)
        if "rename" in assumed:
            rename(states, self.draw)
        states[:, :3] += torch.randn((size, 3), generator=self.draw) * torch.tensor(NOISE)
        return states.to(self.device), actions.to(self.device)

    def _judge(self) -> None:
        """Plays in the demo scene, which decides whether what is assumed is kept; begins the next trial."""
        chosen = self.settings.relational
        (score,) = self.demo_scores(chosen.rollouts).values()  # of the one task
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
        """What the next trial assumes: all, or one more than was kept; None if nothing is left to try."""
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
        # Fewer, if assumptions are kept together.
        self.updates = self._count + (max(1, 2 - len(self._report)) + len(self._waiting)) * chosen.trial

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: values.clone() for name, values in self._actor.state_dict().items()}
