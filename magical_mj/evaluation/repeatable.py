"""Checks that episodes with a user's shifts depend only on their seed and the actions.

Otherwise no score could be repeated, and only `magical-mj verify` would notice it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from typing import Any, Final

import numpy as np

from magical_mj.actions import ACTIONS
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.policies.loading import Source
from magical_mj.shifts.registry import code_digests
from magical_mj.utils.errors import MagicalError, SettingsError

STEPS: Final = 40
"""The most steps that are compared."""
PICTURE_STEPS: Final = 10
"""Pictures are compared after every tenth step."""
PICTURE_SIZE: Final = 32  # pixels


def check_repeatable(
    settings: EvaluationSettings, sources: Sequence[Source], labels: Mapping[str, Sequence[str]]
) -> None:
    """Plays the first steps of an episode twice, with each of the user's shifts. `labels`: those of each task.

    Raises:
        SettingsError: if the two differ. Errors of the shifts are left to the evaluation.
    """
    played: dict[tuple[str, ...], tuple[str, str, str]] = {}  # the greatest strength of each
    for task, variant in settings.environments:
        for label in labels[task]:
            if names := tuple(code_digests(label)):
                played[names] = task, variant, label
    for names, (task, variant, label) in played.items():
        drawn = any("observations" in source.uses and "pictures" not in source.unnoticed for source in sources)
        try:
            first, second = (_episode(settings, task, variant, label, drawn) for _ in range(2))
            pairs = zip(first, second, strict=True)
            different = next((what for (what, one), (_, other) in pairs if not np.array_equal(one, other)), None)
        except MagicalError:
            continue
        if different:
            raise SettingsError(
                f"{' or '.join(names)} is not repeatable: with the same seed and actions, two episodes differ in their "
                f"{different}. Draw random numbers only from self.rng() or self.uniform(step)"
            )


def _episode(
    settings: EvaluationSettings, task: str, variant: str, shifts: str, drawn: bool
) -> Iterator[tuple[str, Any]]:
    """What can differ in an episode with random actions: names and values."""
    from magical_mj.engine import Engine  # imported late: it loads the simulator

    seed, actions = settings.seeds[0], np.random.default_rng(0)
    how: dict[str, Any] = {"rules": settings.rules, "renderer": settings.renderer, "body": settings.body}
    with closing(Engine(task, variant, seed=seed, shifts=shifts, **how)) as engine:
        yield "initial scene", engine.initial_scene.digest()
        yield "instruction", engine.instruction
        for step in range(min(STEPS, engine.horizon or STEPS)):
            if drawn and step % PICTURE_STEPS == 0:
                for view in ("ego", "allo"):
                    yield "pictures", engine.render(view, PICTURE_SIZE)
            engine.step(int(actions.integers(len(ACTIONS))))
            yield "states", engine.get_state().simulation
        yield "score", engine.score()
