"""Policies that learn from the demonstrations of an episode, or read a sentence."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from magical_intents import pictures
from magical_intents.cloning import Cloned
from magical_intents.ends import RIGHT, after, judged_in, resting
from magical_intents.policy import POLICY, load_policy
from magical_intents.scorer import SCALES, Scorer
from magical_intents.search import options, searched
from magical_intents.subgoals import DONE, ROBOT, labels_of
from magical_intents.symmetries import changed, drawn, renamed, words_of
from magical_intents.train import (
    Lesson,
    batch,
    lessons,
    logits_of,
    quality,
    steps_of,
    train,
    trained_intents,
    write_policies,
)

import magical_mj
from magical_mj import demos
from magical_mj.demos.learning import stream
from magical_mj.intents import SETS, parse
from magical_mj.learners import checkpoint
from magical_mj.learners.networks import blocks_of, regions_of
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.utils.errors import TrainingError


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


def test_labels_are_what_the_expert_brought_and_where() -> None:
    for task in ("MoveToRegion", "MatchRegions", "FixColour"):
        for demo in demos.load(task)[:3]:
            (played,) = stream([demo], "State", drop_noop=False)
            labels = labels_of(np.asarray(played.observations), played.actions)
            start, end = demo.scenes()[0], demo.scenes()[-1]
            brought = [k for k in dict.fromkeys(labels.objects.tolist()) if k != DONE]
            poses = [block.pose for block in end.blocks]
            apart = [math.dist(block.pose[:2], pose[:2]) for block, pose in zip(start.blocks, poses, strict=True)]
            far = [k for k, distance in enumerate(apart) if distance > 0.2]
            assert sorted(brought) == ([ROBOT] if task == "MoveToRegion" else far)
            assert labels.objects[-1] == DONE
            for k in brought:
                place = labels.places[np.flatnonzero(labels.objects == k)[-1]]
                assert math.dist(place, (end.robot.pose if k == ROBOT else poses[k])[:2]) < 0.2


def test_changed_scenes_and_sentences_agree() -> None:
    rng = np.random.default_rng(0)
    with closing(magical_mj.Engine("MatchRegions", "All", seed=1)) as engine:
        engine.reset()
        state = torch.from_numpy(engine.state_vector())
    by = drawn(40, rng)
    states = changed(state.expand(40, 1, -1), by)[:, 0]
    for row in range(40):
        colour, shape = (
            dict(zip(names, (names[k] for k in order[row]), strict=True))
            for names, order in ((COLOURS, by.colours), (SHAPES, by.shapes))
        )
        side = {(-1, 0): "left", (1, 0): "right", (0, 1): "top", (0, -1): "bottom"}[
            tuple((by.matrix[row] @ torch.tensor([-1.0, 0.0])).int().tolist())
        ]
        old = parse("wall(colour=red, shape!=star, left) & near(shape=circle, to=blue pentagon)")
        new = parse(
            f"wall(colour={colour['red']}, shape!={shape['star']}, {side}) & "
            f"near(shape={shape['circle']}, to={colour['blue']} {shape['pentagon']})"
        )
        one = by._replace(**{name: values[row : row + 1] for name, values in by._asdict().items()})
        assert sorted(renamed(words_of(old.sentence)[None], one)[0]) == sorted(words_of(new.sentence))
        before, after = blocks_of(state), blocks_of(states[row])
        gap, left = (torch.cdist(rows[:, 1:3], rows[:, 1:3]) for rows in (before, after))
        assert torch.allclose(gap, left, atol=1e-5)
        assert torch.equal(before[:, 0], after[:, 0])
        box, moved = regions_of(state)[0, 1:5], regions_of(states[row])[0, 1:5]
        assert (moved[2:] > moved[:2]).all()
        assert torch.allclose((box[2:] - box[:2]).prod(), (moved[2:] - moved[:2]).prod(), atol=1e-5)


@pytest.fixture(scope="module")
def data() -> list[Lesson]:
    return lessons([parse("in(colour=red, region) & untouched(others)"), parse("wall(all, left) & robot in()")])


def test_final_scenes_have_the_scores_of_the_intent() -> None:
    intent = parse("in(colour=red, region) & untouched(others)")
    scene = intent.spec().demo
    (seen,) = judged_in(intent, scene, [parse("in(all, region)")], np.random.default_rng(0))
    ends = [after(scene, end) for end in seen.ends]
    assert seen.scores.tolist() == [pytest.approx(intent.score(scene, end)) for end in ends]
    assert [intent.holds(scene, end) for end in ends[:RIGHT]] == [True] * RIGHT
    assert not all(intent.holds(scene, end) for end in ends)


def test_demonstrations_and_questions_are_of_different_scenes(data: list[Lesson]) -> None:
    seen = batch(data, np.random.default_rng(0), symmetries=False)
    assert (seen.scores[:, 0] == 1.0).all()
    shown = seen.shown[0]
    for group in range(len(shown)):
        starts = [tuple(start.tolist()) for start in (*shown[group], seen.start[group, 0])]
        assert len(set(starts)) == len(starts)


def test_scores_depend_on_what_is_given_and_not_on_the_order(data: list[Lesson]) -> None:
    scorer = Scorer().eval()
    with torch.inference_mode():
        seen = batch(data, np.random.default_rng(1))
        shown, told = logits_of(scorer, seen)
        turned = logits_of(scorer, seen._replace(shown=(seen.shown[0].flip(1), seen.shown[1].flip(1))))[0]
        others = logits_of(scorer, seen._replace(shown=(seen.shown[0].flip(0), seen.shown[1].flip(0))))[0]
    assert torch.allclose(shown, turned, atol=0.02)  # in bfloat16
    assert not torch.allclose(shown, others, atol=0.02)
    assert not torch.allclose(shown, told, atol=0.02)
    assert all(0.0 <= share <= 1.0 for share in quality(scorer, data, 1))


class Nearness(Scorer):
    """Prefers final scenes with the first block near a corner, and the robot at its start."""

    def forward(self, starts: torch.Tensor, ends: torch.Tensor, scales: torch.Tensor) -> torch.Tensor:
        gap = (blocks_of(ends)[:, 0, 1:3] - 1.0).norm(dim=1)
        return -10 * (gap + (ends[:, :2] - starts[:, :2]).norm(dim=1))


def test_a_search_moves_what_raises_the_score() -> None:
    scene = magical_mj.sample_scene("MatchRegions", "All", 1)
    initial = torch.from_numpy(resting([scene]))
    (end,) = searched(Nearness(), torch.zeros(1, SCALES), initial)
    start, blocks = blocks_of(initial[0]), blocks_of(end)
    assert blocks[0, 1:3].min() > 0.7
    assert torch.equal(blocks[1:], start[1:])
    assert torch.equal(end[:2], initial[0, :2])
    for move in options(initial[0]):
        changed = (blocks_of(move)[:, 1:3] != start[:, 1:3]).any(1).sum() + (move[:2] != initial[0, :2]).any()
        assert changed <= 1


@pytest.fixture(scope="module")
def trained(data: list[Lesson], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, losses = tmp_path_factory.mktemp("trained"), []
    steps = list(steps_of(stream(demos.load("MatchRegions")[:6], "State", drop_noop=False)))
    train(steps, out / "skill", "skill", updates=60, saved=20, watch=lambda *seen: losses.append(seen))
    assert [updates for updates, _ in losses] == [20, 40, 60]
    assert losses[-1][1] < losses[0][1] < math.log(18)
    train(data, out / "scorer", "scorer", updates=2)
    write_policies(out)
    return out


@pytest.mark.parametrize("given", ["sentence", "demonstrations"])
def test_policies_use_what_they_are_given(given: str, trained: Path) -> None:
    how: dict[str, Any] = {"demonstrations": 2} if given == "demonstrations" else {}
    tasks = ["MatchRegions", "FixColour"]
    played = magical_mj.evaluate(load_policy(trained / given), tasks=tasks, variants="Demo", episodes=1, jobs=1, **how)
    assert played["failure"].isna().all()
    assert set(played["given"]) == {"2 demonstrations" if how else "instruction"}
    with pytest.raises(TrainingError, match="does not contain a policy"):
        load_policy(trained / "skill")


def test_a_training_continues(data: list[Lesson], tmp_path: Path) -> None:
    train(data, tmp_path / "whole", "scorer", updates=2)
    with pytest.raises(KeyboardInterrupt):
        train(data, tmp_path / "parts", "scorer", updates=2, saved=1, watch=_interrupted)
    train(data, tmp_path / "parts", "scorer", updates=2)
    whole, parts = (checkpoint.read(tmp_path / name / POLICY)["weights"] for name in ("whole", "parts"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    with pytest.raises(TrainingError, match="another training"):
        train(data, tmp_path / "parts", "scorer", updates=3)


def _interrupted(updates: int, _: float) -> None:
    if updates == 1:
        raise KeyboardInterrupt


def test_training_intents_include_the_seen_ones() -> None:
    intents = trained_intents(200)
    assert len(set(intents)) == 200
    assert set(intents) <= set(SETS["train"])
    assert set(SETS["seen"][:20]) <= set(intents)


def test_pictures_are_cloned_with_the_sentence(tmp_path: Path) -> None:
    intent = parse("robot in()")
    films = pictures.films([intent], tmp_path / "demonstrations")
    assert len(films) == 3
    pictures.train(films, tmp_path / "run", updates=6)
    policy = pictures.load_policy(tmp_path / "run")
    with torch.inference_mode():
        film = films[0]
        words = torch.from_numpy(film.words[:1]).expand(len(film.actions), -1)
        logits = policy._network(torch.from_numpy(film.pictures), words)
    assert torch.nn.functional.cross_entropy(logits, torch.from_numpy(film.actions)) < math.log(18)
    played = magical_mj.evaluate(policy, tasks=f"intent:{intent}", variants="Demo", episodes=1, jobs=1)
    assert played["failure"].isna().all()
    assert set(played["given"]) == {"instruction"}
    checkpoint.write(tmp_path / pictures.POLICY, {"weights": {}})
    with pytest.raises(TrainingError, match="does not contain a policy"):
        pictures.load_policy(tmp_path)
