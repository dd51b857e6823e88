"""The paper's learners, trained on our demonstrations: BC, GAIL, WGAIL-GP and apprenticeship learning.

They need the extra `il`; nothing else in the package imports them. docs/learners.md says what each of them is.

Example:
    >>> from magical_mj.baselines import load_settings, train
    >>> train(load_settings("bc", tasks="MoveToRegion", quick=True), "runs/bc-mtr-0")
    >>> magical_mj.evaluation.evaluate("runs/bc-mtr-0", tasks="MoveToRegion")
"""

from magical_mj.baselines.extra import check_extra

check_extra()

from magical_mj.baselines.experiment import conduct, runs  # noqa: E402
from magical_mj.baselines.learner import Learner  # noqa: E402
from magical_mj.baselines.methods import METHODS  # noqa: E402
from magical_mj.baselines.policy import TrainedPolicy, load_policy  # noqa: E402
from magical_mj.baselines.run import Progress, train  # noqa: E402
from magical_mj.baselines.settings import Settings, load_settings  # noqa: E402

__all__ = [
    "METHODS",
    "Learner",
    "Progress",
    "Settings",
    "TrainedPolicy",
    "conduct",
    "load_policy",
    "load_settings",
    "runs",
    "train",
]
