"""The pages about the learners: what they show in Python runs, and the experiment can be read."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from magical_mj.evaluation.reports.intervals import estimate
from magical_mj.leaderboard.entry import read_entry
from magical_mj.learners import plan_experiment
from tests.helpers.learners import is_done
from tools import learnt_rewards, pretraining
from tools.pretraining import Start

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


def test_a_torch_loop_of_ones_own_ends_with_a_score(capsys: pytest.CaptureFixture[str]) -> None:
    example = EXAMPLE.with_name("own_torch.py")
    assert len(example.read_text().splitlines()) <= 50
    runpy.run_path(str(example), run_name="__main__")
    scores = dict(line.split() for line in capsys.readouterr().out.splitlines()[1:4])
    assert float(scores["Demo"]) >= 0.9
    assert float(scores["Layout"]) < 0.5


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


def test_statements_about_learnt_rewards_agree_with_the_figures() -> None:
    text = " ".join((DOCS / "learnt-rewards.md").read_text().split())
    found = next(iter(learnt_rewards.compared().values()))
    assert found[["Layout", "All"]].to_numpy().max() < found[["Demo", "Colour"]].to_numpy().min()
    rows = pd.read_csv(learnt_rewards.FILE).set_index(["method", "task", "variant"])
    assert f"WGAIL-GP's AUC is {rows['auc']['wgail-gp', 'MatchRegions', 'Layout']:.2f}." in text
    same = rows["others"][:, "MoveToCorner", "All"]
    assert f"the correlations in All are {same.min():.2f} to {same.max():.2f}." in text
    trained = learnt_rewards.policies()["MoveToRegion"][:, "ppo"]
    best = trained.drop("dense").max()
    replay = [row for row in read_entry(DOCS.parent / "results" / "replay").counted if row.seed < 50]
    blind = np.mean([row.score for row in replay if (row.task, row.variant) == ("MoveToRegion", "Layout")])
    assert f"no more than a replay in MoveToRegion's new layouts** ({blind:.2f})" in text
    assert best <= blind
    assert (
        f"PPO reaches {trained['dense']:.2f} with the dense reward, and at most {best:.2f} with a learnt one." in text
    )


def test_statements_about_pretraining_agree_with_the_figures() -> None:
    text = " ".join((DOCS / "pretraining.md").read_text().split())
    starts = pretraining.stored()
    # As many batches on the held-out task as those of both steps together.
    control = {
        preset: Start(preset, "scratch", 0, batches) for preset, batches in (("State", 9_000), ("LoRes4E", 3_000))
    }
    gains = {
        (start, variant): pretraining.gain(start, control[start.preset], variant)
        for start in starts
        if start.start != "scratch"
        for variant in ("Demo", "Layout", "Colour", "All")
    }
    better = {(start.preset, start.tasks, variant) for (start, variant), (_, low, _) in gains.items() if low > 0}
    assert better == {("State", 7, "Colour")}
    assert f"Of {len(gains)} comparisons" in text
    found = [
        [
            f"{mean:+.2f} [{low:+.2f}, {high:+.2f}]"
            for variant in ("Demo", "Colour")
            for mean, low, high in [gains[start, variant]]
        ]
        for start in (Start("State", "cloning", 7, 3_000), Start("LoRes4E", "cloning", 7, 1_000))
    ]
    assert f"from states by {found[0][0]} in Demo and {found[0][1]} in Colour" in text
    assert f"from images by {found[1][0]} and {found[1][1]}" in text
    inverse, explained = (pretraining.learnt(f"{objective}-random") for objective in ("inverse", "next"))
    assert f"Inverse dynamics recognises {inverse:.0%} of the actions".replace("%", " %") in text
    assert f"predicts {explained:.0%} of the next frame's change".replace("%", " %") in text
    own, *frozen = (
        estimate(pretraining.cells(starts, Start("LoRes4E", *row, 1_000), "Demo")).value
        for row in (("scratch", 0), ("inverse-random", 6), ("next-random", 6), ("untrained", 6))
    )
    shown = [f"{mean:.2f}" for mean in (*frozen, own)]
    assert "score {} and {} in Demo, with random convolutions {}, and with their own ones {}.".format(*shown) in text
