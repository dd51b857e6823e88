"""One run of an experiment: a training and its evaluation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.run import evaluate
from magical_mj.evaluation.scores import SCORES
from magical_mj.learners.learner import keep_freed_memory
from magical_mj.learners.method_settings import uses
from magical_mj.learners.metrics import METRICS, read_metrics
from magical_mj.learners.run import Progress, train
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.interface import uses_simulation
from magical_mj.tasks.registry import environments, task_spec

SIDE_BY_SIDE: Final = {"pictures": 10, "states": 100}
"""Episodes that are played at once, for networks like batches; pictures fill the memory."""
NAMED: Final = ("preset", "augment", "device", "evaluations", "episodes", "checkpoints")
"""Settings that are not listed in a method's name: it shows them otherwise, or they do not affect the result."""
ABLATIONS: Final = {"all": "", "none": ", no aug.", "no-trans-rot": ", no trans./rot. aug."}

Watch = Callable[[str, Progress], None]


@dataclass(frozen=True)
class Run:
    """One run of an experiment.

    Attributes:
        settings: the settings of the training.
        quick: whether they are the quick ones.
        changes: the changed settings, except the seed.
        evaluation: the settings of the evaluation, as in `EVALUATION`.
        folder: the folder of the experiment.
    """

    settings: TrainingSettings
    quick: bool
    changes: dict[str, Any]
    evaluation: dict[str, Any]
    folder: Path

    @property
    def name(self) -> str:
        """Of its folder: the method, the task and the seed."""
        tasks = self.settings.tasks
        return f"{self.settings.method}-{task_spec(tasks[0]).name if len(tasks) == 1 else 'multi'}-{self.settings.seed}"

    @property
    def method(self) -> str:
        """The method's name in tables; runs of the same name are averaged."""
        used = {name: value for name, value in self.changes.items() if uses(self.settings.method, name)}
        changed = "".join(f", {name} {value}" for name, value in used.items() if name not in NAMED)
        return f"{self.counterparts[0]}, ours{', quick' if self.quick else ''}{changed}"

    @property
    def counterparts(self) -> tuple[str, str]:
        """The paper's row with these observations and augmentations, and with its usual ones; either may not exist."""
        settings = self.settings
        method, kind = settings.method.upper(), "ST" if len(settings.tasks) == 1 else "MT"
        preset = {"LoRes4E": "", "LoRes4A": ", allo."}.get(settings.preset, f", {settings.preset}")
        ablation = ABLATIONS[settings.augment] if uses(settings.method, "augment") else ""
        return f"{method} ({kind}{preset}{ablation})", f"{method} ({kind})"

    @property
    def trained(self) -> Path:
        """The folder of the training."""
        return self.folder / "runs" / self.name

    @property
    def scores(self) -> Path:
        """The folder of the evaluation."""
        return self.folder / "evaluations" / self.name

    @property
    def played(self) -> dict[str, Any]:
        """The settings of the evaluation that determine scores."""
        settings = self.settings
        return {**self.evaluation, "tasks": settings.tasks, "preset": settings.preset, "run": settings.seed}

    def play(self, watch: Watch | None = None) -> str:
        """Trains and evaluates, as far as that is not done yet; returns a line about it."""
        keep_freed_memory()
        updates = 0

        def count(progress: Progress) -> None:
            nonlocal updates
            updates += 1
            if watch is not None:
                watch(self.name, progress)

        policy = train(self.settings, self.trained, resume=True, watch=count)
        frame = evaluate(
            {self.method: self.trained},
            out=self.scores,
            resume=True,
            envs=1 if uses_simulation(policy) else SIDE_BY_SIDE["states" if self.settings.states else "pictures"],
            jobs=1,
            **self.played,
        )
        means = frame.groupby("variant", sort=False)["score"].mean()
        shown = ", ".join(f"{variant} {mean:.2f}" for variant, mean in means.items())
        return f"{self.name}: {'trained' if updates else 'was trained before'}; {shown}"

    def standing(self, since: float) -> str:
        """How far it has come, as its files tell; empty if none has changed since a time, or it is finished."""
        known = {path: path.stat().st_mtime for path in (self.trained / METRICS, self.scores / SCORES) if path.exists()}
        latest = max(known, key=known.__getitem__, default=None)
        if latest is None or known[latest] < since:
            return ""
        if latest.name == METRICS:
            return f"{self.name}: {([{'update': '0'}, *read_metrics(self.trained)])[-1]['update']} updates"
        done = latest.read_bytes().count(b"\n")
        of = len(environments(self.settings.tasks, self.evaluation["variants"])) * self.evaluation["episodes"]
        return f"{self.name}: {done} of {of} episodes evaluated" if done < of else ""
