"""Evaluation of agents: scores on the benchmark's scenes, their statistics, reports and comparisons.

`evaluate` plays episodes and writes their scores to files. The folder `reports` makes tables and figures from them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from magical_mj.evaluation.playing import rollouts
    from magical_mj.evaluation.run import Evaluation, evaluate
    from magical_mj.evaluation.scores import EpisodeResult
    from magical_mj.evaluation.settings import EvaluationSettings
    from magical_mj.policies.interface import BatchPolicy, Episode, Policy

__all__ = [
    "BatchPolicy",
    "Episode",
    "EpisodeResult",
    "Evaluation",
    "EvaluationSettings",
    "Policy",
    "evaluate",
    "rollouts",
]

_MODULES: Final = {  # loaded at first use, so that additions can import a part of the package while it joins theirs
    "BatchPolicy": "policies.interface",
    "Episode": "policies.interface",
    "EpisodeResult": "evaluation.scores",
    "Evaluation": "evaluation.run",
    "EvaluationSettings": "evaluation.settings",
    "Policy": "policies.interface",
    "evaluate": "evaluation.run",
    "rollouts": "evaluation.playing",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = found = getattr(import_module(f"magical_mj.{_MODULES[name]}"), name)  # for the next uses
    return found
