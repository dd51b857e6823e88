"""The leaderboard: its figures by hand, its pages, and its commands."""

from __future__ import annotations

import dataclasses
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from msgspec.structs import replace

from magical_mj.evaluation.reports.floors import BLIND, floors, refuting_seeds
from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.evaluation.reports.tables import NONE
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.leaderboard import Entry, read_entry
from magical_mj.leaderboard.entry import Card, Privilege, packed, unpacked
from magical_mj.leaderboard.page import UNDECIDED, tables, write_pages
from magical_mj.leaderboard.standings import (
    ABOVE,
    COLUMNS,
    COMMON,
    GROUPS,
    NEW_PLACES,
    improvement,
    standing,
    standings,
)
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils.errors import EvaluationError
from tests.helpers.entries import recorded, whole


def scored(entry: Entry, score: Callable[[EpisodeResult], float]) -> Entry:
    episodes = [recorded(one.run, one.task, one.variant, one.seed, score(one), one.actions) for one in entry.episodes]
    return replace(entry, episodes=episodes)


def named(entry: Entry, name: str) -> Entry:
    return replace(entry, card=replace(entry.card, method=name))


RERUN = {"8 tasks": Estimate(0.01, -0.02, 0.04)}


def test_official_entries_are_complete_and_were_re_run() -> None:
    entry = whole()
    good = standing(entry, RERUN)
    assert (good.kind, good.gaps, good.level) == ("official", (), "re-run")
    taped = standing(entry)
    assert (taped.kind, taped.gaps, taped.level) == ("partial", ("its policies were not re-run",), "replayed")
    few = standing(whole(runs=2), RERUN)
    assert (few.kind, few.gaps) == ("partial", ("2 of 5 runs",))
    short = standing(replace(entry, episodes=entry.episodes[1000:]), RERUN)
    assert (short.kind, short.gaps) == ("partial", ("1000 of 30000 episodes missing",))
    one_task = [episode for episode in entry.episodes if episode.task == "FixColour"]
    assert standing(replace(entry, episodes=one_task), RERUN).gaps == ("8 of 60 environments",)
    nobody = replace(entry, card=replace(entry.card, authors=None, commands=None))
    assert standing(nobody, RERUN).gaps == ("its card lacks authors", "its card lacks commands")


def test_an_entry_is_repeated_if_others_trained_it_to_the_same_score() -> None:
    entry = scored(named(whole(runs=2), "Ours"), lambda episode: float(episode.seed < 50))

    def repeated(other: Entry, **changes: str) -> Entry:
        return replace(other, card=replace(other.card, method="Theirs", repeats="Ours", **changes))

    others = {
        "[-0.04, +0.04]": repeated(entry, authors="Somebody else"),
        "needs other authors": repeated(entry),
        "differs by +0.50": repeated(scored(entry, lambda _: 1.0), authors="Somebody else"),
        "all environments": repeated(
            replace(entry, episodes=[one for one in entry.episodes if one.task == "FixColour"]), authors="Somebody else"
        ),
        "as many runs": repeated(
            replace(entry, episodes=[one for one in entry.episodes if one.run == 0]), authors="Somebody else"
        ),
    }
    for expected, other in others.items():
        methods = [method for method in standings({"a": entry, "b": other}) if method.kind != "published"]
        (level,) = (method.level for method in methods if method.name == "Ours")
        assert level == ("repeated" if "-0.04" in expected else "replayed")
        assert expected in tables(methods)[0].notes[-1]


def test_further_runs_of_some_tasks_do_not_raise_the_score() -> None:
    """A run of all tasks, and four more of the two that it can: each environment counts as much as the others."""
    good = "MoveToCorner", "MoveToRegion"
    entry = scored(whole(), lambda episode: 0.9 if episode.task in good else 0.1)
    uneven = standing(
        replace(entry, episodes=[episode for episode in entry.episodes if episode.run == 0 or episode.task in good])
    )
    alone = standing(replace(entry, episodes=[episode for episode in entry.episodes if episode.run == 0]))
    for name, figure in alone.scores.items():
        assert uneven.scores[name].value == pytest.approx(figure.value)


def test_scores_are_means_over_environments_and_runs() -> None:
    """A run scores 0, 0.25, ..., 1 everywhere."""
    method = standing(scored(whole(), lambda episode: episode.run / 4))
    for estimate in (method.scores["Memory"], method.scores["Demo"]):
        assert estimate.value == pytest.approx(0.5)
        assert 0.1 < estimate.low < 0.4 < 0.6 < estimate.high < 0.9
    same, one = (standing(scored(whole(runs=runs), lambda episode: float(episode.seed < 50))) for runs in (2, 1))
    for few in (same, one):
        assert few.scores["Demo"].value == 0.5
        assert 0.4 < few.scores["Demo"].low < 0.5 < few.scores["Demo"].high < 0.6


def test_groups_are_means_over_the_tasks_that_have_all_variants() -> None:
    """MoveToRegion and MoveToCorner, which lack variants, do not count there."""
    easy = ("MoveToCorner", "MoveToRegion")
    method = standing(scored(whole(), lambda episode: float(episode.task in easy)))
    assert [method.scores[name].value for name in GROUPS] == [0, 0, 0]
    assert method.scores["Layout"].value == pytest.approx(1 / 7)
    assert method.scores["All"].value == pytest.approx(2 / 8)
    assert len(COMMON) == 6


def test_the_floor_is_the_best_of_the_agents_that_do_not_look() -> None:
    results = Path(__file__).parents[2] / "results"
    means = [standing(read_entry(results / agent)).means for agent in BLIND]
    assert floors() == {
        pair: pytest.approx(max(each[pair].mean() for each in means), abs=1e-5) for pair in ENVIRONMENTS
    }
    assert standing(scored(whole(), lambda episode: 1.0)).scores[ABOVE].value == 1
    half = standing(scored(whole(), lambda episode: 0.5)).scores[ABOVE].value
    lowest = [floors()[pair] for pair in COLUMNS["Generalisation"]]
    assert half == pytest.approx(np.mean([(0.5 - f) / (1 - f) for f in lowest]))


def test_new_places_are_the_scenes_that_refute_the_shortcut() -> None:
    """By hand: runs score 1 in these scenes alone. In 66 scenes of FixColour's Colour, another block is to move."""
    refuting = refuting_seeds()
    method = standing(
        scored(whole(), lambda episode: float(episode.seed in refuting.get((episode.task, episode.variant), ())))
    )
    assert method.scores[NEW_PLACES].value == pytest.approx(1)
    assert method.means["FixColour", "Colour"].mean() == pytest.approx(0.66)
    assert method.means["FixColour", "Jitter"].mean() == 0


def test_blocks_tell_what_helped() -> None:
    def block(observations: str | None, *privileges: Privilege) -> str:
        card = replace(some.card, privileges=[*privileges])
        return standing(replace(some, card=card, observations=observations)).block

    some = replace(whole(runs=1), episodes=whole(runs=1).episodes[:1])

    assert block("LoRes4E") == block("LoRes4E", "simulator in training") == "pictures"
    assert block("LoRes4E", "states") == block("LoRes4E", "scripted skill") == "pictures and more"
    assert block("State", "states", "simulator in training") == "states"
    assert block("State", "states", "tuned on other scenes of the test variants") == "states and more"
    assert block("State", "states", "scripted skill", "simulator at test") == "simulator"
    assert block(None) == "nothing"


def test_shifts_are_a_track_of_their_own() -> None:
    """By hand: FindDupe scores 1 without a shift and 0.8, 0.6 ... 0 under the camera; MakeLine lacks a strength."""
    some = [row for row in whole(runs=1).episodes if row.variant == "Demo" and row.task in ("FindDupe", "MakeLine")]
    plain = [dataclasses.replace(row, score=float(row.seed < 50)) for row in some]
    played = [
        dataclasses.replace(row, shift=f"camera:{strength}", score=1 - strength / 5)
        for row in some
        for strength in range(1, 6)
        if row.task == "FindDupe" or strength < 5
    ]
    entry = replace(whole(), episodes=[*plain, *played])
    (tasks, points), method = standing(entry).curves["camera"], standing(entry)
    assert (tasks, list(points.values())) == (1, pytest.approx([1, 0.8, 0.6, 0.4, 0.2, 0]))
    assert method.means["FindDupe", "Demo"].tolist() == [0.5]
    unshifted = [dataclasses.replace(row, run=1, score=0.0) for row in plain]
    assert standing(replace(whole(), episodes=[*plain, *unshifted, *played])).curves["camera"] == (tasks, points)
    assert len(entry.shifted) == 9 * 50
    (shown,) = [table for table in tables([method]) if table.name == "shifts"]
    row = dict(zip(shown.header, shown.groups[0][1][0], strict=True))
    assert (row["camera"], row["latency"], row["half lost first"]) == ("0.50 (1/8)", NONE, "camera:3")
    again = unpacked(packed(entry))
    assert sorted(row.title for row in again.episodes) == sorted(row.title for row in entry.episodes)
    assert "shifts" not in [table.name for table in tables([standing(whole())])]


@pytest.mark.parametrize(("variant", "shift"), [("Demo", "camera:6"), ("Demo", "mine:Fog:3"), ("All", "camera:3")])
def test_other_shifts_are_not_in_entries(variant: str, shift: str) -> None:
    rows = [dataclasses.replace(row, shift=shift) for row in whole(runs=1).episodes if row.variant == variant]
    with pytest.raises(EvaluationError, match="which is not an environment"):
        unpacked(packed(replace(whole(), episodes=rows)))


def test_only_the_seeds_of_the_protocol_count() -> None:
    entry = scored(whole(), lambda episode: 0.5)
    more = [recorded(one.run, one.task, one.variant, one.seed + 100, 1.0, one.actions) for one in entry.episodes]
    method = standing(replace(entry, episodes=entry.episodes + more))
    assert method.scores["Demo"].value == 0.5
    assert standing(replace(entry, episodes=more + entry.episodes[100:])).kind == "partial"


def test_drops_compare_the_tasks_that_have_the_variant() -> None:
    """By hand: MoveToRegion, which has no Shape, must not count there."""
    level = {"Demo": 0.75, "Shape": 0.5, "All": 0.0}
    method = standing(
        scored(whole(), lambda episode: 0.0 if episode.task == "MoveToRegion" else level.get(episode.variant, 0.75))
    )
    assert method.drops["Shape"] == pytest.approx(0.25)
    assert method.drops["Jitter"] == 0
    share = sum(task != "MoveToRegion" for task, variant in ENVIRONMENTS if variant == "All") / 8
    assert method.drops["All"] == pytest.approx(0.75 * share)


def test_the_weakest_variant_is_found_on_tasks_that_have_all() -> None:
    """By hand: MoveToRegion has no Shape. What it loses in Colour must not outweigh what others lose in Shape."""

    def score(episode: EpisodeResult) -> float:
        low = {"Shape": 0.75, "Colour": 0.0 if episode.task == "MoveToRegion" else 0.8}
        return low.get(episode.variant, 1.0)

    method = standing(scored(whole(), score))
    assert method.weakest == "Shape"
    assert method.drops["Colour"] > method.drops["Shape"]
    assert standing(scored(whole(), lambda episode: 1.0)).weakest is None
    alone = [episode for episode in whole().episodes if episode.task == "MoveToRegion"]
    assert standing(replace(whole(), episodes=alone)).weakest is None


def test_missing_episodes_are_noted_beside_the_scores() -> None:
    alone = [episode for episode in whole().episodes if episode.task == "MoveToRegion"]
    (scores, *_) = tables([standing(replace(whole(), episodes=alone))])
    (_, (row,)), _ = scores.groups
    by_column = dict(zip(scores.header, row, strict=True))
    assert by_column["Generalisation"] == by_column[ABOVE] == NONE
    assert by_column["Demo"].endswith("] (1/8)")
    assert by_column["Shape"] == NONE


def test_probability_of_improvement() -> None:
    """By hand: runs of 0.25 and 0.75 against runs of 0.5 win half the time, against runs of 0 always."""
    mixed, half, nothing = (
        standing(scored(whole(runs=2), score))
        for score in (lambda episode: 0.25 + 0.5 * episode.run, lambda episode: 0.5, lambda episode: 0.0)
    )
    assert improvement(mixed, half) == improvement(half, mixed) == 0.5
    assert improvement(mixed, nothing) == 1
    assert improvement(nothing, mixed) == 0
    assert improvement(half, half) == 0.5
    nearly = dataclasses.replace(half, means={pair: values + 1e-15 for pair, values in half.means.items()})
    assert improvement(nearly, half) == 0.5
    assert np.isnan(improvement(half, dataclasses.replace(half, means={})))  # nothing in common
    strict = standing(replace(whole(runs=2), rules="released"))
    assert np.isnan(improvement(half, strict))
    for methods, cells in (
        ([half, strict], [(NONE, NONE)] * 2),
        ([mixed, half], [(NONE, f"0.50 {UNDECIDED}"), (f"0.50 {UNDECIDED}", NONE)]),
        ([mixed, nothing], [(NONE, "1.00"), ("0.00", NONE)]),
    ):
        (shown,) = [table for table in tables(methods) if table.name == "improvement"]
        assert [row[1:] for row in shown.groups[0][1]] == cells


def test_methods_are_in_the_order_of_generalisation_and_partial_ones_last() -> None:
    """However well one did in the few environments that it played, or where nothing moves."""
    best = [dataclasses.replace(episode, score=1.0) for episode in whole(runs=1).episodes if episode.task == "FindDupe"]
    recalls = scored(named(whole(), "Recalls"), lambda episode: float(episode.variant not in GROUPS["Generalisation"]))
    entries = [replace(named(whole(runs=1), "Few"), episodes=best), recalls]
    entries.append(scored(named(whole(runs=2), "Generalises"), lambda episode: 0.5))
    by_name = {entry.method: entry for entry in entries}
    assert [method.name for method in standings(by_name)[:3]] == ["Generalises", "Recalls", "Few"]


def test_published_results_stand_under_their_own_rules() -> None:
    methods = standings({"one": whole()}, {"one": RERUN})
    assert [method.kind for method in methods] == ["official", *["published"] * 11]
    gail = next(method for method in methods if method.name == "GAIL (ST)")
    assert gail.scores["Shape"].value == 0.60  # as printed; the mean of the printed environments is 0.594
    assert {method.entry.rules for method in methods if method.kind == "published"} == {"released"}


def test_pages_need_nothing_from_elsewhere_and_trust_no_text(tmp_path: Path) -> None:
    entry = whole()
    evil = "<script>alert(1)</script>"
    card = Card("Näme", description=evil, hardware=f"0.50 [{evil}]", links=["https://example.org/?a&b"], privileges=[])
    card = replace(card, authors="A. Person", commands=["make"])
    entries = {"one": replace(entry, card=card), "other": named(whole(runs=2), "Other")}
    pages = write_pages(standings(entries, dict.fromkeys(entries, RERUN)), tmp_path)
    texts = {page.suffix: page.read_text() for page in pages}
    for text in texts.values():
        assert evil not in text
        assert "Näme ★" in text
        assert "GAIL (ST)†" in text
        assert "Other is partial: 2 of 5 runs." in text
    html = texts[".html"]
    assert not re.findall(r"<(?:script|link|img|iframe)|url\(|@import", html)
    assert re.findall(r'href="(http[^"]*)"', html) == ["https://example.org/?a&amp;b"]
    assert html.count("<svg") == 1
    assert "Näme ★</text>" in html
    assert ET.fromstring(re.sub("<!doctype html>|<meta[^>]*>", "", html)).tag == "html"  # all is closed


def test_each_of_our_entries_holds_what_repeats_it() -> None:
    """Commands, and the files that they name."""
    root = Path(__file__).parents[2]
    for folder in sorted(path for path in (root / "results").iterdir() if path.is_dir()):
        commands = tomllib.loads((folder / "card.toml").read_text())["commands"]
        assert commands[0], folder.name
        named = re.findall(r"(?:results|methods|tools)/[\w./-]+", " ".join(commands))
        assert all((root / name).exists() for name in named), folder.name
        trained = {path.name for path in folder.glob("*")} & {"experiment.toml", "train.json"}
        assert trained or "evaluate --policy" in commands[0], folder.name


def test_our_own_entries_take_less_than_thirty_megabytes() -> None:
    """They are in the repository, which everybody clones: today's 20 MB, and five more methods with five runs."""
    paths = list((Path(__file__).parents[2] / "results").rglob("*.*"))
    assert len(paths) > 40
    assert sum(path.stat().st_size for path in paths) < 30_000_000
