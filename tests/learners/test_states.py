"""The state track: what a robot sees of its states, and trainings on them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

import magical_mj
from magical_mj import demos
from magical_mj.demos.recording import demonstrate
from magical_mj.leaderboard import submit
from magical_mj.learners import load_policy, load_settings, train
from magical_mj.learners.augmentation import (
    PAST_NOISE,
    STATE_NOISE,
    STATE_ROTATION,
    STATE_TRANSLATION,
    StateAugmentation,
)
from magical_mj.learners.bc import clone
from magical_mj.learners.gail import GAIL
from magical_mj.learners.networks import StateTorso, features_of
from magical_mj.learners.settings import NetworkSettings
from magical_mj.observations import MAX_BLOCKS, STATE_NAMES
from magical_mj.policies.interface import HISTORY, History, histories
from magical_mj.scene.constants import COLOURS, SHAPES
from magical_mj.utils.errors import DemonstrationError, SettingsError, TrainingError
from tests.helpers.agents import Alone
from tests.helpers.learners import playing, tiny

NAMES = len(STATE_NAMES)


def history(**values: float) -> torch.Tensor:
    """One history (1, HISTORY, names) in which nothing moves; names as `block0_x` for "block0.x"."""
    state = np.zeros(NAMES, np.float32)
    for name, value in values.items():
        state[STATE_NAMES.index(name.replace("_", ".", 1))] = value
    return torch.as_tensor(np.repeat(state[None, None], HISTORY, axis=1))


def played() -> NDArray[np.float32]:
    """Histories of a demonstration among nine blocks."""
    return histories(np.asarray(demos.observations(demos.load("ClusterColour")[0], "State")))[::20]


def test_scenes_may_hold_nothing_but_the_robot() -> None:
    history = torch.zeros(2, HISTORY, len(STATE_NAMES))
    assert StateTorso(NetworkSettings())(history).isfinite().all()


def test_histories_begin_with_the_first_state() -> None:
    states = np.arange(6, dtype=np.float32)[:, None]
    expected = [[0, 0, 0, 0], [0, 0, 0, 1], [0, 0, 1, 2], [0, 1, 2, 3], [1, 2, 3, 4], [2, 3, 4, 5]]
    np.testing.assert_array_equal(histories(states)[..., 0], expected)
    kept = History(states[:1])
    for step, state in enumerate(states):
        np.testing.assert_array_equal(kept.add(state[None])[0, :, 0], expected[step])


@pytest.mark.parametrize(("angle", "x", "y"), [(0.0, 0.1, 0.7), (math.pi / 2, -0.5, 0.2), (math.pi, 0.1, -0.3)])
def test_positions_are_in_the_robots_frame(angle: float, x: float, y: float) -> None:
    """Angle 0 faces +y, and angles run counter-clockwise."""
    seen = history(
        robot_x=0.1 if x == 0.1 else 0.0, robot_y=0.2, robot_angle=angle, block4_present=1, block4_x=x, block4_y=y
    )
    _, rows, present = features_of(seen)
    assert present.tolist() == [[True]]
    torch.testing.assert_close(rows[0, 0, :2], torch.tensor([0.0, 0.5]), atol=1e-6, rtol=0)


def test_regions_are_seen_by_their_middle_and_size() -> None:
    region = {
        "region1_present": 1,
        "region1_x_min": -0.2,
        "region1_x_max": 0.4,
        "region1_y_min": 0.5,
        "region1_y_max": 0.7,
    }
    _, rows, _ = features_of(history(**region, region1_blue=1))
    torch.testing.assert_close(rows[0, 0, :2], torch.tensor([0.1, 0.6]))
    torch.testing.assert_close(rows[0, 0, -3:], torch.tensor([0.3, 0.1, 1.0]))


def test_movements_are_the_robots_own() -> None:
    """It faces -x and has come from a tenth further right: a step ahead."""
    seen = history(robot_angle=math.pi / 2)
    seen[0, :-1, 0] = 0.1
    robot, _, _ = features_of(seen)
    torch.testing.assert_close(robot[0, 6:8], torch.tensor([0.0, 1.0]), atol=1e-6, rtol=0)


def test_the_order_of_blocks_changes_nothing() -> None:
    torso = StateTorso(NetworkSettings()).eval()
    seen = torch.as_tensor(played())
    first = [index for index, name in enumerate(STATE_NAMES) if name.startswith("block0.")]
    blocks = torch.arange(first[0], first[0] + MAX_BLOCKS * len(first)).reshape(MAX_BLOCKS, -1)
    shuffled = seen.clone()
    shuffled[..., blocks.flatten()] = seen[..., blocks[[3, 9, 0, 7, 1, 8, 2, 6, 5, 4]].flatten()]
    # sums in another order: rounding is 2e-7 here, another place of a single block changes 2e-4 or more
    torch.testing.assert_close(torso(shuffled), torso(seen), atol=1e-4, rtol=0)


def test_rows_of_other_samples_change_nothing() -> None:
    """A scene with fewer blocks gives the same in a batch with others that have more."""
    torso = StateTorso(NetworkSettings()).eval()
    few = histories(np.asarray(demos.observations(demos.load("MoveToCorner")[0], "State")))[:2]
    many = played()[:2]
    together = torso(torch.as_tensor(np.concatenate([few, many])))[:2]
    # rounding depends on the batch's size; without the mask, the difference is 1e-2
    torch.testing.assert_close(together, torso(torch.as_tensor(few)), atol=1e-4, rtol=0)


def test_every_scene_of_every_environment_can_be_seen() -> None:
    for task, variant in magical_mj.ENVIRONMENTS:
        scene = magical_mj.sample_scene(task, variant, 0)
        poses = np.array([[body.x, body.y, body.angle] for body in (scene.robot, *scene.blocks)])
        state = magical_mj.observations.StateEncoder(scene)(poses, poses * 0, np.array(scene.robot.fingers))
        robot, rows, present = features_of(torch.as_tensor(histories(state[None])))
        assert present.sum() == rows.shape[1] == len(scene.blocks) + len(scene.regions)
        assert rows[0, : len(scene.blocks), 6 : 6 + len(SHAPES) + len(COLOURS)].sum() == 2 * len(scene.blocks)
        assert rows.abs().max() < 4
        assert robot.abs().max() < 4


def test_augmentations_move_the_robot_and_shake_what_is_there() -> None:
    seen = torch.as_tensor(np.repeat(played()[3:4], 2000, axis=0))
    generator = torch.Generator().manual_seed(0)
    shift = StateAugmentation("all")(seen, generator) - seen
    bounds = torch.tensor([STATE_TRANSLATION, STATE_TRANSLATION, math.radians(STATE_ROTATION)])
    torch.testing.assert_close(shift[:, -1, :3].std(0), (bounds**2 / 3 + STATE_NOISE**2).sqrt(), rtol=0.1, atol=0)
    block = shift[..., STATE_NAMES.index("block2.x")]
    assert block[:, -1].std() == pytest.approx(STATE_NOISE, rel=0.1)
    assert block[:, :-1].std() == pytest.approx(PAST_NOISE, rel=0.1)
    fixed = [n for n, name in enumerate(STATE_NAMES) if name.endswith(("present", "velocity", "red", "star", "_min"))]
    assert not shift[..., fixed].any()
    absent = [n for n, name in enumerate(STATE_NAMES) if name.startswith("block9.")]
    assert not shift[..., absent].any()
    assert StateAugmentation("none")(seen, generator) is seen
    still = StateAugmentation("no-trans-rot")(seen, generator) - seen
    assert still[:, -1, :3].std() == pytest.approx(STATE_NOISE, rel=0.1)


def test_a_policy_is_trained_kept_and_evaluated(tmp_path: Path) -> None:
    settings = load_settings("bc", "MoveToRegion", preset="State", device="cpu", **{"bc.batches": 60, "evaluations": 0})
    trained = train(settings, tmp_path / "run")
    played = {"tasks": "MoveToRegion", "variants": "Demo", "preset": "State", "episodes": 6, "jobs": 1}
    scores = [
        magical_mj.evaluate(policy, **played)["score"]
        for policy in (trained, Alone(load_policy(tmp_path / "run")), str(tmp_path / "run"))
    ]
    assert scores[0].tolist() == scores[1].tolist() == scores[2].tolist()
    with pytest.raises(SettingsError, match="preset State"):
        magical_mj.evaluate(trained, tasks="MoveToRegion", variants="Demo", preset="LoRes4E", episodes=1)
    with pytest.raises(SettingsError, match="cannot act in MakeLine: give --tasks MoveToRegion"):
        magical_mj.evaluate(trained, tasks="MakeLine", preset="State", episodes=1)


def test_demonstrations_at_hand_are_those_of_the_package() -> None:
    """As they are, and as the states and actions of their episodes."""
    settings = tiny(preset="State", **{"bc.batches": 3})
    shipped = demos.load("MoveToRegion")
    transitions = [demos.transitions([demonstration], "State", drop_noop=False) for demonstration in shipped]
    policies = [clone(settings, given) for given in (None, {"MoveToRegion": shipped}, {"MoveToRegion": transitions})]
    weights = [torch.cat([w.flatten() for w in policy.actor.parameters()]) for policy in policies]
    assert torch.equal(weights[0], weights[1])
    assert torch.equal(weights[0], weights[2])


def test_all_demonstrations_at_hand_are_learnt_from_and_the_policy_is_saved(tmp_path: Path) -> None:
    """Unless the settings say how many; the saved policy acts as the returned one."""
    settings = load_settings("bc", "MoveToRegion", preset="State", **{"bc.batches": 3})
    given = demos.load("MoveToRegion")[:4]
    every, four = (
        clone(replace(settings, demonstrations=count), {"MoveToRegion": given}, out).actor.state_dict()
        for count, out in ((None, tmp_path / "every"), (4, None))
    )
    assert all(torch.equal(every[name], four[name]) for name in every)
    saved = load_policy(tmp_path / "every").actor.state_dict()
    assert all(torch.equal(every[name], saved[name]) for name in every)
    with pytest.raises(TrainingError, match="already contains a training"):
        clone(settings, {"MoveToRegion": given}, tmp_path / "every")
    with pytest.raises(DemonstrationError, match="no demonstrations of MoveToRegion are given"):
        clone(settings, {"MoveToRegion": []})


EPISODE = demos.transitions(demos.load("MoveToRegion")[:1], "State", drop_noop=False)
STEPS = len(EPISODE.actions)


@pytest.mark.parametrize(
    ("given", "problem"),
    [
        ({"FixColour": [EPISODE]}, "give a list of demonstrations for each task, as .*MoveToRegion"),
        ({"MoveToRegion": EPISODE}, "give a list of demonstrations"),
        (
            {"MoveToRegion": demos.load("FindDupe")[:2]},
            "a demonstration given for MoveToRegion is of FindDupe",
        ),
        ({"MoveToRegion": [EPISODE]}, "demonstrations is 2, but there are 1"),
        ({"MoveToRegion": [EPISODE._replace(actions=EPISODE.actions[1:])] * 2}, "the observation before each action"),
        (
            {"MoveToRegion": [EPISODE._replace(observations=np.zeros((STEPS, 4, 7)))] * 2},
            "needs the observation before",
        ),
        (
            {"MoveToRegion": [EPISODE._replace(observations=np.full_like(EPISODE.observations, np.nan))] * 2},
            "states must be finite floats",
        ),
        ({"MoveToRegion": [EPISODE._replace(actions=EPISODE.actions + 18)] * 2}, "integers from 0 to 17"),
        ({"MoveToRegion": [EPISODE._replace(actions=EPISODE.actions * 1.0)] * 2}, "integers from 0 to 17"),
        ({"MoveToRegion": [EPISODE._replace(actions=EPISODE.actions * 0)] * 2}, "no actions except no-ops"),
        (
            {"MoveToRegion": [demos.Transitions(EPISODE.observations[:0], EPISODE.actions[:0])] * 2},
            "no actions except no-ops",
        ),
    ],
)
def test_demonstrations_that_do_not_fit_are_explained(given: Any, problem: str) -> None:
    with pytest.raises(DemonstrationError, match=problem):
        clone(tiny(preset="State", demonstrations=2), given)


def test_cloning_records_the_variants_of_given_demonstrations(tmp_path: Path) -> None:
    """An entry must declare them."""
    given = [demonstrate("MoveToRegion", variant, 10_000_000) for variant in ("Demo", "Jitter", "All")]
    policy = clone(tiny(preset="State"), {"MoveToRegion": given}, out=tmp_path / "run")
    assert policy.learnt.played_in == load_policy(tmp_path / "run").learnt.played_in == "Demo,Jitter,All"
    magical_mj.evaluate(
        {"BC": policy}, tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1, out=tmp_path / "scores"
    )
    with pytest.raises(SettingsError, match='BC learnt in scenes of All, Jitter: add "other scenes"'):
        submit([tmp_path / "scores"], tmp_path / "entry.json.xz")


def test_pictures_of_another_type_are_refused() -> None:
    """Values in [0, 1] would be divided by 255, and the policy would learn nothing."""
    pictures = demos.transitions(demos.load("MoveToRegion")[:1], drop_noop=False, renderer="software")
    for other in ((pictures.observations / 255).astype(np.float32), pictures.observations.astype(np.int8)):
        with pytest.raises(DemonstrationError, match=rf"pictures must be uint8.* MoveToRegion has {other.dtype}"):
            clone(tiny(demonstrations=1), {"MoveToRegion": [pictures._replace(observations=other)]})


def test_the_average_of_the_policies_is_what_plays_and_is_saved(tmp_path: Path) -> None:
    """With 0.75, after policies a, b and c: 0.75 (0.75 a + 0.25 b) + 0.25 c; the policy in training is left alone."""
    learner = GAIL(playing(preset="State", **{"ppo.averaging": 0.75}))
    plain = GAIL(playing(preset="State", **{"ppo.averaging": 0}))
    kept = []
    for _ in range(3):
        learner.update()
        plain.update()
        kept.append([weights.detach().clone() for weights in plain.actor.parameters()])
    expected = [0.75 * (0.75 * a + 0.25 * b) + 0.25 * c for a, b, c in zip(*kept, strict=True)]
    assert not torch.equal(kept[0][0], kept[2][0])
    learner.save_policy(tmp_path)
    for policy in (learner.policy(), load_policy(tmp_path)):
        for weights, wanted in zip(policy.actor.parameters(), expected, strict=True):
            torch.testing.assert_close(weights, wanted)
    learner.close()
    plain.close()


def test_training_from_states_uses_one_thread(tmp_path: Path) -> None:
    """More would wait for each other on busy cores, and round differently."""
    before, numbers = torch.get_num_threads(), set[int]()
    torch.set_num_threads(2)
    try:
        settings = load_settings("bc", "MoveToRegion", preset="State", **{"bc.batches": 3, "evaluations": 0})
        train(settings, tmp_path / "run", watch=lambda _: numbers.add(torch.get_num_threads()))
        assert (numbers, torch.get_num_threads()) == ({1}, 2)
    finally:
        torch.set_num_threads(before)
