"""The paper's own results, in the form of a report's tables."""

from __future__ import annotations

from importlib.resources import files
from typing import TYPE_CHECKING, Final

import numpy as np

from magical_mj.evaluation.reports.statistics import COLUMNS

if TYPE_CHECKING:
    import pandas as pd

PUBLISHED_RULES: Final = "released"
"""The paper's results were scored by the authors' code, in its simulator: AL scores 0.00 on ClusterShape's demo, where
by the paper's formula an agent that does nothing has 0.25."""
PUBLISHED_RUNS: Final = 5
PUBLISHED_EPISODES: Final = 100
"""Of each run in each environment."""


def published_results() -> pd.DataFrame:
    """The results in the paper (Toyer et al. 2020, appendix): 11 methods in all environments.

    Returns:
        A frame with method, task, variant, and the mean and standard deviation over the mean scores of five runs.
    """
    import pandas as pd

    with (files("magical_mj.evaluation") / "paper_results.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file).rename(columns={"method": "policy"})


def published_by_environment() -> pd.DataFrame:
    """The published results with the columns of `statistics.by_environment`."""
    table = published_results()
    table["runs"], table["episodes"], table["failures"] = PUBLISHED_RUNS, PUBLISHED_RUNS * PUBLISHED_EPISODES, 0
    return _completed(table)


def published_by_variant() -> pd.DataFrame:
    """The published results over tasks, as in the paper's Table 1, with the columns of `statistics.by_variant`."""
    import pandas as pd

    rows = []
    for (policy, variant), group in published_results().groupby(["policy", "variant"], sort=False):
        means, stds = group["mean"].to_numpy(float), group["std"].to_numpy(float)
        spread = float(np.sqrt((stds**2).mean() + means.var()))  # of all run means: within tasks and between them
        counts = {
            "tasks": len(group),
            "runs": PUBLISHED_RUNS,
            "episodes": PUBLISHED_RUNS * PUBLISHED_EPISODES * len(group),
        }
        rows.append({"policy": policy, "variant": variant, "mean": means.mean(), "std": spread, **counts})
    return _completed(pd.DataFrame(rows))


def _completed(table: pd.DataFrame) -> pd.DataFrame:
    return table.assign(**{name: np.nan for name in COLUMNS if name not in table})
