"""The packages that only learners need."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Final

from magical_mj.errors import TrainingError
from magical_mj.evaluation.extra import PACKAGES as FOR_EVALUATION

PACKAGES: Final = ("kornia", "safetensors", "stable_baselines3", "tensorboard", "torch", *FOR_EVALUATION)


def check_extra() -> None:
    """Raises a `TrainingError` that says what to install, unless all are there."""
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise TrainingError(f'learners need {", ".join(missing)}: pip install "magical-mj[il]"')
