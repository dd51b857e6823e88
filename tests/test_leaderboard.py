"""Results that check themselves: whatever is tampered with is found, and named."""

from __future__ import annotations

import gzip
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj.cli import main
from magical_mj.errors import EvaluationError, SettingsError, UnknownNameError
from magical_mj.evaluation.scores import SCORES, SETTINGS
from magical_mj.leaderboard import Entry, check_entry, submit, verify
from magical_mj.leaderboard.claims import Claim, missing
from magical_mj.leaderboard.entry import packed, unpacked
from magical_mj.leaderboard.page import write_pages
from magical_mj.leaderboard.standings import improvement, rules_of, standing, standings
from magical_mj.registry import ENVIRONMENTS, task_spec

EPISODES = 4
Row = dict[str, Any]


@pytest.fixture(scope="module")
def evaluated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A few episodes of the expert, who is right everywhere, so that nobody else's actions would be."""
    out = tmp_path_factory.mktemp("evaluated") / "expert"
    magical_mj.evaluate("expert", tasks="MoveToRegion", variants="Layout", episodes=EPISODES, out=out)
    return out


@pytest.fixture
def folder(evaluated: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(evaluated, tmp_path / "expert"))


def rewrite(folder: Path, change: Callable[[list[Row]], Any]) -> None:
    """Changes the rows of an evaluation."""
    path = folder / SCORES
    rows = sorted(map(json.loads, path.read_text().splitlines()), key=lambda row: row["seed"])
    change(rows)
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


def test_an_honest_evaluation_replays(folder: Path) -> None:
    found = verify(folder)
    assert (found.episodes, found.steps) == (EPISODES, EPISODES * task_spec("MoveToRegion").horizon())
    assert (found.differing, found.unfit) == ([], [])


def test_what_the_protocol_asks_for_and_is_not_there_is_said(folder: Path) -> None:
    found = verify(folder)
    assert "expert, run 0, MoveToRegion Demo: all of the 100 episodes are missing" in found.missing
    assert "expert, run 0, MoveToRegion Layout: 96, such as seed 4, of the 100 episodes are missing" in found.missing
    assert len(found.missing) == sum(task == "MoveToRegion" for task, _ in ENVIRONMENTS)
    assert not found.good


def tampered_score(rows: list[Row]) -> None:
    rows[2]["score"] = 0.5


def swapped_scene(rows: list[Row]) -> None:
    rows[1]["scene"], rows[2]["scene"] = rows[2]["scene"], rows[1]["scene"]


def other_actions(rows: list[Row]) -> None:
    rows[2]["actions"] = rows[3]["actions"]


def too_short(rows: list[Row]) -> None:
    rows[2]["actions"] = rows[2]["actions"][:-1]


def unknown_letter(rows: list[Row]) -> None:
    rows[2]["actions"] = "z" + rows[2]["actions"][1:]


def scored_failure(rows: list[Row]) -> None:
    rows[2]["failure"] = "ValueError: no"


TAMPERED = [
    (tampered_score, "the score is 0.5, and its actions lead to 1"),
    (swapped_scene, "it was played in the scene "),
    (other_actions, "the score is 1, and its actions lead to "),
    (too_short, "it has 39 actions, and episodes have 40"),
    (unknown_letter, "its actions are not all among the 18"),
    (scored_failure, "the policy failed, and its score is 1 instead of 0"),
]


@pytest.mark.parametrize(("change", "problem"), TAMPERED)
def test_what_was_tampered_with_is_named(folder: Path, change: Callable[[list[Row]], None], problem: str) -> None:
    rewrite(folder, change)
    found = verify(folder)
    assert len(found.differing) == (2 if change is swapped_scene else 1)
    assert found.differing[-1].startswith(f"run 0, MoveToRegion Layout, seed 2: {problem}")


@pytest.mark.parametrize("what", ["protocol", "demonstrations", "rules"])
def test_other_settings_are_named(folder: Path, what: str) -> None:
    settings = json.loads((folder / SETTINGS).read_text())
    (folder / SETTINGS).write_text(json.dumps({**settings, what: 99}))
    assert [problem.partition(":")[0] for problem in verify(folder).unfit] == [what]
    (folder / SETTINGS).unlink()
    assert f"{what}: nothing is recorded" in "; ".join(verify(folder).unfit)


def test_rows_of_older_versions_have_no_scene(folder: Path) -> None:
    rewrite(folder, lambda rows: [row.pop("scene") for row in rows])
    assert verify(folder).differing == []


# entries

CARD = """
method = "Oracle"
links = ["https://example.org/oracle"]
hardware = "two cores"
[demonstrations]
set = 1
per_task = 10
[training]
hours = 1.5
"""


def test_an_entry_says_everything_and_checks(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "card.toml").write_text(CARD)
    path = tmp_path / "entry.json.gz"
    made = submit([folder], path, card=tmp_path / "card.toml")
    entry, found = check_entry(path, everything=True)
    assert entry == made
    assert (found.episodes, found.differing, found.unfit) == (EPISODES, [], [])
    assert entry.card == {
        "method": "Oracle",
        "description": None,
        "authors": None,
        "links": ["https://example.org/oracle"],
        "demonstrations": {"set": 1, "per_task": 10, "other": None},
        "training": {"hours": 1.5, "device": None, "steps": None},
        "hardware": "two cores",
    }
    assert (entry.observations, entry.rules, entry.protocol, entry.runs) == (None, "paper", 1, [0])
    assert entry.versions["version"] == [magical_mj.__version__]
    with pytest.raises(FileExistsError):
        submit([folder], path)


def test_what_the_card_does_not_say_is_null(folder: Path, tmp_path: Path) -> None:
    card = submit([folder], tmp_path / "entry.json.gz").card
    assert card.pop("method") == "expert"
    said = [value for part in card.values() for value in (part.values() if isinstance(part, dict) else [part])]
    assert said == [None] * len(said)


def test_the_same_entry_has_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        submit([folder], tmp_path / f"{name}.json.gz")
        rewrite(folder, list.reverse)
    assert (tmp_path / "a.json.gz").read_bytes() == (tmp_path / "b.json.gz").read_bytes()


def content(path: Path) -> dict[str, Any]:
    return json.loads(gzip.decompress(path.read_bytes()))


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"rules": "released"}, "was altered after it was made"),
        ({"rules": "mine"}, r"does not follow the schema at \$.rules"),
        ({"format": 2}, r"does not follow the schema at \$.format"),
        ({"surprise": 1}, "does not follow the schema"),
        ({"environments": {"FindDupe-Everything": [[0, 0, None, 0, "", None]]}}, "which is no environment"),
        ({"environments": {"FindDupe-All": [[0, 0, None, 2, "", None]]}}, r"at \$.environments.*2 is greater"),
    ],
)
def test_what_is_no_entry_is_named(folder: Path, tmp_path: Path, change: dict[str, Any], problem: str) -> None:
    path = tmp_path / "entry.json.gz"
    submit([folder], path)
    path.write_bytes(gzip.compress(json.dumps({**content(path), **change}).encode()))
    with pytest.raises(EvaluationError, match=problem):
        check_entry(path)


DAMAGED = {"empty": b"", "text": b"no", "half": gzip.compress(b"[1"), "list": gzip.compress(b"[]"), "cut": b"\x1f\x8b"}


@pytest.mark.parametrize("data", DAMAGED.values(), ids=DAMAGED)
def test_damaged_files_are_named(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "entry.json.gz").write_bytes(data)
    with pytest.raises(EvaluationError, match=r"entry.json.gz (cannot be read|does not follow)"):
        check_entry(tmp_path / "entry.json.gz")


@pytest.mark.parametrize(("change", "problem"), TAMPERED[:3])
def test_an_entry_with_a_proper_hash_is_still_replayed(
    folder: Path, tmp_path: Path, change: Callable[[list[Row]], None], problem: str
) -> None:
    rewrite(folder, change)
    submit([folder], tmp_path / "entry.json.gz")
    _, found = check_entry(tmp_path / "entry.json.gz", everything=True)
    assert problem in found.differing[-1]


def test_a_random_part_is_checked_and_always_the_same(tmp_path: Path) -> None:
    """A tenth of 200 episodes that all lie."""
    episodes = [Claim(0, "MoveToRegion", "Demo", seed, None, 0.7, "a" * 40, None) for seed in range(200)]
    entry = replace(unpacked(packed(whole(runs=1))), episodes=episodes)
    (tmp_path / "entry.json.gz").write_bytes(packed(entry))
    found, again = (check_entry(tmp_path / "entry.json.gz")[1] for _ in range(2))
    assert len(found.differing) == found.episodes == 20
    assert found.differing == again.differing


def test_an_entry_without_the_protocol_s_scenes_is_not_shown(tmp_path: Path) -> None:
    lone = Claim(0, "MoveToRegion", "Demo", 100, None, 0.0, "", "ValueError: no")
    (tmp_path / "entry.json.gz").write_bytes(packed(replace(whole(runs=1), episodes=[lone])))
    assert check_entry(tmp_path / "entry.json.gz")[1].unfit == [
        "none of its episodes starts in the scenes of seeds 0 to 99"
    ]


@pytest.mark.parametrize(
    ("card", "arguments", "error", "problem"),
    [
        ('colour = "red"', {}, UnknownNameError, "unknown entry of .*card.toml 'colour'"),
        ("[training]\nhuors = 1", {}, UnknownNameError, "Did you mean 'hours'"),
        ("method =", {}, SettingsError, "cannot be read as TOML"),
        ("", {"policy": "nobody"}, UnknownNameError, "unknown policy 'nobody'"),
        ("", {"out": "entry.json"}, SettingsError, "must end in .json.gz"),
    ],
)
def test_bad_submissions_are_explained(
    folder: Path, tmp_path: Path, card: str, arguments: dict[str, Any], error: type[Exception], problem: str
) -> None:
    (tmp_path / "card.toml").write_text(card)
    with pytest.raises(error, match=problem):
        submit([folder], **{"out": tmp_path / "entry.json.gz", "card": tmp_path / "card.toml", **arguments})
    assert not list(tmp_path.glob("entry*"))


def whole(runs: int = 5) -> Entry:
    """An entry with all 60 environments, whose episodes nobody played."""
    episodes = [
        Claim(run, task, variant, seed, None, ((seed + run) % 5) / 4, "", None)
        for run in range(runs)
        for task, variant in ENVIRONMENTS
        for seed in range(100)
    ]
    card = {"method": "Nobody", "description": None, "authors": None, "links": None, "hardware": None}
    card |= {"demonstrations": {"set": None, "per_task": None, "other": None}}
    card |= {"training": {"hours": None, "device": None, "steps": None}}
    versions = {"version": ["0.1.0"], "mujoco": ["3.17.0"], "gl": ["egl"]}
    return Entry(card, "LoRes4E", "paper", 1, versions, episodes)


def test_a_thousand_rows_too_few_are_named() -> None:
    entry = whole()
    assert missing(entry.episodes, magical_mj.TASKS) == []
    found = missing(entry.episodes[1000:], magical_mj.TASKS)
    assert found == [
        f"run 0, {task} {variant}: all of the 100 episodes are missing" for task, variant in ENVIRONMENTS[:10]
    ]


# tables


def scored(entry: Entry, score: Callable[[Claim], float]) -> Entry:
    return replace(entry, episodes=[episode._replace(score=score(episode)) for episode in entry.episodes])


def named(entry: Entry, name: str) -> Entry:
    return replace(entry, card={**entry.card, "method": name})


def test_official_entries_are_complete() -> None:
    assert (standing(whole()).kind, standing(whole()).gaps) == ("official", ())
    few = standing(whole(runs=2))
    assert (few.kind, few.gaps) == ("partial", ("2 of 5 runs",))
    short = standing(replace(whole(), episodes=whole().episodes[1000:]))
    assert (short.kind, short.gaps) == ("partial", ("1000 of 30000 episodes missing",))
    one_task = [episode for episode in whole().episodes if episode.task == "FixColour"]
    assert standing(replace(whole(), episodes=one_task)).gaps == ("8 of 60 environments",)


def test_scores_are_interquartile_means_over_environments_and_runs() -> None:
    """By hand: a run scores 0, 0.25, ..., 1 everywhere; without the best and the worst quarter 0.25, 0.5, 0.75 stay."""
    found = standing(scored(whole(), lambda episode: episode.run / 4))
    assert found.scores["all environments"].value == pytest.approx(0.5)
    assert found.scores["all environments"].low < 0.5 < found.scores["all environments"].high
    assert set(found.scores) == {"all environments", *magical_mj.VARIANTS}
    np.testing.assert_allclose(found.profile[[0, 25, 50]], [1, 0.6, 0.2])


def test_only_the_seeds_of_the_protocol_count() -> None:
    entry = scored(whole(), lambda episode: 0.5)
    more = [episode._replace(seed=episode.seed + 100, score=1.0) for episode in entry.episodes]
    found = standing(replace(entry, episodes=entry.episodes + more))
    assert found.scores["all environments"].value == 0.5
    assert standing(replace(entry, episodes=more + entry.episodes[100:])).kind == "partial"


def test_drops_compare_the_tasks_that_have_the_variant() -> None:
    """By hand: MoveToRegion, which has no Shape, must not count there."""
    level = {"Demo": 0.75, "Shape": 0.5, "All": 0.0}
    found = standing(scored(whole(), lambda one: 0.0 if one.task == "MoveToRegion" else level.get(one.variant, 0.75)))
    assert found.drops["Shape"].value == pytest.approx(0.25)
    assert found.drops["Jitter"].value == 0
    share = sum(task != "MoveToRegion" for task, variant in ENVIRONMENTS if variant == "All") / 8
    assert found.drops["All"].value == pytest.approx(0.75 * share)


def test_probability_of_improvement() -> None:
    """By hand: runs of 0.25 and 0.75 against runs of 0.5 win half the time, against runs of 0 always."""
    mixed, half, nothing = (
        standing(scored(whole(runs=2), score))
        for score in (lambda one: 0.25 + 0.5 * one.run, lambda one: 0.5, lambda one: 0.0)
    )
    assert improvement(mixed, half).value == improvement(half, mixed).value == 0.5
    assert improvement(mixed, nothing).value == 1
    assert improvement(nothing, mixed).value == 0
    assert improvement(half, half).value == 0.5
    assert improvement(half, replace(half, means={})).value != improvement(half, half).value  # nothing in common: NaN


def test_published_results_stand_under_their_own_rules() -> None:
    found = standings([whole()])
    assert [one.kind for one in found] == ["official", *["published"] * 11]
    gail = next(one for one in found if one.name == "GAIL (ST)")
    assert gail.scores["Demo"].value == pytest.approx(0.84, abs=0.005)
    assert {rules_of(one) for one in found if one.kind == "published"} == {"released"}


def test_pages_need_nothing_from_elsewhere_and_trust_no_text(tmp_path: Path) -> None:
    entry = whole()
    evil = "<script>alert(1)</script>"
    card = {
        **entry.card,
        "method": "Näme",
        "description": evil,
        "hardware": evil,
        "links": ["https://example.org/?a&b"],
    }
    pages = write_pages(standings([replace(entry, card=card), named(whole(runs=2), "Other")]), tmp_path)
    texts = {page.suffix: page.read_text() for page in pages}
    for text in texts.values():
        assert evil not in text
        assert "Näme ★" in text
        assert "GAIL (ST)†" in text
        assert "Other is partial: 2 of 5 runs." in text
    html = texts[".html"]
    assert not re.findall(r"<(?:script|link|img|iframe)|url\(|@import", html)
    assert re.findall(r'href="(http[^"]*)"', html) == ["https://example.org/?a&amp;b"]
    assert html.count("<svg") == 2
    parser = Balanced()
    parser.feed(html)
    assert parser.open == []


class Balanced(HTMLParser):
    """Fails at an element that is closed and was not open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: Any) -> None:
        if tag != "meta":
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: Any) -> None:
        pass

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


# the command line


def test_the_commands_say_what_they_found(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "entry.json.gz"
    assert main(["submit", str(folder), "--out", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"expert: {EPISODES} episodes of 1 runs" in out
    assert "the card does not say: description, authors, links, hardware (--card)" in out
    rewrite(folder, tampered_score)
    assert main(["verify", str(folder)]) == 1
    out, error = capsys.readouterr()
    assert f"{EPISODES} episodes replayed, 160 steps in" in out
    assert f"{folder} differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert f"{folder} is incomplete: expert, run 0" in error


def test_a_leaderboard_names_bad_entries_and_shows_the_others(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = tmp_path / "entries"
    assert main(["leaderboard", str(tmp_path)]) == 1
    assert "holds no entries" in capsys.readouterr().err
    entries.mkdir()
    submit([folder], entries / "good.json.gz")
    assert main(["leaderboard", str(entries), "--all"]) == 0
    assert f"good.json.gz: expert; {EPISODES} episodes replayed" in capsys.readouterr().out
    (entries / "cut.json.gz").write_bytes((entries / "good.json.gz").read_bytes()[:-20])
    rewrite(folder, tampered_score)
    (tmp_path / "card.toml").write_text('method = "Liar"')
    submit([folder], entries / "lie.json.gz", card=tmp_path / "card.toml")
    assert main(["leaderboard", str(entries), "--all", "--out", str(tmp_path / "pages")]) == 1
    error = capsys.readouterr().err
    assert "cut.json.gz cannot be read" in error
    assert "lie.json.gz differs: run 0, MoveToRegion Layout, seed 2: the score is 0.5" in error
    assert "entries that are not what they claim, and are not on the page: 2" in error
    text = (tmp_path / "pages" / "leaderboard.md").read_text()
    assert "| expert | paper | the simulation |" in text
    assert "Liar" not in text
