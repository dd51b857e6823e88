"""Comparing two policies on the same scenes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from magical_mj.evaluation.reports.results import check_same, check_scenes
from magical_mj.evaluation.reports.statistics import SCORE_TOLERANCE, mean_interval
from magical_mj.evaluation.scores import Score, read
from magical_mj.tasks.registry import VARIANTS
from magical_mj.utils.errors import EvaluationError, SettingsError
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    import pandas as pd

ALL = "all of them"


def choose(which: Path | str) -> tuple[str, list[Score]]:
    """The name and the scores of a policy given as ``DIR``, or as ``DIR:POLICY`` if the folder holds several.

    Raises:
        SettingsError: if the folder holds several policies and none is named, or the named one is not there.
        EvaluationError: if the folder is not an evaluation.
    """
    parts = str(which).split(":")  # names of folders and of policies may hold colons
    splits = [(":".join(parts[:count]), ":".join(parts[count:])) for count in range(len(parts), 0, -1)]
    folder, policy = next((split for split in splits if split[0] and Path(split[0]).is_dir()), splits[0])
    scores = read(Path(folder))
    names = list(dict.fromkeys(score.policy for score in scores))
    if policy not in names if policy else len(names) > 1:
        raise SettingsError(f"{folder} holds {', '.join(names)}: name one of them, as in {folder}:{names[0]}")
    policy = policy or names[0]
    return policy, [score for score in scores if score.policy == policy]


def compare(first: Path | str, second: Path | str) -> pd.DataFrame:
    """How much better the first policy is than the second, in each variant and in all, on the scenes that both played.

    Scores of several runs in one scene are averaged first. The interval of the difference comes from a bootstrap that
    resamples the scenes within each environment; all environments have equal weight.

    Args:
        first: the folder of an evaluation, or ``DIR:POLICY`` if it holds several policies.
        second: likewise.

    Returns:
        A row for each variant, and one for all: the mean scores (`first`, `second`), their `difference` and its 95 %
        interval (`low`, `high`), in how many scenes the first was `better` or `worse`, of how many `scenes` in how
        many `environments`, and how many other scenes only one of them has played (`unpaired`).

    Raises:
        SettingsError: if the choice of policies is ambiguous.
        EvaluationError: if they were scored by different rules or in different kinds of worlds, their seeds' scenes
            differ, or they have no scene in common.
    """
    check_extra("comparisons", "eval")
    import pandas as pd

    sides = [choose(which) for which in (first, second)]
    found = [(score, name) for name, scores in sides for score in scores]
    check_same(found, "rules", "they cannot be compared")
    check_same(found, "worlds", "scores of batched worlds are approximate, and compared among themselves")
    check_scenes(found)
    both = pd.concat([_by_scene(scores) for _, scores in sides], axis=1, keys=["first", "second"])
    paired = both.dropna()
    if paired.empty:
        raise EvaluationError(f"{first} and {second} have no scene in common")
    rows = [
        _row(variant, both, paired) for variant in (*VARIANTS, ALL) if variant == ALL or variant in _variants(paired)
    ]
    return pd.DataFrame(rows)


def _by_scene(scores: Sequence[Score]) -> pd.Series[float]:
    import pandas as pd

    table = pd.DataFrame([(score.variant, score.task, score.seed, score.score) for score in scores])
    table.columns = ["variant", "task", "seed", "score"]
    return table.groupby(["variant", "task", "seed"])["score"].mean()


def _variants(table: pd.DataFrame) -> Any:
    return table.index.get_level_values("variant")


def _row(variant: str, both: pd.DataFrame, paired: pd.DataFrame) -> dict[str, Any]:
    if variant != ALL:
        both, paired = (table[_variants(table) == variant] for table in (both, paired))
    difference = paired["first"] - paired["second"]
    strata = [group.to_numpy() for _, group in difference.groupby(["variant", "task"])]
    means = paired.groupby(["variant", "task"]).mean().mean()
    low, high = mean_interval(strata)
    return {
        "variant": variant,
        "first": float(means["first"]),
        "second": float(means["second"]),
        "difference": float(means["first"] - means["second"]),
        "low": low,
        "high": high,
        "better": int((difference > SCORE_TOLERANCE).sum()),
        "worse": int((difference < -SCORE_TOLERANCE).sum()),
        "scenes": len(paired),
        "environments": len(strata),
        "unpaired": len(both) - len(paired),
    }
