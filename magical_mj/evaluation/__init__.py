"""Evaluating agents: scores on the benchmark's scenes, their statistics, reports and comparisons.

`evaluate` plays episodes; the modules `report` and `compare` make tables and figures from the files that it writes.
"""

from __future__ import annotations

from magical_mj.evaluation.playing import Outcome
from magical_mj.evaluation.run import Evaluation, evaluate
from magical_mj.evaluation.scores import Score
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.evaluation.side_by_side import rollouts
from magical_mj.policies.interface import Episode, Policy
from magical_mj.policies.requirements import BatchPolicy

__all__ = [
    "BatchPolicy",
    "Episode",
    "Evaluation",
    "EvaluationSettings",
    "Outcome",
    "Policy",
    "Score",
    "evaluate",
    "rollouts",
]
