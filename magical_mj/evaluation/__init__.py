"""Evaluation of agents: scores on the benchmark's scenes, their statistics, reports and comparisons.

`evaluate` plays episodes and writes their scores to files. The folder `reports` makes tables and figures from them.
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
