"""Helpers for tests of the leaderboard: tampered evaluations, and an entry with all environments."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any

from magical_mj.evaluation.scores import SCORES, EpisodeResult
from magical_mj.leaderboard import Entry, Findings, check_entries, read_entry
from magical_mj.leaderboard.entry import Card, Versions
from magical_mj.policies.interface import LETTERS
from magical_mj.tasks.registry import ENVIRONMENTS
from tests.helpers.evaluations import TEMPLATE

EPISODES = 4
PLAIN = asdict(TEMPLATE) | {"policy": "Nobody", "version": "", "mujoco": "", "gl": ""}
Row = dict[str, Any]


def rewrite(folder: Path, change: Callable[[list[Row]], Any]) -> None:
    """Changes the rows of an evaluation."""
    path = folder / SCORES
    rows = sorted(map(json.loads, path.read_text().splitlines()), key=lambda row: row["seed"])
    change(rows)
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))


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
    (tampered_score, "the score is 0.5, but its actions lead to 1"),
    (swapped_scene, "it was played in the scene "),
    (other_actions, "the score is 1, but its actions lead to "),
    (too_short, "it has 39 actions, but episodes have 40"),
    (unknown_letter, "its actions are not all among the 18"),
    (scored_failure, "the policy failed, but its score is 1 instead of 0"),
]


def recorded(
    run: int, task: str, variant: str, seed: int, score: float, actions: str, failure: Any = None
) -> EpisodeResult:
    """An episode with made-up results."""
    scene = {"run": run, "task": task, "variant": variant, "seed": seed}
    played = {"score": score, "steps": len(actions), "actions": actions, "failure": failure, "seconds": 0.0}
    return EpisodeResult(**{**PLAIN, **scene, **played})


@cache
def whole(runs: int = 5) -> Entry:
    """An entry with made-up episodes in all 60 environments."""
    episodes = [
        recorded(run, task, variant, seed, ((seed + run) % 5) / 4, LETTERS[run])
        for run in range(runs)
        for task, variant in ENVIRONMENTS
        for seed in range(100)
    ]
    return Entry(
        Card("Nobody", privileges=[], authors="A. Person", commands=["make"]),
        "LoRes4E",
        "paper",
        1,
        Versions(["0.1.0"], ["3.17.0"], ["egl"]),
        episodes,
    )


def check(path: Path, **settings: Any) -> tuple[Entry, Findings]:
    """The entry in a file, and the findings of its check."""
    entry = read_entry(path)
    return entry, check_entries({"": entry}, **settings)[""]
