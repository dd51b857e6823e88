"""The 18 actions: their numbers, their names and what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from magical_mj.actions import ACTIONS, NOOP, Action, Drive, Gripper, Turn, action_number, to_discrete, to_vector
from magical_mj.utils.errors import InvalidActionError


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


@pytest.mark.parametrize(
    "action",
    [
        *(18, -1, 1.5, 1.0, None, "3", True, np.True_, [3], np.array([3, 4]), np.array(1.0), [10**5000]),
        *(Action(*parts) for parts in ((0, 0, -1), (0, 2, 3), (1, 3, 0), (0, 0, None))),
    ],
)
def test_anything_else_is_refused(action: Any) -> None:
    with pytest.raises(InvalidActionError, match=r"0\.\.17"):
        action_number(action)


def test_vectors_are_the_inverse_of_numbers() -> None:
    vectors = to_vector(np.arange(18))
    assert vectors.shape == (18, 3)
    assert len({tuple(vector) for vector in vectors.tolist()}) == 18
    assert [to_discrete(vector) for vector in vectors] == list(range(18))
    assert to_vector(Action(Gripper.CLOSE, Turn.RIGHT, Drive.FORWARD).number).tolist() == [1.0, -1.0, 1.0]


@pytest.mark.parametrize(
    ("vector", "action"),
    [
        ([0.5, -0.5, 0.0], Action()),  # at the thresholds nothing is commanded
        ([0.51, 0.0, -1.0], Action(drive=Drive.FORWARD)),
        ([-0.51, 0.51, 0.01], Action(Gripper.CLOSE, Turn.LEFT, Drive.BACK)),
        ([1.3, -1.1, -0.2], Action(Gripper.OPEN, Turn.RIGHT, Drive.FORWARD)),
    ],
)
def test_thresholds_of_vectors(vector: list[float], action: Action) -> None:
    assert to_discrete(vector) == action.number


@pytest.mark.parametrize(
    "vector",
    [[0.0, np.nan, 0.0], [np.inf, 0.0, 0.0], [0.0, 0.0], [[0.0, 0.0, 0.0]], "abc", None, 3, [1, 2, "x"], [10**400] * 3],
)
def test_malformed_vectors_are_refused(vector: object) -> None:
    with pytest.raises(InvalidActionError, match="three"):
        to_discrete(vector)


@pytest.mark.parametrize("numbers", [18, -1, 1.0, [0, 18], None, True, [[1], [1, 2]], [10**5000]])
def test_numbers_outside_0_to_17_have_no_vector(numbers: object) -> None:
    with pytest.raises(InvalidActionError, match=r"0\.\.17"):
        to_vector(numbers)
