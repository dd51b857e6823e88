"""All methods: a seed decides everything, and a training that went on ends as if it had not been interrupted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.helpers.learners import check_resumes, check_seeds

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


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_resumed_training_ends_like_an_uninterrupted_one(
    method: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    check_resumes(method, changes, tmp_path)


@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_equal_seeds_give_equal_weights(method: str, changes: dict[str, Any]) -> None:
    check_seeds(method, changes)
