"""What the tests of evaluations share: small ones, and what of them must always be the same."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd

import magical_mj
from magical_mj.evaluation.scores import read

SMALL: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 3}


def evaluate(policy: Any, **settings: Any) -> pd.DataFrame:
    """All that must not depend on how the episodes were played."""
    return magical_mj.evaluate(policy, **{**SMALL, **settings}).drop(columns="seconds")


def rows(folder: Path) -> set[tuple[Any, ...]]:
    return {(score.key, score.score, score.actions, score.failure) for score in read(folder)}
