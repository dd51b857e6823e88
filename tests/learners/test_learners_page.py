"""The pages about the learners: what they show in Python runs, and the experiment can be read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from magical_mj.evaluation.entry import read_entry
from magical_mj.learners import plan_experiment
from tests.helpers.learners import is_done
from tools import demonstration_sets, learnt_rewards, pretraining

DOCS = Path(__file__).parents[2] / "docs"
EXAMPLE = DOCS.parent / "examples" / "own_learner.py"


def block(page: str, language: str) -> str:
    """The only one in this language."""
    (found,) = re.findall(rf"```{language}\n(.*?)```", (DOCS / page).read_text(), re.DOTALL)
    return found


def test_a_method_of_ones_own_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = EXAMPLE.read_text().split('"""', 2)[2].lstrip()
    assert len(code.splitlines()) <= 66
    monkeypatch.chdir(tmp_path)
    shown: dict[str, Any] = {"__name__": "page"}
    exec(compile(code, str(EXAMPLE), "exec"), shown)
    assert is_done(tmp_path / "runs" / "forgetful-0")
    assert len(shown["scores"]) == 4


def test_the_experiment_can_be_read(tmp_path: Path) -> None:
    file = tmp_path / "experiment.toml"
    file.write_text(block("learners.md", "toml"))
    planned = plan_experiment(file, tmp_path)
    assert len({run.name for run in planned}) == len(planned) == 2 * 2 * 5
    assert {run.method for run in planned} == {
        "BC (ST), ours, quick",
        "GAIL (ST), ours, quick, ppo.clip 0.2",
    }
    assert {run.settings.ppo.clip for run in planned} == {0.2}


def test_what_it_says_about_learnt_rewards_is_in_the_figures() -> None:
    text = " ".join((DOCS / "learners.md").read_text().split())
    found = learnt_rewards.means()
    assert found[["Layout", "All"]].to_numpy().max() < found[["Demo", "Colour"]].to_numpy().min()
    rows = pd.read_csv(learnt_rewards.FILE).set_index(["method", "task", "variant"])
    assert f"WGAIL-GP's AUC is {rows['auc']['wgail-gp', 'MatchRegions', 'Layout']:.2f}." in text
    same = rows["others"][:, "MoveToCorner", "All"]
    assert f"the correlations in All are {same.min():.2f} to {same.max():.2f}." in text


def test_what_it_says_about_pretraining_is_in_the_figures() -> None:
    text = " ".join((DOCS / "learners.md").read_text().split())
    found = ", ".join(
        f"{mean:+.2f} [{low:+.2f}, {high:+.2f}] in {variant}"
        for variant in ("Demo", "Layout", "Colour", "All")
        for mean, low, high in [pretraining.gain(7, variant)]
    )
    assert f"seven other tasks change the mean score by {found}" in text.replace(" and ", ", ")
    longer = demonstration_sets.scores_of(read_entry(DOCS.parent / "results" / "state-bc").episodes)
    means = [np.mean([run.mean() for run in longer[task, "Demo"].values()]) for task in ("FixColour", "MatchRegions")]
    assert f"6,000 batches score {np.mean(means):.2f} in Demo." in text
