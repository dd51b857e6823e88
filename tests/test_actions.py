"""The 18 actions: their numbers, their names and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from magical_mj.actions import ACTIONS, NOOP, Action, Drive, Gripper, Turn, action_number
from magical_mj.errors import InvalidActionError


def test_numbers_are_those_of_the_original() -> None:
    assert len(ACTIONS) == 18
    assert [action.number for action in ACTIONS] == list(range(18))
    assert ACTIONS[0] == (Gripper.OPEN, Turn.NONE, Drive.NONE)
    assert ACTIONS[1] == (Gripper.OPEN, Turn.NONE, Drive.FORWARD)
    assert ACTIONS[5] == (Gripper.OPEN, Turn.LEFT, Drive.BACK)
    assert ACTIONS[6] == (Gripper.OPEN, Turn.RIGHT, Drive.NONE)
    assert ACTIONS[16] == (Gripper.CLOSE, Turn.RIGHT, Drive.FORWARD)


def test_the_noop_keeps_everything_as_it_is_at_the_start() -> None:
    assert ACTIONS[NOOP] == Action(Gripper.OPEN, Turn.NONE, Drive.NONE)


def test_names_are_readable_and_unique() -> None:
    assert ACTIONS[13].name == "close-left-forward"
    assert len({action.name for action in ACTIONS}) == 18


@pytest.mark.parametrize(
    "action", [7, np.int64(7), np.uint8(7), np.array(7), Action(Gripper.OPEN, Turn.RIGHT, Drive.FORWARD)]
)
def test_every_integer_type_and_the_triples_are_taken(action: Any) -> None:
    number = action_number(action)
    assert number == 7
    assert type(number) is int


@pytest.mark.parametrize("action", [18, -1, 1.5, 1.0, None, "3", True, np.True_, [3], np.array([3, 4]), np.array(1.0)])
def test_anything_else_is_refused(action: Any) -> None:
    with pytest.raises(InvalidActionError, match=r"is not an action: actions are the integers 0\.\.17"):
        action_number(action)
