"""What the tests of the leaderboard share: evaluations to tamper with, and an entry with all environments."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from magical_mj.evaluation.scores import SCORES
from magical_mj.leaderboard import Entry
from magical_mj.leaderboard.claims import Claim
from magical_mj.leaderboard.submission import CARD
from magical_mj.policies.interface import LETTERS
from magical_mj.tasks.registry import ENVIRONMENTS

EPISODES = 4
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
    (tampered_score, "the score is 0.5, and its actions lead to 1"),
    (swapped_scene, "it was played in the scene "),
    (other_actions, "the score is 1, and its actions lead to "),
    (too_short, "it has 39 actions, and episodes have 40"),
    (unknown_letter, "its actions are not all among the 18"),
    (scored_failure, "the policy failed, and its score is 1 instead of 0"),
]


def whole(runs: int = 5) -> Entry:
    """An entry with all 60 environments, whose episodes nobody played."""
    episodes = [
        Claim(run, task, variant, seed, None, ((seed + run) % 5) / 4, LETTERS[run], None)
        for run in range(runs)
        for task, variant in ENVIRONMENTS
        for seed in range(100)
    ]
    card = {**CARD, "method": "Nobody"}
    versions = {"version": ["0.1.0"], "mujoco": ["3.17.0"], "gl": ["egl"]}
    return Entry(card, "LoRes4E", "paper", 1, versions, episodes)
