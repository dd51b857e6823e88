"""`relational`: its network, its assumptions, and the rule that keeps them. `redraw`, which learns from it."""

from __future__ import annotations

import json
import lzma
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from magical_relational import redraw
from magical_relational.grips import gripped
from magical_relational.method import REPORT, Relational, demonstrated
from magical_relational.network import STANDING, Ensemble, graph
from magical_relational.policy import POLICY, load_policy
from magical_relational.redraw import Redraw, Redrawer, scenes_of
from magical_relational.replay import NEXT_TO, PATH_POINTS, Freedom, Replay, Samples, in_hand, read
from magical_relational.samples import close, contrast, displace, exchange, mirror, rename
from magical_relational.settings import ASSUMPTIONS, RelationalSettings

from magical_mj import TASKS, demos
from magical_mj.engine import Engine
from magical_mj.evaluation import evaluate
from magical_mj.learners import checkpoint, load_settings, train
from magical_mj.learners.networks import blocks_of, regions_of
from magical_mj.learners.policy import export_policy
from magical_mj.learners.run_folder import RunFolder
from magical_mj.observations import MAX_REGIONS
from magical_mj.policies.interface import histories
from magical_mj.scene import GoalRegion, Scene
from magical_mj.utils.errors import SettingsError, UnknownNameError
from tests.helpers.learners import (
    EXPORTS,
    TINY,
    check_own_demonstrations,
    check_readers,
    check_resumes,
    compare_exported,
)

RELATIONAL = {
    "relational.hidden": 8,
    "relational.trial": 1,
    "relational.batch_size": 8,
    "relational.rollouts": 2,
    "relational.ways": 100,
    "relational.plays": 1,
    "relational.grips": 50,
}
NOTHING_TRIED = RelationalSettings(assumptions=())
CLOSED, PULL = 9, 11
EGOCENTRIC, ARENA = torch.zeros(()), torch.ones(())
SMALL = {"preset": "State", "device": "cpu", "evaluations": 0, "demonstrations": 2, **RELATIONAL}


def states_of(task: str, steps: int = 30) -> tuple[torch.Tensor, torch.Tensor]:
    demonstration = demos.load(task)[0]
    way = Replay(Engine.of_scene(demonstration.scene), demonstration)
    return torch.from_numpy(way.states[:steps].copy()), torch.from_numpy(way.actions[:steps].copy())


def turned(states: torch.Tensor, x: float, y: float) -> torch.Tensor:
    """The same states in an arena that is rotated by 90 degrees and moved."""
    states = states.clone()
    blocks, regions = blocks_of(states), regions_of(states)
    for rows in (states, blocks[..., 1:]):
        rows[..., 0], rows[..., 1] = x - rows[..., 1], y + rows[..., 0].clone()
        rows[..., 2] += np.pi / 2
    corners = regions[..., 1:5].clone()
    regions[..., 1], regions[..., 3] = x - corners[..., 3], x - corners[..., 1]
    regions[..., 2], regions[..., 4] = y + corners[..., 0], y + corners[..., 2]
    return states


def test_without_the_arena_only_the_view_of_the_robot_counts() -> None:
    states, _ = states_of("FindDupe")
    for before, after in zip(graph(states, EGOCENTRIC), graph(turned(states, 0.3, -0.2), EGOCENTRIC), strict=True):
        torch.testing.assert_close(before, after, atol=1e-5, rtol=1e-4)
    assert not torch.allclose(graph(states, ARENA)[0], graph(turned(states, 0.3, -0.2), ARENA)[0])


def test_the_order_of_blocks_changes_nothing() -> None:
    states = states_of("ClusterShape")[0]
    ensemble = Ensemble(RelationalSettings(networks=2))
    other = states.clone()
    blocks_of(other).copy_(blocks_of(states).flip(1))
    torch.testing.assert_close(ensemble.logits(states), ensemble.logits(other))


def test_a_mirrored_world_answers_mirrored_actions_alike() -> None:
    """Compares `mirror`'s states and actions with a simulation of the mirrored scene."""
    demonstration = demos.load("MatchRegions")[0]
    scene = demonstration.scene
    poses = [(-block.x, block.y, -block.angle) for block in scene.blocks]
    other = scene.moved(robot=(-scene.robot.x, scene.robot.y, -scene.robot.angle), blocks=poses)
    regions = [GoalRegion(r.colour, -r.x_max, r.y_min, -r.x_min, r.y_max) for r in scene.regions]
    engines = Engine.of_scene(scene), Engine.of_scene(Scene(other.robot, other.blocks, regions, scene.dynamics))
    always = torch.Generator().manual_seed(2)
    for action in demonstration.actions[:25].tolist():
        states = torch.from_numpy(engines[0].state_vector()).repeat(20, 1)
        actions = mirror(states, torch.full((20,), action), always)
        mirrored = states[:, 0] != engines[0].state_vector()[0]
        assert 0 < mirrored.sum() < 20
        expected = torch.from_numpy(engines[1].state_vector())
        seen, wanted = (graph(rows, EGOCENTRIC)[0] for rows in (states[mirrored][:1], expected[None]))
        torch.testing.assert_close(seen, wanted, atol=2e-2, rtol=0)
        engines[0].step(action)
        engines[1].step(int(actions[mirrored][0]))


def test_names_are_exchanged_and_what_shares_them_is_not() -> None:
    states, _ = states_of("FindDupe")
    other = states.clone()
    rename(other, torch.Generator().manual_seed(0))
    assert not torch.equal(blocks_of(states), blocks_of(other))
    torch.testing.assert_close(graph(states, ARENA)[1], graph(other, ARENA)[1])
    assert torch.equal(states[:, :8], other[:, :8])


def test_contrast_changes_what_distinguishes_other_blocks_and_not_the_duplicate() -> None:
    """In FindDupe, others may share the query's shape or its colour, but only the duplicate shares both."""
    demonstrations = demos.load("FindDupe")[:4]
    samples = demonstrated(demonstrations, NOTHING_TRIED, 0, deliveries=True).shown
    other = Samples(*(part.clone() for part in samples))
    contrast(other, torch.Generator().manual_seed(0))
    assert torch.equal(samples.actions, other.actions)
    assert torch.equal(samples.states[:, :8], other.states[:, :8])
    assert torch.equal(regions_of(samples.states), regions_of(other.states))
    before, after = blocks_of(samples.states), blocks_of(other.states)
    *others, duplicate, query = range(len(demonstrations[0].scene.blocks))
    for block in (duplicate, query):
        assert torch.equal(before[:, block], after[:, block])
    looks = after[:, others, 7:15].unflatten(2, (2, 4))  # shape and colour
    same = (looks * after[:, query, None, 7:15].unflatten(2, (2, 4))).sum(3)
    assert {(0, 0), (0, 1), (1, 0)} == {tuple(pair) for pair in same.flatten(0, 1).int().tolist()}
    assert (before[:, others, 7:15] != after[:, others, 7:15]).any(2).any(0).all()
    assert (same[:, 1] == 1).any()  # the red circle shares nothing in the demo scene
    moved = (before[..., 1:3] != after[..., 1:3]).any(2)
    assert moved.any()
    ahead = in_front(other.states[moved.any(1)], moved[moved.any(1)])
    assert (ahead > 0).float().mean() > 0.9


def in_front(states: torch.Tensor, chosen: torch.Tensor) -> torch.Tensor:
    """How far ahead of the robot a chosen block is, shape (n,)."""
    away = (blocks_of(states)[..., 1:3] * chosen[..., None]).sum(1) - states[:, :2]
    return away[:, 1] * states[:, 2].cos() - away[:, 0] * states[:, 2].sin()


def test_blocks_that_are_only_bumped_are_not_delivered() -> None:
    """In FindDupe the duplicate is delivered. On the way the robot bumps the star, which may be displaced."""
    demonstrations = demos.load("FindDupe")[:4]
    duplicate, star = 5, 4
    with closing(Engine.of_scene(demonstrations[0].scene)) as engine:
        deliveries, motions = (read(engine, demonstrations, deliveries=deliveries) for deliveries in (True, False))
    start = np.array([0])
    assert any(replay.begins[star] < replay.never for replay in motions)
    for replay in deliveries:
        assert replay.matters.nonzero()[0].tolist() == [duplicate]
        assert {motion.block for motion in replay.motions()} == {duplicate}
        _, _, droppable = replay.displaceable(start)
        assert droppable[0, MAX_REGIONS:].nonzero()[:, 0].tolist() == [0, 1, 2, 3, star]
    assert not all(replay.displaceable(start)[2][0, MAX_REGIONS + star] for replay in motions)


def test_a_block_that_another_demonstration_moves_is_not_removed() -> None:
    demonstrations = demos.load("MakeLine")
    with closing(Engine.of_scene(demonstrations[0].scene)) as engine:
        replays = read(engine, demonstrations, deliveries=True)
    assert any((replay.begins[:4] == replay.never).any() for replay in replays)
    assert not any(replay.displaceable(np.arange(5))[2].any() for replay in replays)


def test_releases_begin_with_a_held_block_and_end_away_from_it() -> None:
    demonstration = demos.load("MatchRegions")[0]
    with closing(Engine.of_scene(demonstration.scene)) as engine:
        replay = Replay(engine, demonstration, deliveries=True)
    (region,) = demonstration.scene.regions
    steps = replay.releases()
    parts = np.split(steps, np.flatnonzero(np.diff(steps) != 1) + 1)
    assert len(parts) == 2  # blocks
    for part in parts:
        assert (replay.actions[part] < CLOSED).all()
        assert replay.actions[part[0] - 1] >= CLOSED
        block = int(np.linalg.norm(replay.positions[part[0], :5] - replay.states[part[0], :2], axis=1).argmin())
        x, y = replay.positions[part[-1], block]
        assert region.x_min < x < region.x_max
        assert region.y_min < y < region.y_max
        away = np.linalg.norm(replay.positions[part[-1] + 1, block] - replay.states[part[-1] + 1, :2])
        assert 0.35 < away < NEXT_TO + 0.1


@pytest.mark.parametrize("deliveries", [True, False])
def test_a_mismatched_block_is_taken_in_its_region_and_left_outside(deliveries: bool) -> None:
    """In FixColour, the robot turns about the region with its block. Read by motions, the block may be anywhere."""
    samples = demonstrated(demos.load("FixColour")[:4], NOTHING_TRIED, 0, deliveries=deliveries).shown
    other, odd = displaced(samples, pairs=True), 2
    before, after = (regions_with(states, odd) for states in (samples.states, other.states))
    moved = (other.states[:, :2] != samples.states[:, :2]).any(1)
    taken = moved & before & (samples.freedom != Freedom.REMOVES)
    assert taken.any()
    assert after[taken].all() == deliveries
    left = moved & ~before
    assert left.any() == deliveries
    assert (samples.freedom[left] == Freedom.REMOVES).all()


def regions_with(states: torch.Tensor, block: int) -> torch.Tensor:
    """Whether a block is in any region, shape (n,)."""
    position, regions = blocks_of(states)[:, block, None, 1:3], regions_of(states)
    inside = (position > regions[..., 1:3]).all(2) & (position < regions[..., 3:5]).all(2) & (regions[..., 0] > 0.5)
    return inside.any(1)


def displaced(samples: Samples, *, pairs: bool) -> Samples:
    other = Samples(*(part.clone() for part in samples))
    displace(other, torch.Generator().manual_seed(0), pairs=pairs)
    return other


def test_only_what_does_not_matter_now_is_displaced() -> None:
    """Other blocks are displaced, and regions with their content, but not the block that the robot approaches."""
    samples = demonstrated([demos.load("FixColour")[0]], NOTHING_TRIED, 0).shown
    other = displaced(samples, pairs=False)
    assert torch.equal(samples.states[:, :8], other.states[:, :8])
    shift = blocks_of(other.states)[..., 1:3] - blocks_of(samples.states)[..., 1:3]
    assert (shift != 0).any()
    for number, (group, moved) in enumerate(zip(samples.groups.T, shift.norm(dim=2).T, strict=True)):
        rows = (moved > 0).nonzero()[:, 0]
        assert samples.movable[rows, group[rows]].all()
        inside = rows[group[rows] < MAX_REGIONS]
        middles = [regions_of(states)[inside, group[inside], 1:3] for states in (other.states, samples.states)]
        torch.testing.assert_close(middles[0] - middles[1], shift[inside, number])


def test_a_robot_is_moved_with_the_block_that_it_takes_and_sees_it_as_before() -> None:
    """The robot moves with the block that it approaches. With a held block, it rotates about a region's centre."""
    samples = demonstrated(demos.load("MatchRegions")[:4], NOTHING_TRIED, 0).shown
    samples = samples._replace(movable=torch.zeros_like(samples.movable))
    other = displaced(samples, pairs=True)
    moved = (other.states[:, :2] != samples.states[:, :2]).any(1)
    assert {Freedom.TURNS, Freedom.ANYWHERE} == set(samples.freedom[moved].tolist())
    rest = ~samples.pair[moved]
    assert torch.equal(blocks_of(other.states)[moved][rest], blocks_of(samples.states)[moved][rest])
    views = []
    for states in (samples.states[moved], other.states[moved]):
        block, sin, cos = blocks_of(states)[~rest], states[:, 2].sin(), states[:, 2].cos()
        x, y = (block[:, 1:3] - states[:, :2]).T
        heading = block[:, 3] - states[:, 2]
        views.append(torch.stack([cos * x + sin * y, cos * y - sin * x, heading.sin(), heading.cos()]))
    torch.testing.assert_close(*views, atol=1e-5, rtol=0)


@pytest.mark.parametrize("task", ["MoveToRegion", "FixColour"])
def test_ways_by_hindsight_end_where_a_demonstration_was(task: str) -> None:
    chosen = RelationalSettings(assumptions=("hindsight",), ways=200, plays=2)
    shown, ways, *_ = demonstrated([demos.load(task)[0]], chosen, 0)
    assert len(ways.path) >= 200
    ends = ways.path[:, PATH_POINTS // 2 - 1]
    assert torch.cdist(ends, shown.states[:, :2]).amin(1).max() < 0.03  # steps without action are not shown
    assert (ways.states[:, :2] - ends).norm(dim=1).max() > 0.5


def test_grips_hold_the_block_that_a_demonstration_takes() -> None:
    """Most samples do, also from rest. The block may have been pushed, but the others are not moved."""
    demonstration = demos.load("MatchRegions")[0]
    with closing(Engine.of_scene(demonstration.scene)) as engine:
        replay = Replay(engine, demonstration)
        ways = gripped(engine, [replay], 200, np.random.default_rng(0))
    assert sum(len(way.actions) for way in ways) >= 200
    held, pushed = [], []
    for way in ways:
        (block,) = way.pair[0].nonzero()[:, 0].tolist()
        first = way.states[0]
        positions = blocks_of(first[None])[0, :, 1:3].numpy()
        moved = np.linalg.norm(blocks_of(way.states)[..., 1:3].numpy() - replay.positions[0], axis=2).max(0)
        pushed.append(moved[block] > 0.1)
        others = np.linalg.norm(positions - replay.positions, axis=2).min(0)  # each is where it was at some time
        assert np.delete(others, block).max() < 0.03
        (scene,) = scenes_of(first[None])
        number = [np.allclose((other.x, other.y), positions[block]) for other in scene.blocks].index(True)
        with closing(Engine.of_scene(scene)) as engine:
            for action in [*way.actions.tolist(), *[CLOSED] * 2]:
                engine.step(action)
            before = in_hand(engine.state_vector(), number)
            for action in [PULL] * 3:
                engine.step(action)
            held.append(np.linalg.norm(in_hand(engine.state_vector(), number) - before) < 0.05)
    assert np.mean(held) > 0.6
    assert any(pushed)


def test_a_robot_releases_a_block_that_it_should_not_hold() -> None:
    """In FindDupe, held blocks lose the query's look, and the robot opens its fingers. Others keep their actions."""
    samples = demonstrated(demos.load("FindDupe")[:4], NOTHING_TRIED, 0, deliveries=True).shown
    other = Samples(*(part.clone() for part in samples))
    held = (samples.actions >= CLOSED) & samples.pair.any(1)
    exchange(other, held.float(), torch.Generator().manual_seed(0))
    assert torch.equal(samples.states[:, :8], other.states[:, :8])
    assert torch.equal(blocks_of(samples.states)[..., :7], blocks_of(other.states)[..., :7])
    rows, mine = samples.pair.nonzero().T
    query = len(demos.load("FindDupe")[0].scene.blocks) - 1
    same = [
        (blocks_of(states)[rows, mine, 7:] == blocks_of(states)[rows, query, 7:]).all(1)
        for states in (samples.states, other.states)
    ]
    assert same[0].all()
    assert torch.equal(same[1], ~held[rows])
    assert (other.actions[held] < CLOSED).all()
    assert torch.equal(samples.actions[~held], other.actions[~held])
    assert (other.freedom[held] == Freedom.ANYWHERE).all()


def test_fingers_are_closed_only_if_they_are_empty_and_open_again() -> None:
    samples = demonstrated(demos.load("MatchRegions")[:4], NOTHING_TRIED, 0, deliveries=True).shown
    other = Samples(*(part.clone() for part in samples))
    close(other, torch.Generator().manual_seed(0))
    closed = (samples.states != other.states).any(1)
    changed = (samples.states != other.states).any(0).nonzero()[:, 0].tolist()
    assert changed == [6, 7]
    assert (other.actions[closed] < CLOSED).all()
    assert (other.states[closed, 6].abs() < samples.states[closed, 6].abs() + 1e-3).all()
    blocks = blocks_of(other.states[closed])
    assert ((blocks[..., 1:3] - other.states[closed, None, :2]).norm(dim=2)[blocks[..., 0] > 0] > NEXT_TO).all()


def test_a_robot_that_is_stuck_acts_less_sharply() -> None:
    actor = Ensemble(RelationalSettings(hidden=8))
    state = torch.from_numpy(Engine.of_scene(demos.load("FixColour")[0].scene).state_vector())
    histories = state.expand(3, 4, -1).clone()
    histories[1, -2, 0] += 0.02  # drives
    histories[2, -2, 6] += 0.05  # closes the hand
    logits = actor(histories, torch.zeros(3, dtype=torch.int64)).detach()
    expected = actor.logits(state[None]).detach() * torch.tensor([[STANDING], [1.0], [1.0]])
    torch.testing.assert_close(logits, expected)


class Judged(Relational):
    """A method with prescribed scores of its policies in the demo scene."""

    given: tuple[float, ...]

    def demo_scores(self, episodes: int) -> dict[str, float]:
        del episodes
        return {self.settings.tasks[0]: self.given[len(self._report)]}


LETTERS = dict(zip("emrhgd", ASSUMPTIONS[:6], strict=True))


@pytest.mark.parametrize(
    ("scores", "assumed", "best"),
    [
        ((0.9, 0.7, 0.1, 0.2, 0.3, 0.4, 0.5), ["", "emrhgd", "e", "r", "h", "g", "d"], 0),
        ((0.9, 0.8), ["", "emrhgd"], 1),
        ((0.9, 0.2, 0.7, 0.8, 1.0, 0.7, 0.9), ["", "emrhgd", "e", "r", "rh", "rhg", "rhd"], 6),
        ((0.9, 0.2, 0.9, 0.8, 0.6, 0.9, 0.9, 0.9), ["", "emrhgd", "e", "em", "emr", "emh", "emhg", "emhgd"], 7),
    ],
)
def test_the_rule_keeps_what_the_demo_scene_bears(
    scores: tuple[float, ...], assumed: list[str], best: int, tmp_path: Path
) -> None:
    """Tries all together, or one after the other. The policy is that of the last kept trial."""
    chosen = {"relational.assumptions": ",".join(LETTERS.values())}
    learner = Judged(load_settings("relational", "MoveToRegion", **SMALL, **chosen))
    learner.given, weights = scores, []
    while not learner.finished:
        learner.update()
        weights.append(learner.get_state()["best"]["networks.0.share.weight"])
    learner.write_report(tmp_path)
    report = json.loads((tmp_path / REPORT).read_text())
    assert [trial["assumed"] for trial in report] == [[LETTERS[letter] for letter in names] for names in assumed]
    assert [trial["score"] for trial in report] == list(scores)
    assert learner.updates == len(scores)
    last = max(number for number, trial in enumerate(report) if trial["kept"])
    assert last == best
    torch.testing.assert_close(learner.get_state()["actor"]["networks.0.share.weight"], weights[best])


def test_some_samples_keep_everything_in_its_place() -> None:
    learner = Judged(load_settings("relational", "FixColour", **SMALL, **{"relational.assumptions": "displace"}))
    learner.given = (0.9, 0.9)
    while not learner.finished:
        learner.update()

    def positions(changed: bool) -> torch.Tensor:
        blocks = blocks_of(learner.samples(2000, changed=changed)[0])
        return blocks[..., :3].flatten(1)

    shown, samples = positions(False).unique(dim=0), positions(True)
    in_place = (samples[:, None] == shown).all(2).any(1).float().mean()
    assert 0.45 <= in_place <= 0.57


def test_a_training_keeps_all_that_may_cost_everything(tmp_path: Path) -> None:
    settings = load_settings("relational", "MoveToRegion", **SMALL, **{"relational.loss": 1.0})
    train(settings, tmp_path)
    trials = json.loads((tmp_path / REPORT).read_text())
    every = list(settings.relational.assumptions)
    assert [trial["assumed"] for trial in trials] == [[], every]
    assert RunFolder(tmp_path, settings, resume=True).last_checkpoint().update == 2
    frame = evaluate(tmp_path, tasks="MoveToRegion", variants="Demo", preset="State", episodes=2, jobs=1)
    assert len(frame) == 2
    assert load_policy(tmp_path).preset == "State"


def test_it_learns_the_demonstrations() -> None:
    settings = load_settings("relational", "MoveToRegion", **{**SMALL, "relational.trial": 12, "relational.hidden": 32})
    learner = Relational(settings)
    metrics = [learner.update() for _ in range(12)]
    assert metrics[-1]["accuracy"] > 0.5 > metrics[0]["accuracy"]
    assert metrics[-1]["loss"] < 0.7 * metrics[0]["loss"]


@pytest.mark.parametrize(
    ("tasks", "changes", "error", "message"),
    [
        ("MoveToRegion,FixColour", {"preset": "State"}, SettingsError, "one task"),
        ("MoveToRegion", {}, SettingsError, "preset State"),
        ("MoveToRegion", {"preset": "State", "relational.assumptions": "mirrors"}, UnknownNameError, "mirror"),
        ("MoveToRegion", {"preset": "State", "relational.assumptions": "mirror"}, SettingsError, "egocentric before"),
    ],
)
def test_mistakes_are_explained(tasks: str, changes: dict, error: type[Exception], message: str, tmp_path) -> None:  # noqa: ANN001
    with pytest.raises(error, match=message):
        train(load_settings("relational", tasks, **changes), tmp_path / "run")


ENTRY, TABLE = "../../results/state-relational", ("Demo", "Layout", "All")
PICTURES: dict[str, Any] = {**TINY, **RELATIONAL, "network.channels": 8, "bc.batches": 3, "bc.batch_size": 8}


def drawn(states: torch.Tensor, view: str = "ego") -> np.ndarray:
    pictures = np.empty((len(states), 96, 96, 3), np.uint8)
    Redrawer(view, "software").draw(states, pictures)
    return pictures


@pytest.mark.parametrize("task", TASKS)
def test_pictures_are_redrawn_from_states(task: str) -> None:
    demonstration = demos.load(task)[0]
    states = np.asarray(demos.transitions([demonstration], preset="State")[0])
    seen = np.asarray(demos.transitions([demonstration], preset="LoRes4E", renderer="software")[0])
    steps = np.linspace(0, len(states) - 1, 5).astype(int)
    again = drawn(torch.from_numpy(states[steps]))
    assert (again != seen[steps][..., 9:]).mean() < 1e-3  # states are rounded to single precision


def test_absent_blocks_and_regions_are_not_drawn() -> None:
    scene = demos.load("FixColour")[0].scene
    states = torch.from_numpy(Engine.of_scene(scene).state_vector()[None].copy())
    blocks_of(states)[0, 1, 0] = regions_of(states)[0, 0, 0] = 0
    less = replace(scene, blocks=(scene.blocks[0], *scene.blocks[2:]), regions=scene.regions[1:])
    expected = Engine.of_scene(less, renderer="software").render("allo", 96)
    assert (drawn(states, "allo")[0] != expected).mean() < 1e-3


def test_a_policy_is_trained_kept_and_evaluated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redraw, "POOL", 16)
    train(load_settings("redraw", "MoveToRegion", quick=True, **PICTURES), tmp_path / "run")
    assert (tmp_path / "run" / REPORT).is_file()
    played = evaluate(str(tmp_path / "run"), tasks="MoveToRegion", variants="Demo", episodes=1, renderer="software")
    assert played["failure"].isna().all()


@pytest.mark.parametrize("wrong", [{"preset": "State"}, {"preset": "LoRes3EA"}, {"tasks": "MoveToRegion,FixColour"}])
def test_it_learns_one_task_from_one_view(wrong: dict[str, str]) -> None:
    with pytest.raises(SettingsError, match="one task from one view"):
        Redraw(load_settings("redraw", **{"tasks": "FixColour", **PICTURES, **wrong}))


TRAININGS = [
    ("relational", {"preset": "State", "relational.assumptions": "egocentric,mirror", "relational.trial": 2}),
    ("redraw", {"relational.assumptions": "egocentric"}),
]


@pytest.fixture
def small_pools(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(redraw, "POOL", 16)
    monkeypatch.setattr(redraw, "BATCHES", 2)


@pytest.mark.usefixtures("small_pools")
@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_resumed_training_ends_like_an_uninterrupted_one(
    method: str, changes: dict[str, Any], tmp_path: Path
) -> None:
    check_resumes(method, {**RELATIONAL, **changes}, tmp_path)


@pytest.mark.usefixtures("small_pools")
@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_ones_own_demonstrations_are_learnt_from(method: str, changes: dict[str, Any], tmp_path: Path) -> None:
    check_own_demonstrations(method, {**RELATIONAL, **changes}, tmp_path)


@pytest.mark.usefixtures("small_pools")
@pytest.mark.parametrize(("method", "changes"), TRAININGS)
def test_a_trainings_files_have_the_values_of_its_learner(method: str, changes: dict[str, Any], tmp_path: Path) -> None:
    check_readers(method, {**RELATIONAL, **changes}, tmp_path)


def test_the_table_of_scores_is_that_of_the_entry() -> None:
    folder = Path(__file__).parents[1]
    entry = [json.loads(lzma.decompress(file.read_bytes())) for file in sorted((folder / ENTRY).glob("?.json.xz"))]
    runs = [run["episodes"]["score"] for run in entry]
    text = (folder / "README.md").read_text()
    assert len(runs) == 5
    for task in TASKS:
        names = [f"{task}-{variant}" for variant in TABLE]
        means = [f"{np.mean([run[name] for run in runs]):.2f}" if name in runs[0] else "" for name in names]
        assert f"| {task} | {' | '.join(means)} |\n" in text


@pytest.mark.weekly
@EXPORTS
def test_the_onnx_file_computes_what_the_networks_compute(tmp_path: Path) -> None:
    train(load_settings("relational", "MoveToRegion", **SMALL), tmp_path / "run")
    file = export_policy(tmp_path / "run", tmp_path / "policy.onnx")
    states = histories(states_of("MoveToRegion", 20)[0].numpy())
    compare_exported(load_policy(tmp_path / "run").actor, file, states)


def test_policies_of_versions_with_other_settings_of_training_load(tmp_path: Path) -> None:
    settings = RelationalSettings(hidden=8, networks=3, sharpness=1.5)
    kept = {"hidden": 8, "networks": 3, "sharpness": 1.5, "patience": 6}
    contents = {"weights": Ensemble(settings).state_dict(), "relational": kept, "tasks": ["FindDupe"]}
    checkpoint.write(tmp_path / POLICY, contents)
    assert load_policy(tmp_path).actor.settings == settings
