"""Policies that learn from the demonstrations of an episode, or read a sentence."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from magical_intents import inferring
from magical_intents.carrier import NOTHING, Carrier
from magical_intents.cloning import Cloned
from magical_intents.ends import RIGHT, after, judged_in, resting
from magical_intents.guide import Guide
from magical_intents.lessons import SENTENCES, Lesson, batch, kept_lessons, lessons, scored_in
from magical_intents.network import SIZE
from magical_intents.policy import POLICY, load_policy
from magical_intents.practice import Steps, brought, kept
from magical_intents.scenery import View, pictures_of_scene
from magical_intents.scenes import ROBOT, positions_of, scene_of
from magical_intents.scorer import CONTEXT, Encoded, Scored, Scorer
from magical_intents.search import options, searched
from magical_intents.sight import Sight, sight_loss, turned
from magical_intents.skill import Skill
from magical_intents.symmetries import changed, drawn, renamed, words_of
from magical_intents.train import train, write_policies

import magical_mj
from magical_mj.intents import parse
from magical_mj.learners import checkpoint
from magical_mj.learners.networks import blocks_of, regions_of
from magical_mj.observations import FINGERS
from magical_mj.scene import Block, Robot, Scene
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


@pytest.fixture(scope="module")
def practice() -> list[Steps]:
    novice, rng = Skill().eval(), np.random.default_rng(0)
    return [*brought(rng, None), *brought(rng, None), *brought(rng, novice)]


def test_what_is_kept_is_made_once(tmp_path: Path) -> None:
    path = tmp_path / "new" / "0.npz"
    first = kept(path, lambda: {"numbers": np.arange(3)})
    again = kept(path, dict)
    assert first["numbers"].tolist() == again["numbers"].tolist() == [0, 1, 2]


def test_practice_brings_objects_to_their_places(practice: list[Steps]) -> None:
    assert len(practice) > 8
    for states, actions, objects, places, vias in practice:
        assert len(states) == len(actions) == len(objects) == len(places) == len(vias)
        assert objects[0] == ROBOT or math.dist(vias[-1], places[-1]) < 0.2
        positions = [positions_of(torch.from_numpy(state))[objects[0]].numpy() for state in states]
        gaps = [math.dist(position, places[0]) for position in positions]
        assert gaps[-1] < 0.15
        assert gaps[-1] < gaps[0] or gaps[0] < 0.15


def test_a_carrier_chooses_blocks_then_the_robot_then_nothing() -> None:
    with closing(magical_mj.Engine("MatchRegions", "All", seed=1)) as engine:
        state, count = torch.from_numpy(engine.state_vector()), len(engine.scene.blocks)
    here = positions_of(state)
    assert int(here.isnan().any(1).sum()) == ROBOT - count
    places = here.clone()
    places[[0, 1]] = torch.tensor([[0.0, 0.0], [0.5, 0.5]])
    places[ROBOT] = torch.tensor([-0.5, -0.5])
    carrier = Carrier(Skill(), np.random.default_rng(0), places)
    chosen = []
    for done in ([], [0, 1], [0, 1, ROBOT]):
        now = state.clone()
        for number in done:
            (now[:2] if number == ROBOT else blocks_of(now)[number, 1:3]).copy_(places[number])
        carrier(now)
        chosen.append(carrier.brought)
    assert chosen[0] in (0, 1)
    assert chosen[1:] == [ROBOT, NOTHING]


def test_a_guide_leads_around_blocks_and_with_a_held_block_to_its_place() -> None:
    row = [Block("circle", "red", x, -0.1, 0.0) for x in (-0.3, 0.0, 0.3)]
    scene = Scene(Robot(0.0, -0.6, 0.0), (*row, Block("square", "blue", 0.0, 0.5, 0.0)))
    (state,) = resting([scene])
    assert abs(Guide(3, (-0.7, 0.7))(state)[0]) > 0.4
    near = resting([scene.moved((0.0, 0.27, 0.0), [*(one.pose for one in row), (0.0, 0.6, 0.0)])])[0]
    near[FINGERS] = 0.2, -0.2
    assert Guide(3, (0.0, 0.8))(near) == pytest.approx((0.0, 0.8))
    assert Guide(ROBOT, (0.5, 0.3))(near) == pytest.approx((0.5, 0.3))


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
    inside = [[scene.regions[0].contains(block) for block in end.blocks if block.colour == "red"] for end in ends]
    assert seen.shares[:, 0].tolist() == [pytest.approx(sum(flags) / len(flags)) for flags in inside]
    assert (seen.shares[:, 2] == -1).all()
    assert np.flatnonzero(seen.named).tolist() == [k for k, one in enumerate(scene.blocks) if one.colour == "red"]


def test_samples_are_made_once(tmp_path: Path) -> None:
    first = kept_lessons([parse("in(all, region)")], tmp_path)
    again = kept_lessons([], tmp_path)
    assert len(first) == len(again) == 1
    for one, other in zip(first[0].scenes, again[0].scenes, strict=True):
        assert all(np.array_equal(*parts) for parts in zip(one, other, strict=True))


def test_demonstrations_and_questions_are_of_different_scenes(data: list[Lesson]) -> None:
    numbers = set()
    for seed in range(8):
        seen = batch(data, np.random.default_rng(seed), symmetries=False)
        assert (seen.scores[:, 0] == 1.0).all()
        for shown, start in zip(seen.shown[0], seen.start, strict=True):
            starts = {tuple(one.tolist()) for one in shown}
            assert len(starts) in (1, len(shown))
            assert tuple(start.tolist()) not in starts
            numbers.add(len(starts))
    assert numbers >= {1, 4}


def test_scores_depend_on_what_is_given_and_not_on_the_order(data: list[Lesson]) -> None:
    scorer = Scorer().eval()
    with torch.inference_mode():
        seen = batch(data, np.random.default_rng(1))
        turned = seen._replace(shown=(seen.shown[0].flip(1), seen.shown[1].flip(1)))
        others = seen._replace(shown=(seen.shown[0].flip(0), seen.shown[1].flip(0)))
        words = seen._replace(words=seen.words.flip(0))
        given, turned, others, words = (
            scored_in(scorer, one)[1].scores.view(len(one.words), -1) for one in (seen, turned, others, words)
        )
    assert torch.allclose(given, turned, atol=1e-4)
    assert torch.allclose(given[:SENTENCES], others[:SENTENCES], atol=1e-4)
    assert not torch.allclose(given[SENTENCES:], others[SENTENCES:], atol=1e-3)
    assert torch.allclose(given[SENTENCES:], words[SENTENCES:], atol=1e-4)
    assert not torch.allclose(given[:SENTENCES], words[:SENTENCES], atol=1e-3)


class Nearness(Scorer):
    """Prefers final scenes with the first block near a corner, and the robot at its start."""

    def scored(self, encoded: Encoded, ends: torch.Tensor) -> Scored:
        gap = (blocks_of(ends)[:, 0, 1:3] - 1.0).norm(dim=1)
        return Scored(-10 * (gap + (ends[:, :2] - encoded.states[:, :2]).norm(dim=1)), torch.zeros(len(ends), 3))


def test_a_search_moves_what_raises_the_score() -> None:
    scene = magical_mj.sample_scene("MatchRegions", "All", 1)
    initial = torch.from_numpy(resting([scene]))
    (end,) = searched(Nearness(), torch.ones(1, CONTEXT, SIZE), initial)
    start, blocks = blocks_of(initial[0]), blocks_of(end)
    assert blocks[0, 1:3].min() > 0.7
    assert torch.equal(blocks[1:], start[1:])
    assert torch.equal(end[:2], initial[0, :2])
    for move in options(initial[0]):
        changed = (blocks_of(move)[:, 1:3] != start[:, 1:3]).any(1).sum() + (move[:2] != initial[0, :2]).any()
        assert changed <= 1


@pytest.fixture(scope="module")
def seen() -> list[View]:
    return [one for number in range(2) for one in pictures_of_scene(np.random.default_rng(number))]


@pytest.fixture(scope="module")
def trained(
    data: list[Lesson], practice: list[Steps], seen: list[View], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    out, losses = tmp_path_factory.mktemp("trained"), []
    train(practice, out / "skill", "skill", updates=60, saved=20, watch=lambda *seen: losses.append(seen))
    assert [updates for updates, _ in losses] == [20, 40, 60]
    assert losses[-1][1] < losses[0][1] < math.log(18)
    train(seen, out / "sight", "sight", updates=2)
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


@pytest.mark.parametrize("name", ["inference", "pictures"])
def test_policies_without_a_simulator_infer_the_intent(name: str, trained: Path, tmp_path: Path) -> None:
    policy = inferring.load_policy(trained / name)
    played = magical_mj.evaluate(
        policy, tasks="MoveToRegion", variants="Layout", episodes=1, jobs=1, demonstrations=2, renderer="software"
    )
    assert played["failure"].isna().all()
    checkpoint.write(tmp_path / inferring.POLICY, {"skill": {}})
    with pytest.raises(TrainingError, match="does not contain a policy"):
        inferring.load_policy(tmp_path)


def test_places_are_those_of_the_inferred_intent() -> None:
    intent = parse("wall(colour=red, left)")
    scene = next(
        scene
        for seed in range(100)
        if intent.grounded(scene := magical_mj.sample_scene("ClusterColour", "All", seed))
        and not intent.holds(scene, scene)
    )
    (state,) = resting([scene])
    assert scene_of(state).blocks[0].shape == scene.blocks[0].shape
    places = inferring.places_after(intent, scene, scene)
    end = scene.moved(None, [(*place.tolist(), 0.0) for place in places[: len(scene.blocks)]])
    assert intent.holds(scene, end)
    assert places[ROBOT].isnan().all()
    stays = inferring.places_after(None, scene, scene)
    assert torch.equal(stays[:ROBOT].nan_to_num(), positions_of(torch.from_numpy(state))[:ROBOT].nan_to_num())
    driven = inferring.places_after(parse("robot wall(left)"), scene, scene)
    assert torch.equal(stays[:ROBOT].nan_to_num(), driven[:ROBOT].nan_to_num())
    assert driven[ROBOT][0] < -0.5


def test_turned_pictures_are_those_of_changed_scenes(seen: list[View]) -> None:
    picture, state = seen[0]
    by = drawn(8, np.random.default_rng(0))._replace(
        colours=torch.arange(4).expand(8, 4), shapes=torch.arange(4).expand(8, 4)
    )
    states = changed(torch.from_numpy(state).expand(8, 1, -1), by)[:, 0]
    for drawn_picture, other in zip(turned(torch.from_numpy(picture).expand(8, -1, -1, -1), by), states, strict=True):
        with closing(magical_mj.Engine.of_scene(scene_of(other.numpy()), renderer="software")) as engine:
            differs = np.abs(engine.render("allo", 96).astype(int) - drawn_picture.numpy()).max(2) > 60
        assert differs.mean() < 0.02


def test_sight_learns_from_pictures(seen: list[View]) -> None:
    torch.manual_seed(0)
    network, losses = Sight(), []
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    for update in range(60):
        loss = sight_loss(network, seen, np.random.default_rng(update), 8)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert np.mean(losses[-10:]) < 0.8 * np.mean(losses[:10])
    found = network.states(np.stack([one.picture for one in seen]))
    assert found.shape == (len(seen), len(seen[0].state))
    assert np.isfinite(found).all()


def test_blocks_keep_their_numbers(seen: list[View]) -> None:
    before = seen[0].state
    count = int(blocks_of(torch.from_numpy(before))[:, 0].sum())
    now = before.copy()
    rows = blocks_of(torch.from_numpy(now))
    rows[:count, 1:3] += 0.05
    order = np.random.default_rng(0).permutation(count)
    rows[:count] = rows[:count][order].clone()
    rows[count - 1] = 0  # is not seen
    (found,) = inferring.followed(now[None], before)
    old, new = (blocks_of(torch.from_numpy(one)) for one in (before, found))
    lost = order[count - 1]
    moved = (new[:, 1:3] - old[:, 1:3]).norm(dim=1)
    assert moved[lost] == 0
    assert all(moved[k] == pytest.approx(0.05 * 2**0.5, abs=1e-5) for k in range(count) if k != lost)
    assert torch.equal(old[:, 7:], new[:, 7:])


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
