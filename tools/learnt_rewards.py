"""How well learnt rewards agree with the score, and what policies learn from them: docs/learnt-rewards.md.

    magical-mj evaluate-reward runs/gail-FindDupe runs/airl-FindDupe ... --out FindDupe.csv    (for each task)
    python -m tools.learnt_rewards *.csv
    for reward in gail-FindDupe ...; do
        task=${reward##*-}
        settings="--set reward.run=runs/$reward --set reward.variant=Layout --set ppo.total_steps=100000"
        magical-mj train ppo --tasks $task --preset State $settings --out runs/ppo-$reward
        played="--tasks $task --variants Layout --episodes 50"
        magical-mj evaluate --policy own=runs/$reward,ppo=runs/ppo-$reward $played --out scores/$reward
    done
    python -m tools.research.dense_rewards --out runs --sac 0 --ppo 1000000 --variant Layout --tasks MoveToRegion
    played="--preset State --tasks MoveToRegion --variants Layout --episodes 50"
    policy=ppo=runs/ppo-MoveToRegion-Layout-dense/model.zip
    magical-mj evaluate --policy $policy $played --out scores/dense-MoveToRegion
    python -m tools.learnt_rewards --trained scores/*
    python -m tools.tables

The second command writes docs/learnt-rewards.csv: for each method and environment the two figures of
`magical_mj.learners.rewards`, the rank correlation without the expert's episodes, and the mean score of the method's
own policy in the same scenes. The last but one writes docs/reward-policies.csv: for each method and task, the mean
scores in Layout of the method's own policy, and of one that PPO trained there on the learnt reward, in MoveToRegion for
1,000,000 steps. The rows of the method "dense" are of stable-baselines3's PPO with the package's dense reward, for as
many steps, in MoveToRegion and FixColour.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Final

import pandas as pd

from magical_mj import TASKS
from magical_mj.evaluation.scores import read
from magical_mj.variants import VARIANTS
from tools.pages import ROOT, number, table

FILE: Final = ROOT / "docs" / "learnt-rewards.csv"
POLICIES: Final = ROOT / "docs" / "reward-policies.csv"
SAME_LAYOUT: Final = "MoveToCorner"
"""The task that has no Layout. Its All has nearly the poses of the demo scene, so that policies solve it."""
DENSE: Final = "(dense reward)"
NAMES: Final = {"iq-learn": "IQ-Learn", "gail": "GAIL", "airl": "AIRL", "wgail-gp": "WGAIL-GP", "al": "AL"}


def collect(files: list[Path]) -> None:
    """Replaces the methods in the outputs of `magical-mj evaluate-reward` in the file."""
    from magical_mj.learners.rewards import agreements

    sums = pd.concat(pd.read_csv(file, keep_default_na=False) for file in files)
    where = ["method", "task", "variant"]
    own = sums[(sums["kind"] == "policy") & (sums["player"] == sums["method"])]
    policies = own.groupby(where, sort=False)["score"].mean().rename("policy").reset_index()
    others = agreements(sums[sums["kind"] != "expert"]).drop(columns="auc").rename(columns={"correlation": "others"})
    found = agreements(sums).merge(others, on=where).merge(policies, on=where)
    before = pd.read_csv(FILE)
    kept = before[~before["method"].isin(found["method"])]
    pd.concat([kept, found[before.columns]]).to_csv(FILE, index=False, float_format="%.4f")


def collect_policies(folders: list[Path]) -> None:
    """Writes the file of policies from folders METHOD-TASK of evaluations of policies `own` and `ppo`."""
    rows = [
        {"method": folder.name.rpartition("-")[0], "task": row.task, "policy": row.policy, "score": row.score}
        for folder in folders
        for row in read(folder)
    ]
    scores = pd.DataFrame(rows).groupby(["method", "task", "policy"])["score"].mean().unstack()
    scores.to_csv(POLICIES, float_format="%.4f")


def compared() -> dict[str, pd.DataFrame]:
    """The rank correlations without the expert's episodes, as means over tasks with new layouts, by these tasks.

    Rows are the methods that were trained in all of them, columns variants. Environments where only the expert scores
    have no correlation.
    """
    found = pd.read_csv(FILE).query("task != @SAME_LAYOUT")
    means = {}
    for tasks in found.groupby("method")["task"].agg(lambda names: tuple(task for task in TASKS if task in {*names})):
        rows = found[found["task"].isin(tasks)]
        methods = [name for name in NAMES if {*tasks} <= {*rows.loc[rows["method"] == name, "task"]}]
        of_method = rows.groupby(["method", "variant"])["others"].mean().unstack()
        means[", ".join(tasks)] = of_method.loc[methods, [name for name in VARIANTS if name in of_method]]
    return dict(sorted(means.items(), key=lambda item: -len(item[0])))


def policies() -> pd.DataFrame:
    """The mean scores in Layout. Rows are methods and policies (`own` or `ppo`), columns tasks."""
    return pd.read_csv(POLICIES).set_index(["method", "task"]).stack().unstack("task")


def tables() -> dict[str, str]:
    """The tables by name."""
    groups = compared()
    variants = [*next(iter(groups.values()))]
    rows: list[tuple[str, ...]] = []
    for tasks, found in groups.items():
        rows.append((f"**{tasks}**", *[""] * len(variants)))
        rows += [(NAMES[str(name)], *map(number, values)) for name, *values in found.itertuples()]
    scores = policies()
    tasks = [task for task in TASKS if task in scores]
    trained = [
        (name, *(", ".join(number(scores[task][method, policy]) for policy in ("own", "ppo")) for task in tasks))
        for method, name in NAMES.items()
        if method in scores.index
    ]
    trained.append((DENSE, *(number(scores[task].get(("dense", "ppo"), math.nan)) for task in tasks)))
    return {"learnt": table(("Method", *variants), rows), "trained": table(("Reward of", *tasks), trained)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("paths", nargs="+", type=Path)
    parser.add_argument("--trained", action="store_true", help="the paths are folders of evaluations")
    options = parser.parse_args()
    (collect_policies if options.trained else collect)(options.paths)
