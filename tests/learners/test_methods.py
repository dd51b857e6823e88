"""All methods: a seed decides everything, and a training that went on ends as if it had not been interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from magical_mj.learners import train
from tests.helpers.learners import brief, check_own_demonstrations, check_readers, check_resumes, check_seeds

TWO = {"tasks": "MoveToRegion,FixColour", "preset": "State"}
TRAININGS: list[tuple[str, dict[str, Any]]] = [
    ("bc", {}),
    ("bc", TWO),
    ("iq-learn", TWO),
    ("gail", {}),
    ("point", {}),
    ("gail", TWO),
    ("airl", TWO),
    ("wgail-gp", TWO),
    ("al", TWO),
]


@pytest.mark.parametrize("method", sorted({method for method, _ in TRAININGS}))
def test_every_method_learns_from_ones_own_demonstrations(method: str, tmp_path: Path) -> None:
    check_own_demonstrations(method, {} if method == "point" else {"preset": "State"}, tmp_path)


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_resumed_training_ends_like_an_uninterrupted_one(
    method: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    check_resumes(method, changes, tmp_path)


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_equal_seeds_give_equal_weights(method: str, changes: dict[str, Any]) -> None:
    check_seeds(method, changes)


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_trainings_files_have_the_values_of_its_learner(method: str, changes: dict[str, Any], tmp_path: Path) -> None:
    check_readers(method, changes, tmp_path)


def test_a_policy_on_a_learnt_reward_has_them_too(tmp_path: Path) -> None:
    train(brief("al", {"preset": "State"}), tmp_path / "al")
    check_readers("ppo", {"preset": "State", "reward.run": tmp_path / "al"}, tmp_path / "ppo")
