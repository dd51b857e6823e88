"""Batched worlds on Warp's CPU device, beside the environments that they stand for; one process compiles kernels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import mujoco_warp
import numpy as np
import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import magical_mj
from magical_mj import batched
from magical_mj.batched import physics as physics_module
from magical_mj.batched.environment import Arrays
from magical_mj.batched.physics import Physics
from magical_mj.batched.scenes import BatchScenes, Sampler, capacity_for
from magical_mj.batched.tables import constant_states, episode_tables
from magical_mj.envs.presets import PRESETS
from magical_mj.scene import Scene
from magical_mj.utils.errors import (
    ClosedError,
    InvalidActionError,
    InvalidSeedError,
    SettingsError,
    StateError,
    UnknownNameError,
)

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]

MIXED = [("MoveToRegion", "Demo"), ("FixColour", "All"), ("ClusterShape", "CountPlus"), ("FindDupe", "Dynamics")]


def arrays(scenes: list[Scene]) -> BatchScenes:
    return BatchScenes.of(scenes, *capacity_for(scenes))


def table(scene: Scene) -> NDArray[np.float64]:
    return np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])


def distances(physics: Physics, envs: list[magical_mj.Engine]) -> list[float]:
    """How far the worst thing of each world is from where it should be, world units."""
    wanted = [table(env.scene) for env in envs]
    return [
        float(np.abs(poses[: len(rows), :2].numpy() - rows[:, :2]).max())
        for poses, rows in zip(physics.poses, wanted, strict=True)
    ]


def running(scenes: list[Scene]) -> list[magical_mj.Engine]:
    envs = [magical_mj.Engine.of_scene(scene) for scene in scenes]
    for env in envs:
        env.reset()
    return envs


def test_one_action_in_every_environment() -> None:
    """Scenes of all counts, shapes and dynamics side by side in one model."""
    scenes = [magical_mj.sample_scene(*pair, 0) for pair in magical_mj.ENVIRONMENTS]
    physics, envs = Physics(arrays(scenes)), running(scenes)
    actions = np.random.default_rng(0).integers(18, size=len(scenes))
    physics.step(torch.from_numpy(actions))
    for env, action in zip(envs, actions, strict=True):
        env.step(int(action))
    assert max(distances(physics, envs)) < 1e-5
    assert not physics.overflowed.any()


def test_ten_actions_and_what_is_alone_moves_alike() -> None:
    scenes = [magical_mj.sample_scene(*pair, 2) for pair in MIXED]
    physics, envs = Physics(arrays(scenes)), running(scenes)
    alone = Physics(BatchScenes.of(scenes[1:2], *capacity_for(scenes)))
    for step in range(10):
        actions = torch.tensor([1, 10, 13, 4] if step < 6 else [3, 10, 1, 16])
        physics.step(actions)
        alone.step(actions[1:2])
        for env, action in zip(envs, actions.tolist(), strict=True):
            env.step(action)
    assert np.median(distances(physics, envs)) < 1e-4
    # contacts enlarge rounding errors, which depend on the batch's size and on the processor
    torch.testing.assert_close(alone.poses[0], physics.poses[1], atol=1e-4, rtol=0.0)


def test_overflows_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(physics_module, "ROWS", 8)
    scene = magical_mj.sample_scene("MoveToCorner", "Demo", 0)
    physics = Physics(arrays([scene]))
    physics.step(torch.tensor([1]))
    assert physics.overflowed.tolist() == [True]
    physics.reset(arrays([scene]), torch.tensor([0]))
    assert physics.overflowed.tolist() == [False]


def test_environments_have_the_tasks_in_the_given_order() -> None:
    """Each starts in the scene of its task, so that a head for each task is trained on that task."""
    worlds = batched.make("FindDupe,MatchRegions,FindDupe", "Shape,Demo", 7, device="cpu", preset="State")
    pairs = [(task, variant) for task in ("FindDupe", "MatchRegions", "FindDupe") for variant in ("Shape", "Demo")]
    assert list(zip(worlds.tasks, worlds.variants, strict=True)) == [*pairs, pairs[0]]
    states, _ = worlds.reset(seed=5)
    for number, (task, variant) in enumerate([*pairs, pairs[0]]):
        wanted = magical_mj.Engine(task, variant, seed=5 + number).state_vector()
        np.testing.assert_allclose(states[number].numpy(), wanted, atol=1e-4)  # of float32; scenes differ by 1e-2
    worlds.close()


def test_episodes_with_overflows_are_warned_of(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(physics_module, "ROWS", 8)
    worlds = batched.make("MoveToCorner", "Demo", 1, device="cpu", preset="State")
    worlds.reset()
    worlds.steps[0] = 79  # nearly over
    with pytest.warns(UserWarning, match="more contacts than the allocated maximum"):
        _, _, _, ended, info = worlds.step([1])
    assert ended.tolist() == info["final_info"]["overflowed"].tolist() == [True]
    worlds.close()


@pytest.fixture(scope="module")
def env() -> Iterator[Any]:
    worlds = batched.make("MoveToRegion,FixColour", "Demo", 3, device="cpu", reward="score", preset="LoResCHW4E")
    yield worlds
    worlds.close()


def test_episodes_are_those_of_the_single_environments(env: Any) -> None:
    """Two tasks whose horizons differ, resets included; the demonstrations, played open loop, score 1."""
    demos = [magical_mj.demos.load(task)[0] for task in ("MoveToRegion", "FixColour", "MoveToRegion")]
    single = gymnasium.make(magical_mj.env_id("MoveToRegion", "Demo", "LoResCHW4E"))
    observations, info = env.reset(seed=0)
    wanted, _ = single.reset(seed=0)
    assert observations.shape == env.observation_space.shape == (3, 12, 96, 96)
    assert not info["eval_score"].any()
    ends = []
    for step in range(60):
        assert np.abs(observations[0].numpy().astype(float) - wanted).mean() < 0.05
        actions = [int(demo.actions[step % len(demo.actions)]) for demo in demos]
        observations, rewards, terminated, truncated, info = env.step(actions)
        assert not terminated.any()
        assert not info["eval_score"].any()  # that of an episode that has begun
        if truncated.any():
            final = info["final_info"]
            assert torch.equal(rewards.double(), final["eval_score"])
            assert torch.equal(info["_final_info"], truncated)
            ends.append((step + 1, truncated.tolist(), final["eval_score"].tolist()))
            assert final["is_success"].tolist() == [score == 1.0 for score in ends[-1][2]]
        else:
            assert not rewards.any()
        if step < 40:
            wanted, *_ = single.step(actions[0])
        if step == 39:
            assert np.abs(info["final_obs"][0].numpy().astype(float) - wanted).mean() < 0.05
            wanted, _ = single.reset(seed=0)  # the demo variant always starts alike
        elif step > 39:
            wanted, *_ = single.step(actions[0])
    assert ends == [(40, [True, False, True], [1.0, 0.0, 1.0]), (60, [False, True, False], [0.0, 1.0, 0.0])]
    single.close()


@pytest.mark.parametrize("preset", list(PRESETS)[::2])  # of each kind of observation
def test_observations_stay_alike_while_other_worlds_begin_anew(preset: str) -> None:
    worlds = batched.make("FixColour", "Demo", 2, device="cpu", preset=preset)
    single = gymnasium.make(magical_mj.env_id("FixColour", "Demo", preset))
    worlds.reset(seed=0)
    single.reset(seed=0)
    worlds.steps[1] = 58  # nearly over
    for step, action in enumerate((1, 13, 10)):
        observation, _, _, ended, _ = worlds.step([action, action])
        assert ended.tolist() == [False, step == 1]
        wanted = single.step(action)[0]
        parts = (
            [(observation[name], wanted[name]) for name in wanted]
            if isinstance(wanted, dict)
            else [(observation, wanted)]
        )
        for batch, picture in parts:
            assert batch[0].shape == picture.shape
            apart = np.abs(batch[0].numpy().astype(float) - picture)
            assert apart.max() < 1e-3 if picture.dtype == np.float32 else apart.mean() < 0.05
    worlds.close()
    single.close()


def test_shifts_are_those_of_the_episodes_seeds() -> None:
    """Also of the second episode, whose seed follows from the batch's, and of a state that is restored."""
    settings = {"device": "cpu", "image_size": 48, "shifts": "camera:5,palette:5"}
    worlds, other = (batched.make("MoveToRegion", "Jitter", 2, seed=seed, **settings) for seed in (0, 1))
    single = gymnasium.make(
        magical_mj.env_id("MoveToRegion", "Jitter", "LoRes4E"), image_size=48, shifts=settings["shifts"]
    )
    observation, _ = worlds.reset(seed=7)
    seeds = [[7, 8], worlds.sampler.next_seeds([0, 1])]
    for number in range(2):
        for picture, seed in zip(observation, seeds[number], strict=True):
            assert np.abs(picture.numpy().astype(float) - single.reset(seed=seed)[0]).mean() < 0.05
        before, (observation, _) = observation, worlds.reset()
        assert not torch.equal(before, observation)
    other.set_state(worlds.get_state())
    for action in (1, 4):
        assert torch.equal(worlds.step([action] * 2)[0], other.step([action] * 2)[0])
    for env in (worlds, other, single):
        env.close()


def test_other_rules_have_other_horizons_and_scores() -> None:
    """In ClusterShape's demo, doing nothing scores a quarter by the paper's rules, and nothing by the others."""
    for rules, steps, score in (("paper", 320, 0.25), ("released", 240, 0.0)):
        worlds = batched.make("ClusterShape", "Demo", 1, device="cpu", preset="State", rules=rules)
        worlds.reset(seed=0)
        worlds.steps[0] = steps - 2
        assert worlds.step([0])[3].tolist() == [False]
        *_, ended, info = worlds.step([0])
        assert ended.tolist() == [True]
        assert info["final_info"]["eval_score"].tolist() == [score]
        assert info["final_info"]["is_success"].tolist() == [False]
        worlds.close()


def test_a_state_that_is_not_finite_affects_no_other_environment(env: Any) -> None:
    env.reset(seed=0)
    env.physics.state["qvel"][1] = float("nan")
    _, _, _, truncated, info = env.step([1, 1, 1])
    assert info["final_info"]["broken"].tolist() == truncated.tolist() == [False, True, False]
    assert info["final_info"]["eval_score"][1] == 0.0
    assert not info["broken"].any()
    observations, *_, info = env.step(np.array([1, 2, 17], np.uint16))
    assert not info["broken"].any()
    assert env.physics.poses.isfinite().all()
    assert observations[1].float().std() > 1


def test_without_autoreset_worlds_wait_for_a_mask() -> None:
    worlds = batched.make(
        "MoveToRegion", "Layout", 2, device="cpu", preset="State", autoreset_mode=AutoresetMode.DISABLED
    )
    first, _ = worlds.reset(seed=3)
    worlds.steps[1] = 39  # an episode that is nearly over
    _, _, _, truncated, _ = worlds.step([1, 1])
    assert truncated.tolist() == [False, True]
    with pytest.raises(ResetNeeded):
        worlds.step([1, 1])
    after, _ = worlds.reset(seed=[9, 4], options={"reset_mask": truncated})
    torch.testing.assert_close(after[1], first[1])
    same, _ = worlds.reset(options={"reset_mask": [False, False]})
    assert torch.equal(same, after)
    assert not torch.equal(after[0], first[0])
    worlds.step([1, 1])
    assert torch.equal(worlds.reset(seed=np.int64(3))[0], first)
    with pytest.raises(SettingsError, match="reset_mask must hold 2 bools"):
        worlds.reset(options={"reset_mask": [True]})
    with pytest.raises(InvalidSeedError, match="is not a seed"):
        worlds.reset(seed=-1)
    with pytest.warns(UserWarning, match="reset ignores the options 'scene'"):
        worlds.reset(options={"scene": 3})
    worlds.close()


def test_a_seed_determines_the_later_episodes_too() -> None:
    worlds = batched.make("FindDupe", "All", 2, device="cpu", preset="State", seed=5)
    drawn = []
    for seed in (7, np.array(7)):
        worlds.reset(seed=seed)
        drawn.append([worlds.reset()[0] for _ in range(2)])
    assert not torch.equal(*drawn[0])
    assert all(map(torch.equal, *drawn))
    worlds.close()


def test_arrays_are_the_same_with_numpy() -> None:
    worlds = Arrays(batched.make("FindDupe", "All", 2, device="cpu", preset="State"))
    worlds.reset(seed=0)
    state = worlds.get_state()
    observation = worlds.step([1, 4])[0]
    assert isinstance(observation, np.ndarray)
    before = worlds.set_state(state)
    assert not np.array_equal(before, observation)
    np.testing.assert_array_equal(worlds.step([1, 4])[0], observation)
    assert (worlds.device, worlds.num_envs) == ("cpu", 2)
    worlds.close()


def test_writing_into_an_observation_changes_no_later_one() -> None:
    worlds, twin = (batched.make("FindDupe", "All", 2, device="cpu", image_size=16) for _ in range(2))
    observation, untouched = worlds.reset(seed=0)[0], twin.reset(seed=0)[0]
    for action in (1, 4):
        observation.zero_()
        observation, untouched = worlds.step([action] * 2)[0], twin.step([action] * 2)[0]
        assert torch.equal(observation, untouched)
    worlds.close()
    twin.close()


def test_the_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "batched.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    exec(compile(code, "batched.md", "exec"), {})
    printed = capsys.readouterr().out.splitlines()[-1]
    assert printed == f"{torch.zeros(4, dtype=torch.float64)} {torch.zeros(4, dtype=torch.bool)}"


def test_mujoco_warp_loads_exported_models_without_the_flag_that_it_does_not_know(tmp_path: Path) -> None:
    """As docs/exported-model.md says; the file keeps the flag, for without it states differ by rounding."""
    with closing(magical_mj.Engine("FindDupe", "All", seed=0)) as engine:
        model = mujoco.MjModel.from_xml_path(str(magical_mj.export_mjcf(engine, tmp_path / "a.xml")))
    with pytest.raises(NotImplementedError, match="mjDSBL_MIDPHASE"):
        mujoco_warp.put_model(model)
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_MIDPHASE)
    assert mujoco_warp.put_model(model).nv == model.nv


def test_wrong_actions_are_refused() -> None:
    env = batched.make("MoveToRegion", "Demo", 3, device=torch.device("cpu"), preset="State")  # type: ignore[arg-type]
    env.reset(seed=0)
    for actions in ([1, 2], [0, 1, 18], [0.5, 1.0, 2.0], [-1, 0, 0], None, "abc", [2**70, 0, 0]):
        with pytest.raises(InvalidActionError, match="3 integers"):
            env.step(actions)
    env.close()


def test_states_of_other_worlds_and_closed_environments_are_refused() -> None:
    worlds = batched.make("MoveToRegion", "Demo", 2, device="cpu", image_size=32)
    for wrong in (None, {}, {**worlds.get_state(), "kind": None}):
        with pytest.raises(StateError, match="get_state"):
            worlds.set_state(wrong)
    with pytest.raises(ResetNeeded, match="reset"):
        worlds.step([0, 0])
    worlds.reset(seed=0)
    for name, variant, count, changes in (
        ("environments", "Demo", 1, {}),
        ("environments", "Jitter", 2, {}),
        ("rules", "Demo", 2, {"rules": "released"}),
        ("preset", "Demo", 2, {"preset": "LoRes4A"}),
        ("image_size", "Demo", 2, {"image_size": 16}),
        ("shifts", "Demo", 2, {"shifts": "camera:2"}),
    ):
        other = batched.make("MoveToRegion", variant, count, device="cpu", **{"image_size": 32, **changes})
        other.reset(seed=0)
        other.step([1] * count)
        with pytest.raises(StateError, match=name):
            worlds.set_state(other.get_state())
        assert worlds.steps.tolist() == [0, 0], "nothing is changed"
        other.close()
    worlds.close()
    for use in (worlds.reset, worlds.get_state, lambda: worlds.step([0, 0]), lambda: worlds.set_state({})):
        with pytest.raises(ClosedError, match="closed"):
            use()


@pytest.mark.parametrize(
    ("settings", "word"),
    [
        ({"device": "cuda:7"}, "no device 'cuda:7'"),
        ({"num_envs": 0}, "at least 1"),
        ({"num_envs": True}, "num_envs"),
        ({"task": "all", "variant": "all"}, "num_envs=1 must be at least 60"),
        ({"workers": -1}, "workers"),
        (
            {"shifts": "latency:2"},
            "camera, light, texture, palette, sensor, not latency: use gymnasium",
        ),
        ({"shifts": "body:longstick"}, "not body"),
        ({"shifts": "camera:2", "preset": "State"}, "the preset has none"),
        ({"preset": "HiRes"}, "preset"),
        ({"autoreset_mode": AutoresetMode.NEXT_STEP}, "SAME_STEP"),
        ({"autoreset_mode": "SAME_STEP"}, "gymnasium.vector"),
    ],
)
def test_wrong_settings_are_named(settings: Any, word: str) -> None:
    with pytest.raises((SettingsError, UnknownNameError), match=word):
        batched.make(**{"task": "MoveToRegion", "num_envs": 1, "device": "cpu", **settings})


def test_scores_of_whole_episodes_are_refused_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "whole_episode.py").write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.move_to_region import SPEC as OURS\n"
        'SPEC = replace(OURS, name="Whole", trajectory=True, plan=None, score=lambda scenes, rules: 0.0)\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(SettingsError, match=r"the score of whole_episode:SPEC depends on them; use gymnasium\.make"):
        batched.make("whole_episode:SPEC,MoveToRegion", num_envs=2, device="cpu")


def test_scenes_do_not_depend_on_who_samples_them() -> None:
    """Those of an episode follow from the seed, the world and the episode, whoever ends when."""
    pairs, sampled = [("FindDupe", "All")] * 3, []
    prepare = partial(episode_tables, shifts={"palette": 2, "sensor": 3}, steps=3)
    for workers, order in ((0, [[0, 1, 2], [1], [0, 1, 2]]), (1, [[0, 1, 2], [1], [0, 1, 2]]), (0, [[1], [1], [0, 1]])):
        sampler = Sampler(pairs, (10, 3), prepare, workers)
        sampler.seed(7)
        sampled.append([sampler.episodes(worlds) for worlds in order])
        sampler.close()
    pairs_of_results = [*zip(sampled[0], sampled[1], strict=True), (sampled[2][1], sampled[0][1])]
    for (seeds, arrays), (same_seeds, same_arrays) in pairs_of_results:
        assert seeds == same_seeds
        assert arrays.keys() == same_arrays.keys()
        for name, values in arrays.items():
            np.testing.assert_equal(list(values), list(same_arrays[name]), name)
    np.testing.assert_array_equal(sampled[2][2][1]["poses"][0], sampled[0][0][1]["poses"][0])


def test_workers_sample_ahead_after_given_seeds_too() -> None:
    pairs = [("MoveToRegion", "All")] * 2
    here, ahead = (Sampler(pairs, (1, 1), partial(constant_states, start=False), n) for n in (0, 1))
    for sampler in (here, ahead):
        sampler.seed(3)
        sampler.episodes([0, 1], [8, 9])
    ((begun, _), (same, _)) = ahead._ahead.values()
    assert begun is same
    np.testing.assert_array_equal(begun.result(60)["poses"], here.episodes([0, 1])[1]["poses"])
    ahead.close()
