"""The methods by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from magical_mj.baselines.adversarial import GAIL, WGAILGP
from magical_mj.baselines.apprenticeship import Apprenticeship
from magical_mj.baselines.bc import BehaviouralCloning
from magical_mj.baselines.learner import Learner
from magical_mj.baselines.settings import Settings

METHODS: Final[Mapping[str, Callable[[Settings], Learner]]] = MappingProxyType(
    {"bc": BehaviouralCloning, "gail": GAIL, "wgail-gp": WGAILGP, "al": Apprenticeship}
)
