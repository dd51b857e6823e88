"""Policies that learn from the demonstrations of an episode."""

from __future__ import annotations

from magical_intents.cloning import Cloned

import magical_mj


def test_the_given_demonstrations_are_cloned_once() -> None:
    policy = Cloned(batches=2)
    asked = {"variants": "Demo,Jitter", "episodes": 2, "jobs": 1}
    scores = magical_mj.evaluate(policy, tasks="MoveToCorner,MoveToRegion", demonstrations=2, **asked)
    assert scores["failure"].isna().all()
    assert set(scores["given"]) == {"2 demonstrations"}
    assert len(policy._trained) == 2
    again = magical_mj.evaluate(Cloned(batches=2), tasks="MoveToCorner,MoveToRegion", demonstrations=2, **asked)
    assert list(scores["actions"]) == list(again["actions"])
    other = magical_mj.evaluate(
        Cloned(batches=2), tasks="MoveToCorner,MoveToRegion", demonstrations=2, control="wrong-demonstrations", **asked
    )
    assert list(scores["actions"]) != list(other["actions"])
