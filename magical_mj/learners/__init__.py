"""The paper's learners, trained on our demonstrations: BC, GAIL, WGAIL-GP and apprenticeship learning.

They need the extra `il`. No other part of the package imports them. docs/methods.md describes each learner.

Example:
    >>> from magical_mj.learners import load_settings, train
    >>> train(load_settings("bc", tasks="MoveToRegion", quick=True), "runs/bc-mtr-0")
    >>> magical_mj.evaluation.evaluate("runs/bc-mtr-0", tasks="MoveToRegion")
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.learners.bc import clone
    from magical_mj.learners.experiment import plan_experiment, run_experiment
    from magical_mj.learners.learner import Learner
    from magical_mj.learners.policy import TrainedPolicy, load_policy
    from magical_mj.learners.training import Progress, train
from magical_mj.learners.config import load_settings
from magical_mj.learners.settings import METHODS, TrainingSettings

_LAZY = {  # loaded at first use, so that the command line can list its commands without importing PyTorch
    "Learner": "learner",
    "Progress": "training",
    "TrainedPolicy": "policy",
    "clone": "bc",
    "run_experiment": "experiment",
    "load_policy": "policy",
    "plan_experiment": "experiment",
    "train": "training",
}

__all__ = [
    "METHODS",
    "Learner",
    "Progress",
    "TrainedPolicy",
    "TrainingSettings",
    "clone",
    "load_policy",
    "load_settings",
    "plan_experiment",
    "run_experiment",
    "train",
]


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    check_extra("learners", "eval", "il")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
