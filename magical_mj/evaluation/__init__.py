"""Evaluating agents: scores on the benchmark's scenes, their statistics, reports and comparisons.

`evaluate` plays episodes; the modules `report` and `compare` make tables and figures from the files that it writes.
"""

from __future__ import annotations

from magical_mj.evaluation.rollouts import rollouts
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
