"""Entries with intents: they are checked like others, and have rows by set, in blocks by what policies receive."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs

from magical_mj.evaluation.reports.intervals import Cell, estimate
from magical_mj.leaderboard import Entry, check_entries, read_entry, submit, verify
from magical_mj.leaderboard.entry import packed, unpacked
from magical_mj.leaderboard.page import HTML, tables, write_pages
from magical_mj.leaderboard.places import intents, places
from magical_mj.leaderboard.rerun import PER_SET, StoredPolicy, rerun
from magical_mj.leaderboard.standings import gaps, standing, standings
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.agents import Nearest
from tests.helpers.entries import recorded, whole
from tests.helpers.evaluations import evaluate

TASKS = "intent:seen/5,intent:long/3"


class Reader:
    """Does nothing, but receives the sentence."""

    preset = "State"
    uses_instruction = True

    def __call__(self, _: object) -> int:
        return 0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An evaluation of two policies."""
    out = tmp_path_factory.mktemp("intents") / "run"
    settings = {"tasks": TASKS, "variants": "Demo,Layout,All", "episodes": 2}
    evaluate(Reader(), out=out / "reader", **settings)
    evaluate("expert", out=out / "expert", **{**settings, "tasks": "intent:seen/5", "variants": "Layout"})
    return out


@pytest.fixture
def entries(folder: Path, tmp_path: Path) -> dict[str, Entry]:
    """Their entries, read from files."""
    for name in ("reader", "expert"):
        submit([folder / name], tmp_path / f"{name}.json.xz")
    return {name: read_entry(tmp_path / f"{name}.json.xz") for name in ("reader", "expert")}


def test_an_entry_with_intents_is_replayed_and_says_what_it_lacks(entries: dict[str, Entry]) -> None:
    findings = check_entries(entries, most=None, jobs=1)
    assert {name: found.episodes for name, found in findings.items()} == {"reader": 12, "expert": 2}
    assert all(found.good for found in findings.values())
    assert "4 of 500 environments of intents" in gaps(entries["reader"])
    assert not any("episodes missing" in gap or "60" in gap for gap in gaps(entries["reader"]))


def test_a_false_score_of_an_intent_is_found(entries: dict[str, Entry]) -> None:
    entry = entries["reader"]
    false = replace(entry.episodes[0], score=1.0)
    forged = unpacked(packed(structs.replace(entry, episodes=[false])))
    assert len(check_entries({"forged": forged}, most=None, jobs=1)["forged"].differing) == 1


def test_only_the_test_sets_have_a_place(entries: dict[str, Entry], tmp_path: Path) -> None:
    evaluate(Reader(), out=tmp_path / "run", tasks="intent:dev/3", variants="Layout", episodes=1)
    with pytest.raises(EvaluationError, match="which is not an environment"):
        submit([tmp_path / "run"], tmp_path / "dev.json.xz")
    assert (
        "outside the benchmark and the test sets of intents in 1 episode" in verify(tmp_path / "run", jobs=1).unfit[0]
    )
    other = replace(entries["reader"].episodes[0], task="intent:line(all)")
    with pytest.raises(EvaluationError, match="which is not an environment"):
        unpacked(packed(structs.replace(entries["reader"], episodes=[other])))


def test_an_entry_may_hold_intents_in_one_file_and_tasks_in_another(folder: Path, tmp_path: Path) -> None:
    evaluate(Reader(), out=tmp_path / "tasks", tasks="MoveToRegion", variants="Demo", episodes=1)
    out = tmp_path / "entry"
    submit([folder / "reader"], out / "intents.json.xz")
    submit([tmp_path / "tasks"], out / "tasks.json.xz")
    (out / "card.toml").write_text('method = "Reader"\n')
    entry = read_entry(out)
    assert (len(entry.episodes), entry.recorded.given) == (13, "instruction")
    submit([folder / "reader", tmp_path / "tasks"], tmp_path / "both.json.xz")
    assert read_entry(tmp_path / "both.json.xz").recorded.given == "instruction"


def stored(policy: str, part: str | None) -> StoredPolicy:
    """Run 0 of an importable policy, in place of a model."""
    return StoredPolicy(0, part, Path(policy))


def test_policies_play_intents_and_tasks_again_with_what_they_received(tmp_path: Path) -> None:
    """The policy of a whole run plays where the run has episodes, with the number of demonstrations of each part."""
    intents = "intent:combined/1,intent:relation/0,intent:relation/2"
    for name, tasks, number in (("intents", intents, 4), ("tasks", "MoveToRegion", 3)):
        how = {"tasks": tasks, "variants": "Layout", "episodes": 2, "demonstrations": number}
        evaluate(Nearest(), out=tmp_path / name, **how)
    (tmp_path / "card.toml").write_text('privileges = ["demonstrations at test"]\n')
    submit([tmp_path / "tasks", tmp_path / "intents"], tmp_path / "e.json.xz", card=tmp_path / "card.toml")
    entry = read_entry(tmp_path / "e.json.xz")
    assert (entry.recorded.given_in_tasks, entry.recorded.given) == ("3 demonstrations", "4 demonstrations")
    own = stored("tests.helpers.agents:Nearest", None)
    found = rerun(entry, [own], first_seed=3, scenes=2, jobs=1)
    assert {what: one.decided for what, one in found.items()} == {
        "1 task, 2 scenes in each environment": False,
        "3 intents, a scene of each in Layout": False,
    }
    taped = structs.replace(entry, episodes=[replace(row, score=1.0) for row in entry.episodes])
    assert all(one.high < 0 for one in rerun(taped, [own], first_seed=3, scenes=4, jobs=1).values())
    other = structs.replace(entry, recorded=structs.replace(entry.recorded, given="more demonstrations"))
    for changed, policy, problem in (
        (other, own, "receives 8 demonstrations in intents, but the entry says more demonstrations"),
        (entry, stored("tests.helpers.agents:Stubborn", None), "and none of Nearest has it"),
        (entry, own._replace(part="MoveToRegion"), "no policy of its runs for intents"),
        (entry, own._replace(run=3), "no policy of its runs for MoveToRegion, intents"),
    ):
        with pytest.raises((EvaluationError, SettingsError), match=problem):
            rerun(changed, [policy], first_seed=3)


def test_the_sample_has_as_many_intents_of_each_set_and_a_complete_entry_is_official() -> None:
    where = {pair: range(places()[pair]) for pair in intents()}
    rows = [recorded(k, *pair, seed, 0.0, "a") for k in range(5) for pair, seeds in where.items() for seed in seeds]
    entry = structs.replace(whole(), observations=None, episodes=rows)
    found = rerun(entry, [stored("noop", "intents")], first_seed=1, per_set=1, jobs=1)
    assert [*found] == ["5 intents, a scene of each in Layout and All"]
    assert gaps(entry) == ["its policies were not re-run"]
    assert (standing(entry, found).kind, standing(entry, found).level) == ("official", "re-run")
    assert gaps(structs.replace(entry, episodes=rows[1:])) == ["1 of 5000 episodes missing", gaps(entry)[0]]


def test_the_interval_of_a_hundred_intents_is_as_wide_as_documented() -> None:
    """The widest one: every recorded and every fresh episode is solved with probability one half."""
    rng, widths = np.random.default_rng(0), []
    for _ in range(50):
        new, old = (rng.binomial(number, 0.5, (1, 5 * PER_SET)) / number for number in (2, 4))
        found = estimate([Cell(new, 1.0, 0, "intents"), Cell(old, -1.0, 0, "intents")])
        widths.append((found.high - found.low) / 2)
    text = (Path(__file__).parents[2] / "docs" / "leaderboard.md").read_text()
    assert f"{PER_SET} of each set are drawn" in text
    assert f"With {5 * PER_SET} intents it reaches up to about {np.mean(widths):.2f} to each side" in text


def test_a_complete_evaluation_of_intents_is_confirmed(folder: Path) -> None:
    found = verify(folder / "reader", jobs=1)
    assert (found.episodes, found.good) == (12, True)
    missing = verify(folder / "expert", jobs=1).missing
    assert len(missing) == 1
    assert missing[0].endswith("All: all of the 2 episodes are missing")


def test_the_page_has_rows_by_set_in_blocks_by_what_is_given(entries: dict[str, Entry], tmp_path: Path) -> None:
    methods = standings(entries)
    (table,) = (table for table in tables(methods) if table.name == "intents")
    groups = {heading.partition("; ")[2]: [row[:3] for row in rows] for heading, rows in table.groups}
    reader = [("Reader", name, variants) for name in ("long", "seen") for variants in ("Layout and All", "Demo")]
    assert groups == {"given instruction": reader, "given nothing": [("expert", "seen", "Layout")]}
    (expert,) = (rows[0] for heading, rows in table.groups if heading.endswith("nothing"))
    assert expert[5].startswith("1.00")  # success
    assert "Reader" not in {
        row[0] for other in tables(methods) if other.name == "scores" for _, r in other.groups for row in r
    }
    write_pages(methods, tmp_path)
    assert '<section id="intents">' in (tmp_path / HTML).read_text()
