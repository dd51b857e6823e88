"""Attribution of stored episodes: what they were after, where they were lost, and the report that says so."""

from __future__ import annotations

import re
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from PIL import Image

import magical_mj
from magical_mj import Engine, demos
from magical_mj.actions import NOOP
from magical_mj.evaluation.reports.floors import refuting_seeds
from magical_mj.evaluation.reports.tables import NONE
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.experts import Expert
from magical_mj.intents import EIGHT, parse
from magical_mj.intents.attribution import (
    FAILURES,
    Attribution,
    attribute,
    last_solvable_step,
    remaining,
    shown_task,
    task_rivals,
    unfit,
)
from magical_mj.intents.contrast import simplest_rivals
from magical_mj.intents.explained import Explanation, write_explanation
from magical_mj.intents.first_blocks import first_block_table
from magical_mj.intents.readings import ENDINGS
from magical_mj.leaderboard.entry import read_entry
from magical_mj.policies.interface import actions_of, letters_of
from tests.helpers.commands import Shell
from tests.helpers.evaluations import TEMPLATE
from tools import last_solvable
from tools.attribution import CHOICES, COLUMNS, ENDED, RESULTS, ROOT, covered, endings, measured_row, of_unsolved
from tools.pages import filled

CLOSE_GRIPPER = 9
UNLEARNT = ("noop", "random", "replay", "state-goals")


def played(task: str, variant: str, seed: int, actions: list[int]) -> EpisodeResult:
    """The record of an episode with these actions; the rest of its steps does nothing."""
    with closing(Engine(task, variant, seed=seed)) as engine:
        actions = [*actions, *[NOOP] * ((engine.horizon or 0) - len(actions))][: engine.horizon]
        for action in actions:
            engine.step(action)
        made: dict[str, Any] = {"score": engine.score(), "steps": len(actions), "actions": letters_of(actions)}
    return replace(TEMPLATE, policy="mine", task=task, variant=variant, seed=seed, **made)


def attributed(episode: EpisodeResult) -> Attribution:
    (result,) = attribute([episode], jobs=1)
    assert isinstance(result, Attribution), result
    return result


def test_the_rivals_of_a_failed_episode_hold_at_its_end_and_not_at_its_start() -> None:
    entry = read_entry(RESULTS / "pixels-bc-quick")
    episodes = [one for one in entry.episodes if one.task == "FixColour" and one.variant == "Colour" and one.run == 0][
        :12
    ]
    results = {one.episode.seed: one for one in attribute(episodes, jobs=2) if isinstance(one, Attribution)}
    assert len(results) == len(episodes)
    rivals, reached = task_rivals("FixColour"), 0
    for episode in episodes:
        result = results[episode.seed]
        with closing(Engine("FixColour", "Colour", seed=episode.seed)) as engine:
            for action in actions_of(episode.actions):
                engine.step(action)
            assert (result.initial, result.final) == (engine.initial_scene, engine.scene)
        assert sum(result.ending.values()) == pytest.approx(1.0)
        assert set(result.ending) <= set(ENDINGS)
        assert EIGHT["FixColour"].holds(result.initial, result.final) == (episode.score == 1.0)
        assert result.episode.score < 1.0 or not result.rivals
        if not result.rivals:
            continue
        reached += 1
        assert sum(result.rivals.values()) == pytest.approx(1.0)
        for number, rival in enumerate(rivals):
            pursued = rival.holds(result.initial, result.final) and not rival.holds(result.initial, result.initial)
            assert (number in result.rivals) == (pursued and rival.grounded(result.initial)), rival
        first, second = list(result.rivals)[:2]
        ratio = 2.0 ** (rivals[second].bits - rivals[first].bits)
        assert result.rivals[first] / result.rivals[second] == pytest.approx(ratio)
    assert reached


def test_a_demonstration_moves_a_right_block_first() -> None:
    demonstration = demos.load("FixColour")[0]
    right = attributed(played("FixColour", "Demo", demonstration.seed, list(demonstration.actions)))
    assert right.right_first
    assert not attributed(played("FixColour", "Demo", 0, [])).right_first


def test_the_report_begins_with_how_often_a_right_block_moves_first() -> None:
    """By hand: in run 0 twice, solved once; in run 1 never. Where the demonstrated place is right, nothing counts."""
    wrong = sorted(refuting_seeds()["FixColour", "Colour"])[:2]
    right = next(seed for seed in range(100) if seed not in refuting_seeds()["FixColour", "Colour"])
    first, second, same = (attributed(played("FixColour", "Colour", seed, [])) for seed in (*wrong, right))
    (table,) = first_block_table(
        [
            replace(first, right_first=True, episode=replace(first.episode, score=1.0)),
            replace(second, right_first=True),
            replace(first, episode=replace(first.episode, run=1)),
            replace(same, right_first=True),
        ]
    )
    ((name, right_first, solved, episodes),) = table.groups[0][1]
    assert (name, episodes) == ("mine", "3")
    assert right_first.startswith("0.50 [")
    assert solved.startswith("0.50 [")
    assert [row[2] for table in first_block_table([first]) for row in table.groups[0][1]] == [NONE]
    assert [*first_block_table([attributed(played("MoveToRegion", "Demo", 0, []))])] == []


def test_remaining_is_the_length_of_the_rest_of_the_plan() -> None:
    episode = played("MoveToRegion", "Demo", 0, [])
    result = attributed(episode)
    assert result.ending == {"nothing": 1.0}
    assert result.rivals == {}
    region, robot = result.initial.regions[0], result.initial.robot
    edge = max(abs(robot.x - region.centre[0]), abs(robot.y - region.centre[1])) - region.width / 2
    assert edge < result.remaining < edge + 0.6
    demonstration = demos.load("MoveToRegion")[0].scenes()
    assert remaining(episode, (demonstration[0], demonstration[-1])) == 0.0


def test_episodes_that_cannot_be_explained_say_why() -> None:
    good = played("MoveToRegion", "Demo", 0, [])
    for changed, why in (
        (replace(good, shift="latency:1"), "the shift latency:1"),
        (replace(good, failure="it broke"), "the policy failed"),
        (replace(good, task="SweepToTop"), "no intent in the language"),
        (replace(good, wrap="mine:Wrapper"), "in the wrapper"),
        (replace(good, worlds="batched"), "batched environments"),
    ):
        assert why in (unfit(changed) or "")
    assert unfit(good) is None
    (result,) = attribute([replace(good, score=0.5)], jobs=1)
    assert not isinstance(result, Attribution)
    assert "its actions lead to 0" in result[1]


def test_methods_that_were_given_other_demonstrations_have_rows_of_their_own(tmp_path: Path) -> None:
    result = attributed(played("MoveToRegion", "Demo", 0, []))
    given = ("4 demonstrations", "8 demonstrations")
    episodes = [replace(result.episode, given=text) for text in given]
    write_explanation(Explanation([replace(result, episode=episode) for episode in episodes]), tmp_path)
    rows = pd.read_csv(tmp_path / "endings.csv")
    assert rows["policy"].tolist() == [f"{result.episode.policy}, {text}" for text in given]
    assert rows["episodes"].tolist() == [1, 1]


def test_endings_in_demo_are_summed_apart(tmp_path: Path) -> None:
    """By hand: nothing is done in Demo, and the region is reached once in two episodes of Layout."""
    demo, layout = (attributed(played("MoveToRegion", variant, 0, [])) for variant in ("Demo", "Layout"))
    solved = replace(layout, ending={"intended": 1.0})
    for results, sums in (([demo, layout, solved], ["all Demo", "all others"]), ([layout, solved], ["all"])):
        write_explanation(Explanation(results), tmp_path)
        page = (tmp_path / "explained.md").read_text("utf-8")
        assert re.findall(r"\| (all[ \w]*) \|", page)[: len(sums)] == sums
        assert f"| {sums[-1]} | 2 | 50 | 50 |" in page


def test_diagnose_says_which_rival_a_policy_pursued(tmp_path: Path) -> None:
    """The expert pursues one of the ten simplest rivals, in a scene that refutes it."""
    intent = parse("in(colour=red, region)")
    task, (rival, *_) = f"intent:{intent}", simplest_rivals(intent, intent.spec().demo)
    with closing(Engine(task, "Diagnose", seed=0)) as engine:
        expert, actions = Expert(engine, f"intent:{rival}"), list[int]()
        while not engine.step(action := expert()):
            actions.append(action)
    result = attributed(played(task, "Diagnose", 0, actions))
    assert result.episode.score < 1.0
    assert task_rivals(task).index(rival) in result.rivals
    write_explanation(Explanation([result]), tmp_path)
    rows = pd.read_csv(tmp_path / "rivals.csv").set_index("rival")
    assert rows.loc[str(rival), "reached"] == 1.0
    assert rows.loc[str(rival), "sentence"] == rival.sentence
    assert rows["reached"].idxmax() in map(str, simplest_rivals(intent, intent.spec().demo))
    assert rows["task"].unique().tolist() == [task]
    page = (tmp_path / "explained.md").read_text("utf-8")
    assert rival.sentence[:-1] in page
    for target in re.findall(r"\]\(([^)]+)\)", page):
        assert (tmp_path / target).exists(), target


def test_rivals_are_those_that_the_given_demonstrations_leave() -> None:
    task = "intent:in(colour=red, region)"
    episode = played(task, "Layout", 0, [])
    several = replace(episode, given="4 demonstrations in 4 contrasting scenes")
    assert unfit(several) is None
    assert shown_task(episode) == task
    assert shown_task(replace(episode, given="8 demonstrations in 2 scenes")) == f"{task} [demos=2]"
    assert shown_task(several) == f"{task} [demos=4, contrasting]"
    assert len(task_rivals(shown_task(several))) < len(task_rivals(task))
    results = list(attribute([episode, several], jobs=1))
    assert [result.episode.given for result in results] == ["", several.given]


def test_the_last_solvable_step_is_before_an_episode_stops_trying() -> None:
    demonstration = demos.load("MoveToRegion")[0]
    actions = demonstration.actions.tolist()
    assert last_solvable_step(attributed(played("MoveToRegion", "Demo", 0, []))).failure == "did nothing"
    there = last_solvable_step(attributed(played("MoveToRegion", "Demo", 0, actions[:8])))
    assert there.failure == "ran out of time"
    horizon = len(there.attribution.episode.actions)
    assert there.last is not None
    assert 0 < there.last < horizon
    assert (
        last_solvable_step(attributed(played("MoveToRegion", "Layout", 7, actions))).failure == "pursued another goal"
    )
    closed = played("MoveToCorner", "Demo", 0, [CLOSE_GRIPPER] * 5)
    assert attributed(closed).ending == {"nothing": 1.0}
    assert (
        last_solvable_step(attributed(played("MoveToRegion", "Demo", 0, [CLOSE_GRIPPER] * 5))).failure == "did nothing"
    )


def test_a_report_explains_what_policies_did(tmp_path: Path, shell: Shell) -> None:
    small: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 2, "jobs": 1}
    magical_mj.evaluate("noop", out=tmp_path / "noop", **small)
    magical_mj.evaluate("expert", out=tmp_path / "expert", **small)
    code, _, error = shell(
        *("report", tmp_path / "noop", tmp_path / "expert", "--out", tmp_path / "page", "--videos"),
        *("--explain", "--last-solvable", 1, "--jobs", 1),
    )
    assert (code, error) == (0, "")
    folder = tmp_path / "page" / "explained"
    endings = pd.read_csv(folder / "endings.csv").set_index("policy")
    assert endings.loc["noop", "nothing"] == endings.loc["expert", "intended"] == 1.0
    rivals = pd.read_csv(folder / "rivals.csv")
    assert rivals[["policy", "failed", "rival", "share"]].to_numpy().tolist() == [
        ["noop", 2, "none of the rivals", 1.0]
    ]
    page = (folder / "explained.md").read_text("utf-8")
    assert page.startswith("# Which goal did a policy pursue?\n")
    assert "did nothing" in page
    assert re.search(r"\n\nThis task has no rivals. In unsolved episodes, the moves .* 0\.\d+ world units", page)
    assert not re.search(r"None of the rivals|\| *(Rival|This task)", page)
    for target in re.findall(r"\]\(([^)]+)\)", page):
        assert (folder / target.replace("%20", " ")).exists(), target
    assert "](../best-noop-MoveToRegion.mp4)" in page
    with Image.open(folder / "noop-MoveToRegion-1.png") as picture:
        assert picture.height == 128
    assert "explained/explained.md" in (tmp_path / "page" / "report.md").read_text("utf-8")
    refusal = shell.fails(2, "report", tmp_path / "noop", "--last-solvable", 1)
    assert "--last-solvable has an effect only with --explain" in refusal
    sweeping = replace(played("MoveToRegion", "Demo", 0, []), task="SweepToTop")
    (tmp_path / "noop" / "scores.jsonl").write_text(sweeping.line())
    refusal = shell.fails(2, "report", tmp_path / "noop", "--explain")
    assert "no episode can be explained: SweepToTop has no intent in the language" in refusal


def test_the_file_of_all_entries_is_what_a_replay_gives() -> None:
    rows = pd.read_csv(ENDED, dtype=str, keep_default_na=False)
    assert list(rows.columns) == list(COLUMNS)
    numbers = rows[[*ENDINGS]].astype(float).sum(axis=1)
    np.testing.assert_allclose(numbers, rows["episodes"].astype(float), atol=1e-3)
    known = rows.set_index(["entry", "task"]).loc[("pixels-bc-quick", "MoveToRegion")]
    entry = read_entry(RESULTS / "pixels-bc-quick")
    episodes = [one for one in covered(entry) if one.task == "MoveToRegion"]
    assert measured_row("MoveToRegion", episodes) == ["MoveToRegion", *known.tolist()]


def test_the_page_says_what_learners_without_success_did() -> None:
    """In the tasks where wrong blocks can be moved, without policies that do not look or plan in a simulator."""
    page = " ".join((ROOT / "docs" / "failures.md").read_text("utf-8").split())
    rows = pd.read_csv(ENDED, dtype=str, keep_default_na=False)
    learners = rows[~rows["entry"].isin(UNLEARNT)]
    tasks = [learners[learners["task"] == task].to_dict("records") for task in CHOICES]
    wrong, some, none = (f"{100 * part:.0f} %" for part in of_unsolved(row for task in tasks for row in task))
    total = sum(int(row["failed"]) for task in tasks for row in task)
    assert f"{total:,} unsolved episodes" in page
    assert f"{wrong} moved only wrong blocks, {some} an intended one, and {none} none" in page
    among = rows[rows["task"].isin(CHOICES)]
    groups = (among[~among["entry"].isin(UNLEARNT)], *(among[among["entry"] == name] for name in ("replay", "random")))
    parts = [of_unsolved(group.to_dict("records")) for group in groups]
    alone = [f"{100 * wrong / (wrong + some):.0f} %" for wrong, some, _ in parts]
    assert "a block, {} moved only wrong ones (a replay {}, random actions {})".format(*alone) in page
    own = ", ".join(f"{100 * of_unsolved(task)[0]:.0f} % in {name}" for name, task in zip(CHOICES, tasks, strict=True))
    assert own in page
    block = page.partition("<!-- endings: written by python -m tools.attribution --> ")[2].partition(" <!--")[0]
    assert block == " ".join(endings().split())


def test_the_table_of_last_solvable_steps_is_that_of_the_file() -> None:
    rows = last_solvable.stored()
    assert len({row.place for row in rows}) == len(rows)
    assert all(row.failure in FAILURES and (row.last is None or 0 <= row.last < row.steps) for row in rows)
    page = last_solvable.PAGE.read_text("utf-8")
    assert filled(page, {"lost": last_solvable.losses(rows)}, last_solvable.COMMAND) == page
    assert f"{len(rows)} unsolved episodes of two tasks" in " ".join(page.split())
