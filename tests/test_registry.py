"""Tasks, variants and environments by name."""

from __future__ import annotations

import pytest

from magical_mj.errors import SettingsError, UnknownNameError
from magical_mj.registry import ENVIRONMENTS, environments


def test_lists_of_environments() -> None:
    assert environments() == environments("all", ["all"]) == list(ENVIRONMENTS)
    assert environments("MoveToCorner, MoveToRegion", ["Layout", "TestShape"]) == [
        ("MoveToCorner", "Shape"),
        ("MoveToRegion", "Layout"),
    ]


@pytest.mark.parametrize(
    ("tasks", "variants", "error", "message"),
    [
        ("", "all", SettingsError, "give at least one of MoveToCorner"),
        ([], "all", SettingsError, "give at least one of MoveToCorner"),
        ("FindDup", "all", UnknownNameError, "Did you mean 'FindDupe'"),
        ("all", "Shapes", UnknownNameError, "Did you mean 'Shape'"),
        ("MoveToCorner", "Layout", UnknownNameError, "MoveToCorner has no variant 'Layout'"),
    ],
)
def test_lists_that_name_no_environment(
    tasks: str | list[str], variants: str, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        environments(tasks, variants)
