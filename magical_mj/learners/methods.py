"""The learning methods by name. Their classes describe them, and are imported at their first use."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from importlib.metadata import EntryPoint
from types import MappingProxyType
from typing import Any, Final

from magical_mj.utils.errors import SettingsError
from magical_mj.utils.extras import check_extra
from magical_mj.utils.imports import announced, imported, resolve_installed

METHOD_GROUP: Final = "magical_mj.methods"
"""The entry-point group for methods of installed packages, such as ``mine = "package.module:Mine"``."""
OWN: Final[Mapping[str, str]] = MappingProxyType(
    {
        "bc": "bc:BehaviouralCloning",
        "gail": "gail:GAIL",
        "wgail-gp": "gail:WGAILGP",
        "airl": "gail:AIRL",
        "al": "apprenticeship:Apprenticeship",
        "iq-learn": "bc:IQLearn",
        "point": "bc:Point",
        "ppo": "rewards:OnLearntReward",
    }
)
"""The methods of this package: name -> module and class."""


@cache
def announced_methods() -> Mapping[str, EntryPoint]:
    """The entry points of methods of installed packages, by name."""
    return announced("method", METHOD_GROUP, OWN, re.compile(r"[\w-]+").fullmatch, 'mine = "package.module:Mine"')


class _Methods(Mapping[str, Any]):
    """The methods of this package, and those that other packages announce."""

    def __getitem__(self, name: str) -> Any:
        if name not in OWN:
            return imported("method", name, announced_methods()[name], SettingsError)
        check_extra("learners", "eval", "il")
        return resolve_installed(f"magical_mj.learners.{OWN[name]}")

    def __contains__(self, name: object) -> bool:
        return name in OWN or name in announced_methods()

    def __iter__(self) -> Iterator[str]:
        return iter((*OWN, *announced_methods()))

    def __len__(self) -> int:
        return len(OWN) + len(announced_methods())


METHODS: Final = _Methods()
"""Name -> class, a subclass of `learner.Method`, of all methods that `train` supports by name."""
