"""How well learnt rewards agree with the score: the table of docs/learners.md.

    magical-mj evaluate-reward runs/gail-FindDupe runs/airl-FindDupe ... --out FindDupe.csv    (for each task)
    python -m tools.learnt_rewards *.csv
    python -m tools.tables

The second command writes docs/learnt-rewards.csv: for each method and environment the two figures of
`magical_mj.learners.rewards`, the rank correlation without the expert's episodes, and the mean score of the method's
own policy in the same scenes.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import pandas as pd

from magical_mj.variants import VARIANTS
from tools.pages import ROOT, number, table

FILE: Final = ROOT / "docs" / "learnt-rewards.csv"
SAME_LAYOUT: Final = "MoveToCorner"
"""The task that has no Layout. Its All has nearly the poses of the demo scene, so that policies solve it."""
NAMES: Final = {"iq-learn": "IQ-Learn", "gail": "GAIL", "airl": "AIRL", "wgail-gp": "WGAIL-GP"}


def collect(files: list[Path]) -> None:
    """Writes the file from the outputs of `magical-mj evaluate-reward`."""
    from magical_mj.learners.rewards import agreements

    sums = pd.concat(pd.read_csv(file, keep_default_na=False) for file in files)
    where = ["method", "task", "variant"]
    own = sums[(sums["kind"] == "policy") & (sums["player"] == sums["method"])]
    policies = own.groupby(where, sort=False)["score"].mean().rename("policy").reset_index()
    others = agreements(sums[sums["kind"] != "expert"]).drop(columns="auc").rename(columns={"correlation": "others"})
    agreements(sums).merge(others, on=where).merge(policies, on=where).to_csv(FILE, index=False, float_format="%.4f")


def means() -> pd.DataFrame:
    """The rank correlations without the expert's episodes, as means over the tasks with new layouts.

    Rows are methods, columns variants. Environments in which only the expert scores have no correlation.
    """
    found = pd.read_csv(FILE).query("task != @SAME_LAYOUT")
    return found.groupby(["method", "variant"])["others"].mean().unstack().reindex(NAMES)


def tables() -> dict[str, str]:
    """The table by name."""
    found = means()
    variants = [variant for variant in VARIANTS if variant in found]
    rows = [(name, *(number(found.loc[method, variant]) for variant in variants)) for method, name in NAMES.items()]
    return {"learnt": table(("Method", *variants), rows)}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("files", nargs="+", type=Path)
    collect(parser.parse_args().files)
