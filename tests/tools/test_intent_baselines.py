"""The official evaluation of intents, side effects, and reports with rows by set."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation.reports.intervals import Cell, estimate
from magical_mj.evaluation.scores import parse, read
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.intents import shortcuts
from magical_mj.intents.by_set import by_intent, floors, rows, set_of, with_side_effects
from magical_mj.intents.names import TESTS, tasks_in
from magical_mj.tasks.registry import task_name, task_spec
from magical_mj.utils.errors import IntentError
from tests.helpers.commands import Shell
from tests.helpers.evaluations import TEMPLATE
from tools.intent_baselines import BASELINES, EPISODES
from tools.intent_inference import learnt
from tools.pages import ROOT
from tools.stored_episodes import stored

TASK = "intent:in(colour=red, region)"


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation of a shortcut that moves all blocks, and of doing nothing, in an intent and one of a test set."""
    out = tmp_path_factory.mktemp("played") / "run"
    policies = {"all": shortcuts["all blocks"], "noop": "noop"}
    tasks = [TASK, "intent:combined/2"]
    magical_mj.evaluate(policies, tasks=tasks, variants="Demo,Layout", episodes=1, out=out, jobs=1)
    return out


def test_the_official_evaluation_has_two_scenes_of_layout_and_all() -> None:
    settings = EvaluationSettings(tasks="intents")
    assert settings.episodes == 2
    assert len(settings.environments) == 500
    assert {variant for _, variant in settings.environments} == {"Layout", "All"}
    assert {set_of(task) for task, _ in settings.environments} == set(TESTS)
    assert EvaluationSettings(tasks="intents", episodes=1, variants="Demo").environments[0][1] == "Demo"


def test_an_episode_records_the_blocks_that_the_intent_does_not_name(played: Path) -> None:
    episodes = {(one.policy, one.task, one.variant): one for one in read(played)}
    moved = episodes["all", TASK, "Layout"]
    assert moved.score == 1.0
    assert moved.others_moved
    assert episodes["noop", TASK, "Layout"].others_moved == 0
    older = replace(moved, others_moved=None)
    assert parse(older.line()) == older
    assert with_side_effects(older) == moved


def test_rows_tell_sets_and_variants_apart(played: Path) -> None:
    found = {(row.method, row.set, row.variants): row for row in rows(read(played))}
    assert len(found) == 8
    row = found["all", "train", "Layout"]
    assert (row.intents, row.runs, row.episodes, row.floor) == (1, 1, 1, None)
    assert [round(row.values[name].value, 2) for name in ("success", "clean success", "score")] == [1.0, 0.0, 1.0]
    assert found["noop", "combined", "Demo"].values["success"].value == 0.0
    assert found["noop", "combined", "Demo"].floor is None  # it was measured in Layout and All
    own = found["noop", "combined", "Layout"].floor
    assert own is not None
    assert own[1] == max(floors()["combined"].values())


def test_a_report_has_a_page_of_sets(played: Path, tmp_path: Path, shell: Shell) -> None:
    assert shell("report", played, "--out", tmp_path / "report", "--intents")[0] == 0
    page = (tmp_path / "report" / "report.md").read_text("utf-8")
    assert page.index("| Set | Variants | intents |") < page.index("## Environments")
    assert "Intents by set" in page
    assert "outside the benchmark" not in page
    table = pd.read_csv(tmp_path / "report" / "intents" / "intents.csv")
    assert len(table) == 8
    assert set(table["set"]) == {"combined", "train"}


def test_findings_about_baselines_are_those_of_the_episodes() -> None:
    page = " ".join((ROOT / "docs" / "intents-evaluation.md").read_text("utf-8").split())
    episodes = stored(EPISODES)
    every = {name: [one for one in episodes if one.policy == name] for name in BASELINES}

    def cell(name: str, measure: str, weight: float = 1.0) -> Cell:
        tasks = sorted({one.task for one in every[name]})
        return Cell(by_intent(every[name], measure, tasks, [0]), weight, name, "intents")

    count, (value, low, high) = len(every["expert"]), estimate([cell("expert", "success")])
    assert value == 1.0
    assert f"solves all {count} episodes in the first ten intents of each set ({low:.2f} to {high:.2f})" in page
    for name in ("circling", "random"):
        value, low, high = estimate([cell(name, "success")])
        assert value == 0.0
        assert f"each solve 0 of {len(every[name])} episodes ({low:.2f} to {high:.2f})" in page

    def more(name: str, other: str, measure: str = "score") -> str:
        """The difference of two baselines."""
        pair = estimate([cell(name, measure), cell(other, measure, -1.0)])
        return "{:.2f} ({:.2f} to {:.2f})".format(*pair)

    several, one = (f"{{}}-{kind}" for kind in ("4-contrasting", "1"))
    kinds = ("goals", "pictures", "demonstrations-policy")
    gains = {kind: more(several.format(kind), one.format(kind)) for kind in kinds}
    assert f"higher by {gains['goals']} from four contrasting scenes than from one" in page
    best, states = several.format("pictures"), several.format("inference")
    solved = sum(one.score == 1.0 for one in every[best])
    assert f"it solves {solved} of {len(every[best])} episodes" in page
    assert f"more than from one scene, by {gains['pictures']}" in page
    assert f"moving all blocks does, by {more(best, 'all-blocks')}" in page
    assert f"with demonstrations of another intent, by {more(best, 'pictures-wrong')}" in page
    assert f"From states the score is higher by {more(states, best)}" in page
    assert f"with the simulator by another {more(several.format('goals'), states)}" in page
    learnt = [one for one in episodes if "-policy" in one.policy]
    assert f"solve {sum(one.score == 1.0 for one in learnt)} of {len(learnt)} episodes" in page
    assert f"four contrasting scenes than from one: by {gains['demonstrations-policy']}" in page


def test_scorers_choose_better_from_more_scenes_and_search_no_better() -> None:
    text = learnt()
    assert text.strip() in (ROOT / "docs" / "intents-evaluation.md").read_text("utf-8")
    rows = [line.split("|")[1:-1] for line in text.splitlines() if "four" in line]
    assert len(rows) == 2
    for _, _, chosen, *_, score, _ in rows:
        low, high = map(float, re.findall(r"-?\d\.\d+", score)[1:])
        assert float(re.findall(r"-?\d\.\d+", chosen)[1]) > 0.0
        assert low < 0.0 < high


def test_members_of_sets_with_other_demo_scenes_are_in_their_set() -> None:
    task = tasks_in("seen")[3]
    assert set_of(f"intent:{task}") == "seen"
    assert set_of(f"intent:{replace(task, demos=4, contrasting=True)}") == "seen"
    assert set_of(f"intent:{task.intent}") == "train"


def test_policies_can_receive_the_name_of_an_intent() -> None:
    assert EvaluationSettings(tasks="MoveToRegion", like="intent:robot in()").like == "intent:robot in()"
    with pytest.raises(IntentError):
        EvaluationSettings(tasks="MoveToRegion", like="intent:robot flies()")
    assert task_spec(TASK).title == TASK
    assert task_spec(TASK).instruction == "Bring all red blocks into the region."


def test_demonstrations_in_other_scenes_have_rows_of_their_own() -> None:
    plain, several = (f"intent:combined/3{settings}" for settings in ("", " [demos=4, contrasting]"))
    episodes = [replace(TEMPLATE, task=task_name(task), variant="All") for task in (plain, several)]
    found = {row.set: row for row in rows(episodes)}
    assert set(found) == {"combined", "combined [demos=4, contrasting]"}
    assert {row.intents for row in found.values()} == {1}
    assert len({row.floor for row in found.values()}) == 1
