"""Entries of the leaderboard: what they say, what is refused, and that they are replayed."""

from __future__ import annotations

import gzip
import json
import lzma
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

import magical_mj
from magical_mj.leaderboard import check_entry, submit
from magical_mj.leaderboard.claims import Claim, missing
from magical_mj.leaderboard.entry import packed, unpacked
from magical_mj.tasks.registry import ENVIRONMENTS
from magical_mj.utils.errors import EvaluationError
from tests.helpers.entries import EPISODES, TAMPERED, Row, rewrite, whole

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
    path = tmp_path / "entry.json.xz"
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


def test_episodes_of_other_tasks_are_no_entry(folder: Path, tmp_path: Path) -> None:
    rewrite(folder, lambda rows: rows[0].update(task="PushOut"))
    with pytest.raises(EvaluationError, match="not in PushOut-Layout"):
        submit([folder], tmp_path / "entry.json.xz")


def test_what_the_card_does_not_say_is_null(folder: Path, tmp_path: Path) -> None:
    card = submit([folder], tmp_path / "entry.json.xz").card
    assert card.pop("method") == "expert"
    said = [value for part in card.values() for value in (part.values() if isinstance(part, dict) else [part])]
    assert said == [None] * len(said)


def test_the_same_entry_has_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        submit([folder], tmp_path / f"{name}.json.xz")
        rewrite(folder, list.reverse)
    assert (tmp_path / "a.json.xz").read_bytes() == (tmp_path / "b.json.xz").read_bytes()


def content(path: Path) -> dict[str, Any]:
    return json.loads(lzma.decompress(path.read_bytes()))


def columns(environment: str = "FindDupe-All", **changed: list[Any]) -> dict[str, dict[str, list[Any]]]:
    """What a file holds of one episode."""
    episode = {"run": [0], "seed": [0], "scene": [None], "score": [0], "actions": [""], "failure": [None]}
    return {field: {environment: values} for field, values in {**episode, **changed}.items()}


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"rules": "released"}, "was altered after it was made"),
        ({"rules": "mine"}, "does not follow the schema: entry.rules must be one of"),
        ({"format": 1}, "does not follow the schema: entry.format must be same as const definition: 2"),
        ({"surprise": 1}, "does not follow the schema: entry must not contain {'surprise'} properties"),
        ({"episodes": columns("FindDupe-Everything")}, "which is no environment"),
        ({"episodes": columns("FindDupe-\x1b[2J")}, "entry.episodes.[a-z]* must be named by propertyName definition"),
        (
            {"episodes": columns(score=[2])},
            r"entry.episodes.score.FindDupe-All\[0\] must be smaller",
        ),
        ({"episodes": columns(seed=[1.0])}, "in FindDupe-All that are not written as integers"),
        ({"episodes": columns(score=[])}, "entry.episodes.score.FindDupe-All must contain at least 1 items"),
        ({"episodes": columns(seed=[0, 1])}, "not all fields of all episodes in FindDupe-All: run 1, seed 2, scene 1"),
        (
            {"episodes": {**columns(), "run": {"FindDupe-Demo": [0]}}},
            "not all fields .* in FindDupe-All: run 0, seed 1",
        ),
        ({"observations": "\ud800"}, "entry.json.xz cannot be read: 'utf-8' codec"),
        (
            {"observations": "State |\n| **Planner ★**"},
            "the schema: entry.observations must match",
        ),
    ],
)
def test_what_is_no_entry_is_named(folder: Path, tmp_path: Path, change: dict[str, Any], problem: str) -> None:
    path = tmp_path / "entry.json.xz"
    submit([folder], path)
    path.write_bytes(lzma.compress(json.dumps({**content(path), **change}).encode()))
    with pytest.raises(EvaluationError, match=problem):
        check_entry(path)


DAMAGED = {
    "empty": b"",
    "text": b"no",
    "half": lzma.compress(b"[1"),
    "list": lzma.compress(b"[]"),
    "cut": lzma.compress(b"{}")[:-1],
    "longer": lzma.compress(b"{}") + b"{}",
    "another format": gzip.compress(b"{}"),
    "bits": lzma.compress(b"{}")[:10] + b"\xff" * 20,
    "deep": lzma.compress(b"[" * 10**5),
}


@pytest.mark.parametrize("data", DAMAGED.values(), ids=DAMAGED)
def test_damaged_files_are_named(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "entry.json.xz").write_bytes(data)
    with pytest.raises(EvaluationError, match=r"entry.json.xz (cannot be read|does not follow)"):
        check_entry(tmp_path / "entry.json.xz")


@pytest.mark.parametrize(("change", "problem"), TAMPERED[:3])
def test_an_entry_with_a_proper_hash_is_still_replayed(
    folder: Path, tmp_path: Path, change: Callable[[list[Row]], None], problem: str
) -> None:
    rewrite(folder, change)
    submit([folder], tmp_path / "entry.json.xz")
    _, found = check_entry(tmp_path / "entry.json.xz", everything=True)
    assert problem in found.differing[-1]


@pytest.mark.parametrize("method", ["BC\n", "BC (ST) ★", "BC (ST)†", "BC | 1.00", ""])
def test_names_look_like_no_other_line_of_a_table(folder: Path, tmp_path: Path, method: str) -> None:
    path = tmp_path / "entry.json.xz"
    submit([folder], path)
    entry = check_entry(path)[0]
    path.write_bytes(packed(replace(entry, card={**entry.card, "method": method})))
    with pytest.raises(EvaluationError, match=r"does not follow the schema: entry\.card\.method must match"):
        check_entry(path)


def test_numbers_that_are_too_large_are_named(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "entry.json.xz"
    submit([folder], path)
    text = lzma.decompress(path.read_bytes()).replace(b'"hours":null', b'"hours":1e999')
    path.write_bytes(lzma.compress(text))
    with pytest.raises(EvaluationError, match="1e999 is not a finite number"):
        check_entry(path)


def test_a_policy_that_saw_the_simulation_is_another_kind(folder: Path, tmp_path: Path) -> None:
    rewrite(folder, lambda rows: rows[0].update(preset="LoRes4E"))
    with pytest.raises(EvaluationError, match="saw the simulation instead of pictures or states"):
        submit([folder], tmp_path / "entry.json.xz")


def test_episodes_that_do_not_count_hide_none_that_do(tmp_path: Path) -> None:
    """A hundred lies among thousands of failures in other scenes; one lie is seen without being played."""
    lies = [Claim(0, "MoveToRegion", "Demo", seed, None, 0.7, "a" * 40, None) for seed in range(99)]
    lies.append(Claim(0, "MoveToRegion", "Demo", 99, None, 0.7, "a", None))
    padding = [Claim(0, "MoveToRegion", "Demo", seed, None, 0.0, "", "no") for seed in range(100, 5_000)]
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[*lies, *padding])))
    found = check_entry(tmp_path / "entry.json.xz")[1]
    assert found.episodes == 10
    assert len(found.differing) == 11
    assert "run 0, MoveToRegion Demo, seed 99: it has 1 actions, and episodes have 40" in found.differing


def test_a_random_part_is_checked(tmp_path: Path) -> None:
    """A tenth of 100 episodes that all lie; only who knows the seed can tell which."""
    episodes = [Claim(0, "MoveToRegion", "Demo", seed, None, 0.7, "a" * 40, None) for seed in range(100)]
    entry = replace(unpacked(packed(whole(runs=1))), episodes=episodes)
    (tmp_path / "entry.json.xz").write_bytes(packed(entry))
    found, again, *others = (check_entry(tmp_path / "entry.json.xz", seed=seed)[1] for seed in (0, 0, 1, None, None))
    assert len(found.differing) == found.episodes == 10
    assert found.differing == again.differing
    assert len({tuple(sorted(one.differing)) for one in (found, *others)}) == 4


def test_an_entry_without_the_protocols_scenes_is_not_shown(tmp_path: Path) -> None:
    lone = Claim(0, "MoveToRegion", "Demo", 100, None, 0.0, "", "ValueError: no")
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[lone])))
    assert check_entry(tmp_path / "entry.json.xz")[1].unfit == [
        "none of its episodes starts in the scenes of seeds 0 to 99"
    ]


def test_a_thousand_rows_too_few_are_named() -> None:
    entry = whole()
    assert missing(entry.episodes, magical_mj.TASKS) == []
    found = missing(entry.episodes[1000:], magical_mj.TASKS)
    assert found == [
        f"run 0, {task} {variant}: all of the 100 episodes are missing" for task, variant in ENVIRONMENTS[:10]
    ]
