"""Policies that learn from the demonstrations of an episode."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
import torch
from magical_intents.cloning import Cloned
from magical_intents.policy import POLICY, load_policy
from magical_intents.train import Lesson, lesson, lessons, train, trained_intents

import magical_mj
from magical_mj import demos
from magical_mj.demos.learning import stream
from magical_mj.intents import EIGHT, SETS, parse
from magical_mj.learners import checkpoint


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


TASKS = ("MatchRegions", "FixColour")


@pytest.fixture(scope="module")
def data() -> list[Lesson]:
    return [lesson(EIGHT[task], stream(demos.load(task)[:3], "State", drop_noop=False)) for task in TASKS]


@pytest.mark.parametrize("given", ["sentence", "demonstrations"])
def test_policies_use_what_they_are_given(given: str, data: list[Lesson], tmp_path: Path) -> None:
    reads, losses = given == "sentence", []
    train(data, tmp_path / "run", reads=reads, updates=30, saved=10, watch=lambda *seen: losses.append(seen))
    assert [updates for updates, _ in losses] == [10, 20, 30]
    assert losses[-1][1] < 2.3 < math.log(18)
    policy = load_policy(tmp_path / "run")
    asked = {"tasks": ",".join(TASKS), "variants": "Demo", "episodes": 1, "jobs": 1}
    how = {} if reads else {"demonstrations": 2}
    right = magical_mj.evaluate(policy, **asked, **how)
    assert right["failure"].isna().all()
    assert set(right["given"]) == {"instruction" if reads else "2 demonstrations"}
    wrong = magical_mj.evaluate(
        policy, control="wrong-instruction" if reads else "wrong-demonstrations", **asked, **how
    )
    assert list(wrong["actions"]) != list(right["actions"])


def test_a_training_continues(data: list[Lesson], tmp_path: Path) -> None:
    train(data, tmp_path / "whole", reads=True, updates=4)
    with pytest.raises(KeyboardInterrupt):
        train(data, tmp_path / "parts", reads=True, updates=4, saved=2, watch=_interrupted)
    train(data, tmp_path / "parts", reads=True, updates=4)
    whole, parts = (checkpoint.read(tmp_path / name / POLICY)["weights"] for name in ("whole", "parts"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)


def _interrupted(updates: int, _: float) -> None:
    if updates == 2:
        raise KeyboardInterrupt


def test_training_intents_include_the_seen_ones() -> None:
    intents = trained_intents(200)
    assert len(set(intents)) == 200
    assert set(intents) <= set(SETS["train"])
    assert set(SETS["seen"][:20]) <= set(intents)


@pytest.mark.slow
def test_demonstrations_are_made_by_the_expert(tmp_path: Path) -> None:
    (only,) = lessons([parse("robot in()")], tmp_path)
    assert len(only.shown) == 3
    assert all(len(shown.histories) == len(shown.actions) > 10 for shown in only.shown)
