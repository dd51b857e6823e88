"""`relational`: behavioural cloning that assumes more about a task, as far as the demo scene bears it out.

A network sees blocks and regions from the robot (`relational_network`). Assumptions (`assumptions`) are tried one
after the other: the training goes on with one more of them, and after each `relational.trial` updates the policy plays
in the demo scene. The assumption is kept as soon as the mean score there is no more than `relational.loss` below the
best so far. It takes time to catch up with a harder lesson; if it has not after `relational.patience` times, the
weights from before the trial are restored. `mirror` is tried only where `egocentric` was kept: whoever sees where in
the arena things are tells mirrored samples from the demo scene, which then cannot show whether they are wrong.

The rules are the same for all tasks, and `assumptions.json` in the run's folder says what came of them. No other scene
is ever seen.

This needs more than the paper's methods have: the states of demonstrations, the simulation of the demo scene (for
rollouts and hindsight), and its score.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.hindsight import demonstrated
from magical_mj.learners.learner import Learner, restore_optimizer, seeded
from magical_mj.learners.relational_network import Ensemble, graph
from magical_mj.learners.relational_samples import displace, joined, mirror, rename
from magical_mj.learners.settings import PREMISES, STATE, TrainingSettings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

REPORT: Final = "assumptions.json"
"""In a run's folder: of each trial the scores in the demo scene, and whether the assumption was kept."""
BATCHES: Final = 16
"""In an update: changing and describing many samples at once costs half of what it costs batch by batch."""
FIRST: Final = 2
"""Of the demonstrations alone, how many times `relational.trial` updates come before any assumption."""
AVERAGED: Final = 0.2
"""The share of the latest weights, after each update, in the moving average that plays: it plays more evenly."""
NOISE: Final = (0.01, 0.01, 0.02)
"""Deviation of what is added to the robot's pose in samples: units, units, rad."""


class Relational(Learner):
    """Minimises -E log pi(a | s) over samples that the kept assumptions make of demonstrations."""

    def __init__(self, settings: TrainingSettings) -> None:
        self.check(settings)
        super().__init__(settings)
        chosen = settings.relational
        (task,) = settings.tasks
        self._assumptions = tuple(chosen.assumptions)
        shown = shipped(task)
        demonstrations = [shown[i] for i in drawn(task, settings.seed, settings.demonstrations, len(shown))]
        ways = chosen.ways if "hindsight" in self._assumptions else 0
        self._shown, self._ways = demonstrated(demonstrations, ways, chosen.plays, settings.seed)
        self.draw = torch.Generator().manual_seed(settings.seed)
        with seeded(settings.seed):
            self._learning, self._actor = Ensemble(chosen).to(self.device), Ensemble(chosen).to(self.device)
        self._actor.load_state_dict(self._learning.state_dict())
        self.updates = (FIRST + len(self._assumptions) * chosen.patience) * chosen.trial  # fewer, if trials end early
        self._count, self._trial = 0, 0
        self._kept: list[str] = []
        self._scores: list[float] = []
        self._report: list[dict[str, Any]] = []
        self._before = self._weights()
        self._restart()

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

    def samples(self, size: int, *, changed: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,) of demonstrations, changed under the assumptions that were kept."""
        return self._draw_samples(self._kept if changed else [], size)

    def update(self) -> Mapping[str, float]:
        """Trains each network on `BATCHES` batches of its own; judges an assumption when its trial ends."""
        chosen = self.settings.relational
        assumed = [*self._kept, *self._assumptions[: self._trial][-1:]]
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
        if self._count % chosen.trial == 0 and self._count >= FIRST * chosen.trial:
            self._judge()
        return {"loss": torch.stack(losses).mean().item(), "accuracy": torch.stack(right).mean().item()}

    def save_policy(self, folder: Path) -> None:
        """Writes the networks, and what was assumed."""
        super().save_policy(folder)
        self.write_report(folder)

    def write_report(self, folder: Path) -> None:
        """Writes what was assumed."""
        files.write(folder / REPORT, json.dumps(self._report, indent=1) + "\n", overwrite=True)

    def get_state(self) -> dict[str, Any]:
        """Weights, also of before a trial, optimizers, what was judged, and the generator."""
        return {
            "count": self._count,
            "updates": self.updates,
            "trial": self._trial,
            "kept": self._kept,
            "scores": self._scores,
            "report": self._report,
            "actor": self._actor.state_dict(),
            "learning": self._learning.state_dict(),
            "before": self._before,
            "optimizers": [optimizer.state_dict() for optimizer in self._optimizers],
            "draw": self.draw.get_state(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Goes back to a state that `get_state` returned."""
        self._count, self.updates, self._trial = state["count"], state["updates"], state["trial"]
        self._kept, self._scores, self._report = list(state["kept"]), list(state["scores"]), list(state["report"])
        self._before = state["before"]
        self._actor.load_state_dict(state["actor"])
        self._learning.load_state_dict(state["learning"])
        for optimizer, saved in zip(self._optimizers, state["optimizers"], strict=True):
            restore_optimizer(optimizer, saved)
        self.draw.set_state(state["draw"])

    def _draw_samples(self, assumed: list[str], size: int) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,), in random order, as changed by what is assumed."""
        ways = size // 2 if "hindsight" in assumed else 0
        parts = [
            source.of(torch.randint(len(source.actions), (count,), generator=self.draw))
            for source, count in ((self._shown, size - ways), (self._ways, ways))
        ]
        samples = joined(parts).of(torch.randperm(size, generator=self.draw))
        states, actions = samples.states, samples.actions
        if "displace" in assumed:
            displace(samples, self.draw, pairs="egocentric" in assumed)
        if "mirror" in assumed:
            actions = mirror(states, actions, self.draw)
        if "rename" in assumed:
            rename(states, self.draw)
        states[:, :3] += torch.randn((size, 3), generator=self.draw) * torch.tensor(NOISE)
        return states.to(self.device), actions.to(self.device)

    def _judge(self) -> None:
        """Plays in the demo scene, and ends the trial if that is decided."""
        chosen = self.settings.relational
        self._scores += self.demo_scores(chosen.rollouts).values()  # of the one task
        best = max((trial["scores"][-1] for trial in self._report if trial["kept"]), default=0.0)
        caught_up = self._scores[-1] >= best - chosen.loss
        rest = chosen.patience - len(self._scores) if self._trial else 0
        if caught_up or not rest:
            self._end_trial(caught_up)
            self.updates -= rest * chosen.trial

    def _end_trial(self, keep: bool) -> None:
        """Keeps what was on trial, or restores the weights from before it; goes on to the next trial."""
        tried = self._assumptions[: self._trial][-1:]
        if keep:
            self._kept += tried
        else:
            self._learning.load_state_dict(self._before)
            self._actor.load_state_dict(self._before)
        self._report.append({"assumption": tried[0] if tried else None, "scores": self._scores, "kept": keep})
        self._scores = []
        self._before = self._weights()
        self._restart()
        self._trial += 1
        for name in self._assumptions[self._trial - 1 :]:
            if name not in PREMISES or PREMISES[name] in self._kept:
                break
            self._report.append({"assumption": name, "scores": [], "kept": False})
            self.updates -= self.settings.relational.patience * self.settings.relational.trial
            self._trial += 1

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: values.clone() for name, values in self._actor.state_dict().items()}

    def _restart(self) -> None:
        """New optimizers, as each trial begins with."""
        rate = self.settings.relational.learning_rate
        self._optimizers = [
            torch.optim.Adam(network.parameters(), rate, fused=True) for network in self._learning.networks
        ]
