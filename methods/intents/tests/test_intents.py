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
from magical_intents.network import Planner
from magical_intents.plans import ends_of, followed, planned, wrong_end
from magical_intents.policy import KINDS, POLICY, load_policy
from magical_intents.subgoals import DONE, ROBOT, UNDONE, labels_of
from magical_intents.symmetries import changed, drawn, renamed, words_of
from magical_intents.train import Lesson, batch, lesson, quality, train, trained_intents

import magical_mj
from magical_mj import demos
from magical_mj.demos.learning import stream
from magical_mj.intents import EIGHT, SETS, parse
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


TASKS = ("MatchRegions", "FixColour")


@pytest.fixture(scope="module")
def data() -> list[Lesson]:
    return [lesson(EIGHT[task], stream(demos.load(task)[:3], "State", drop_noop=False)) for task in TASKS]


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


@pytest.mark.parametrize(
    "text", ["near(shape=star, to=blue circle)", "exactly(2, all)", "wall(all, left) & robot in()"]
)
def test_plans_lead_to_their_intents(text: str) -> None:
    every = planned(parse(text), np.random.default_rng(1), 3)
    assert len(every) == 3
    for shown in every:
        start, end = (blocks_of(torch.from_numpy(state)) for state in (shown.states[0], shown.final))
        far = torch.nonzero((end[:, 1:3] - start[:, 1:3]).norm(dim=1) > 0).flatten().tolist()
        *brought, last = dict.fromkeys(shown.labels.objects.tolist())
        assert last == DONE
        assert sorted(brought) == far + [ROBOT] * ("robot" in text)
        there, box = end[:, 0] > 0, regions_of(torch.from_numpy(shown.final))[0, 1:5]
        inside = ((end[:, 1:3] > box[:2]) & (end[:, 1:3] < box[2:])).all(1) & there
        assert not text.startswith("exactly") or inside.sum() == 2
        assert not text.startswith("wall") or (end[there, 1] < -0.7).all()


@pytest.mark.parametrize("text", ["wall(colour=red, left)", "robot in()"])
def test_wrong_ends_do_not_reach_the_intent(text: str) -> None:
    rng = np.random.default_rng(0)
    (shown,) = planned(parse(text), rng, 1)
    for _ in range(6):
        end = wrong_end(shown, rng)
        assert not np.array_equal(end, shown.final)
        there = blocks_of(torch.from_numpy(end))[:, 1:3], blocks_of(torch.from_numpy(shown.final))[:, 1:3]
        assert (end[:2] == shown.states[0][:2]).all() or not torch.equal(*there)


def test_the_label_of_wrong_ends_is_every_object_except_done(data: list[Lesson]) -> None:
    with torch.inference_mode():
        seen, planner = batch(data, np.random.default_rng(0), reads=True), Planner(reads=True)
        plan = planner(seen.initial, seen.now, planner.context(seen.given))
        undone, places = plan.likelihood(torch.full_like(seen.objects, UNDONE), seen.places)
        done, _ = plan.likelihood(torch.full_like(seen.objects, DONE), seen.places)
    assert torch.allclose(undone.exp() + done.exp(), torch.ones(len(done)))
    assert not places.any()
    assert (seen.objects == UNDONE).float().mean() == 0.2  # one of five rows


def test_a_followed_planner_moves_objects_until_it_is_done() -> None:
    planner, scene = Planner(reads=False), magical_mj.sample_scene("MatchRegions", "All", 1)
    for bias, same in ((100.0, True), (-100.0, False)):
        torch.nn.init.constant_(planner.done.bias, bias)
        (end,) = followed(planner, ends_of([(scene, scene)]), [scene])
        assert (end == scene) == same
    assert [(block.shape, block.colour) for block in end.blocks] == [(b.shape, b.colour) for b in scene.blocks]


@pytest.fixture(scope="module")
def skill(data: list[Lesson], tmp_path_factory: pytest.TempPathFactory) -> Path:
    out, losses = tmp_path_factory.mktemp("skill"), []
    train(data, out, "skill", updates=60, saved=20, watch=lambda *seen: losses.append(seen))
    assert [updates for updates, _ in losses] == [20, 40, 60]
    assert losses[-1][1] < losses[0][1] < math.log(18)
    return out


@pytest.mark.parametrize("kind", KINDS[1:])
def test_policies_use_what_they_are_given(kind: str, data: list[Lesson], skill: Path, tmp_path: Path) -> None:
    reads = kind == "sentence"
    train(data, tmp_path / "run", kind, skill=skill, updates=5)
    policy = load_policy(tmp_path / "run")
    how: dict[str, Any] = {} if reads else {"demonstrations": 2}
    played = magical_mj.evaluate(policy, tasks=TASKS, variants="Demo", episodes=1, jobs=1, **how)
    assert played["failure"].isna().all()
    assert set(played["given"]) == {"instruction" if reads else "2 demonstrations"}
    planner, seen = policy.planner, batch(data, np.random.default_rng(0), reads=reads)
    with torch.inference_mode():
        plans = [planner(seen.initial, seen.now, planner.context(given)) for given in (seen.given, seen.given.flip(0))]
    assert not torch.allclose(plans[0].objects, plans[1].objects, atol=1e-3)
    assert 0.0 <= quality(planner, data, 1).objects <= 1.0


def test_a_training_continues(data: list[Lesson], tmp_path: Path) -> None:
    train(data, tmp_path / "whole", "sentence", updates=2)
    with pytest.raises(KeyboardInterrupt):
        train(data, tmp_path / "parts", "sentence", updates=2, saved=1, watch=_interrupted)
    train(data, tmp_path / "parts", "sentence", updates=2)
    whole, parts = (checkpoint.read(tmp_path / name / POLICY)["weights"] for name in ("whole", "parts"))
    assert all(torch.equal(whole[name], parts[name]) for name in whole)
    with pytest.raises(TrainingError, match="another training"):
        train(data, tmp_path / "parts", "sentence", updates=3)
    with pytest.raises(TrainingError, match="does not contain a policy"):
        load_policy(tmp_path / "parts")  # without a skill


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
