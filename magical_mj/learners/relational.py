"""`relational`: behavioural cloning that assumes more about a task, as far as the demo scene bears it out.

A network sees blocks and regions from the robot (`relational_network`). Assumptions (`assumptions`) are tried one
after the other: the training goes on with one more of them for some batches, and the policy plays in the demo scene.
The assumption is kept unless the mean score there falls by more than `relational.loss` below the best so far; if it
does, the weights from before it are restored. `mirror` is tried only where `egocentric` was kept: whoever sees where in
the arena things are tells mirrored samples from the demo scene, which then cannot show whether they are wrong.

After the last trial there is no more training: it would be memory of the demo scene. The rules are the same for all
tasks, and `assumptions.json` in the run's folder says what came of them. No other scene is ever seen.

This needs more than the paper's methods have: the states of demonstrations, the simulation of the demo scene (for
rollouts and detours), and its score.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import torch
from torch import nn

from magical_mj.evaluation.run import evaluate
from magical_mj.learners.assumptions import Samples, demonstrated, displace, mirror, rename
from magical_mj.learners.data import drawn, shipped
from magical_mj.learners.learner import Learner, restore_optimizer, seeded
from magical_mj.learners.relational_network import Ensemble, graph
from magical_mj.learners.settings import PREMISES, STATE, TrainingSettings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError

REPORT: Final = "assumptions.json"
"""In a run's folder: the score in the demo scene after each trial, and whether the assumption was kept."""
BATCHES: Final = 16
"""In an update: changing and describing many samples at once costs half of what it costs batch by batch."""
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
        excursions = chosen.detours if "detours" in self._assumptions else 0
        self._samples, self._detours = demonstrated(demonstrations, excursions, settings.seed)
        self._draw = torch.Generator().manual_seed(settings.seed)
        with seeded(settings.seed):
            self._learning, self._actor = Ensemble(chosen).to(self.device), Ensemble(chosen).to(self.device)
        self._actor.load_state_dict(self._learning.state_dict())
        self._count, self.updates = 0, (2 + len(self._assumptions)) * chosen.trial
        self._kept: list[str] = []
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

    def update(self) -> Mapping[str, float]:
        """Trains each network on `BATCHES` batches of its own; judges an assumption when its trial ends."""
        chosen = self.settings.relational
        assumed = [*self._kept, *self._tried]
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
        if self._count % chosen.trial == 0 and self._count > chosen.trial:
            self._judge()
        return {"loss": torch.stack(losses).mean().item(), "accuracy": torch.stack(right).mean().item()}

    def save_policy(self, folder: Path) -> None:
        """Writes the networks, and what was assumed."""
        super().save_policy(folder)
        files.write(folder / REPORT, json.dumps(self._report, indent=1) + "\n", overwrite=True)

    def get_state(self) -> dict[str, Any]:
        """Weights, also of before a trial, optimizers, what was judged, and the generator."""
        return {
            "count": self._count,
            "kept": self._kept,
            "report": self._report,
            "actor": self._actor.state_dict(),
            "learning": self._learning.state_dict(),
            "before": self._before,
            "optimizers": [optimizer.state_dict() for optimizer in self._optimizers],
            "draw": self._draw.get_state(),
        }

    def set_state(self, state: dict[str, Any]) -> None:
        """Goes back to a state that `get_state` returned."""
        self._count, self._kept, self._report = state["count"], list(state["kept"]), list(state["report"])
        self._before = state["before"]
        self._actor.load_state_dict(state["actor"])
        self._learning.load_state_dict(state["learning"])
        for optimizer, saved in zip(self._optimizers, state["optimizers"], strict=True):
            restore_optimizer(optimizer, saved)
        self._draw.set_state(state["draw"])

    @property
    def _tried(self) -> tuple[str, ...]:
        """The assumption on trial now, if one is: first comes twice the time of a trial without any."""
        number = self._count // self.settings.relational.trial - 1
        return tuple(filter(self._can_be_tried, self._assumptions[max(0, number - 1) : max(0, number)]))

    def _can_be_tried(self, name: str) -> bool:
        return name not in PREMISES or PREMISES[name] in self._kept

    def _draw_samples(self, assumed: list[str], size: int) -> tuple[torch.Tensor, torch.Tensor]:
        """States (size, names) and actions (size,), in random order, as changed by what is assumed."""
        detours = size // 3 if "detours" in assumed else 0
        parts = [
            source.of(torch.randint(len(source.actions), (count,), generator=self._draw))
            for source, count in ((self._samples, size - detours), (self._detours, detours))
        ]
        samples = Samples(*(torch.cat(values) for values in zip(*parts, strict=True)))
        samples = samples.of(torch.randperm(size, generator=self._draw))
        states, actions = samples.states, samples.actions
        if "displace" in assumed:
            displace(samples, self._draw)
        if "mirror" in assumed:
            actions = mirror(states, actions, self._draw)
        if "rename" in assumed:
            rename(states, self._draw)
        states[:, :3] += torch.randn((size, 3), generator=self._draw) * torch.tensor(NOISE)
        return states.to(self.device), actions.to(self.device)

    def _judge(self) -> None:
        """Plays in the demo scene, and keeps what was on trial or restores the weights from before it."""
        chosen = self.settings.relational
        asked = {"tasks": self.settings.tasks, "preset": self.settings.preset, "episodes": chosen.rollouts}
        frame = evaluate(self.policy(), variants="Demo", jobs=1, **asked)
        score = float(frame["score"].mean())
        kept = [trial["score"] for trial in self._report if trial["kept"]]
        number = self._count // chosen.trial - 2
        trial: dict[str, Any] = {"score": score, "kept": True}
        if number:
            name = self._assumptions[number - 1]
            tried = self._can_be_tried(name)
            trial = {"assumption": name, "tried": tried, **trial, "kept": tried and score >= max(kept) - chosen.loss}
            if trial["kept"]:
                self._kept.append(name)
            elif tried:
                self._learning.load_state_dict(self._before)
                self._actor.load_state_dict(self._before)
        self._report.append(trial)
        self._before = self._weights()
        self._restart()

    def _weights(self) -> dict[str, torch.Tensor]:
        return {name: values.clone() for name, values in self._actor.state_dict().items()}

    def _restart(self) -> None:
        """New optimizers, as each trial begins with."""
        rate = self.settings.relational.learning_rate
        self._optimizers = [
            torch.optim.Adam(network.parameters(), rate, fused=True) for network in self._learning.networks
        ]
