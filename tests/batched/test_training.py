"""Learners in batched environments on Warp's CPU device, where each step takes a tenth of a second per environment."""

from __future__ import annotations

import importlib.util
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

from magical_mj import MagicalEnv, batched
from magical_mj.cli.app import app
from magical_mj.learners import TrainingSettings, checkpoint, load_policy, train
from magical_mj.learners.run_folder import CHECKPOINT
from magical_mj.learners.vector_envs import BatchedEnvs, LocalEnvs
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.interface import HISTORY
from magical_mj.utils.errors import MissingExtraError, SettingsError, UnknownNameError
from tests.helpers.learners import playing

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]

TWO = "FixColour,MoveToRegion"
SMALL = {"ppo.environments": 2, "ppo.steps": 2, "ppo.minibatch": 4, "ppo.total_steps": 8, "features.samples": 8}
"""Two updates of 2 x 2 steps; worlds of two tasks have no head starts."""


def in_batch(method: str = "gail", tasks: str = TWO, **changes: Any) -> TrainingSettings:
    return playing(method, tasks, **{**SMALL, "ppo.simulator": "warp", **changes})


@pytest.fixture
def worlds(request: pytest.FixtureRequest) -> Iterator[BatchedEnvs]:
    envs = BatchedEnvs(in_batch(**getattr(request, "param", {})))
    yield envs
    envs.close()


def test_learners_see_what_they_see_in_single_worlds(worlds: BatchedEnvs) -> None:
    """Pictures, tasks, ends and what is said of them, beside the copies of the environments."""
    copies = LocalEnvs(playing(tasks=TWO, **SMALL))
    assert worlds.tasks.tolist() == copies.tasks.tolist() == [0, 1]
    observations, wanted = worlds.reset(), copies.reset()
    worlds.batch.steps[1] = 38  # an episode that is nearly over
    for step in range(2):
        assert observations.dtype == wanted.dtype
        assert np.abs(observations.astype(float) - wanted).mean() < 0.05
        observations, ended, last, scores, broken = worlds.step(np.array([1, 1]))
        wanted = copies.step(np.array([1, 1])).observations
        assert ended.tolist() == [False, step == 1]
    assert not broken.any()
    assert scores[1] == 0.0
    assert np.abs(last[1].astype(float) - wanted[1]).mean() < 0.05
    assert np.abs(observations[1].astype(float) - copies.reset()[1]).mean() < 0.05
    copies.close()


def test_nothing_is_expected_after_a_broken_state(worlds: BatchedEnvs) -> None:
    """Its episode is over, and not merely cut off: PPO adds no value of what would come next."""
    worlds.reset()
    worlds.batch.physics.state["qvel"][1] = float("nan")
    step = worlds.step(np.array([1, 1]))
    assert step.ended.tolist() == step.broken.tolist() == [False, True]


@pytest.mark.parametrize("worlds", [{"tasks": "MoveToRegion", "preset": "State"}], indirect=True)
def test_histories_of_states_begin_with_their_episode(worlds: BatchedEnvs) -> None:
    """Two worlds of one task: the second has a head start of half an episode."""
    single = MagicalEnv("MoveToRegion", "Demo", "State")
    first = np.tile(single.reset(seed=0)[0], (HISTORY, 1))
    before = worlds.reset()
    assert before.shape == (2, HISTORY, len(STATE_NAMES))
    assert worlds.batch.steps.tolist() == [0, 20]
    np.testing.assert_allclose(before[0], first, atol=1e-4)  # of float32; another step differs by 1e-2, see below
    assert np.abs(before[1, -1] - first[-1]).max() > 0.01
    worlds.batch.steps[1] = 39
    observations, ended, last, _, _ = worlds.step(np.array([1, 3]))
    assert ended.tolist() == [False, True]
    np.testing.assert_array_equal(observations[0, :-1], before[0, 1:])
    np.testing.assert_allclose(observations[1], first, atol=1e-4)
    np.testing.assert_array_equal(last[1, :-1], before[1, 1:])
    assert np.abs(last[1, -1] - first[-1]).max() > 0.01
    single.close()


class StoppedError(Exception):
    """What a test stops a training with."""


@pytest.mark.parametrize(("method", "preset"), [("wgail-gp", "LoRes4E"), ("al", "State")])
def test_a_resumed_training_ends_like_an_uninterrupted_one(method: str, preset: str, tmp_path: Path) -> None:
    settings = in_batch(method, preset=preset, **{"features.batches": 1})

    def stop(_: Any) -> None:
        if (tmp_path / "broken" / CHECKPOINT).exists():
            raise StoppedError

    whole = train(settings, tmp_path / "whole")
    with pytest.raises(StoppedError):
        train(settings, tmp_path / "broken", watch=stop)
    state = checkpoint.read(tmp_path / "broken" / CHECKPOINT)
    assert state["update"] == 1
    assert state["learner"]["ppo"]["environments"]["worlds"]["steps"].shape == (2,)
    resumed = train(settings, tmp_path / "broken", resume=True)
    for name, weights in whole.actor.state_dict().items():
        assert torch.equal(weights, resumed.actor.state_dict()[name]), name


def test_the_command_line_trains_in_batched_worlds(tmp_path: Path) -> None:
    out = tmp_path / "run"
    options = ["--multi-task", "--tasks", TWO, "--preset", "State", "--simulator", "warp", "--device", "cpu"]
    for name, value in {**SMALL, "ppo.total_steps": 4, "evaluations": 0}.items():
        if name.startswith("features."):  # of AL
            continue
        options += ["--set", f"{name}={value}"]
    result = CliRunner().invoke(app, ["train", "gail", *options, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert 'simulator = "warp"' in (out / "config.toml").read_text()
    assert load_policy(out).tasks == tuple(TWO.split(","))


def test_wrong_simulators_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingsError, match="bc cannot choose its simulator"):
        in_batch("bc")
    with pytest.raises(UnknownNameError, match=r"ppo\.simulator 'many'"):
        playing(**{"ppo.simulator": "many"})
    find = importlib.util.find_spec
    monkeypatch.setattr("magical_mj.utils.extras.find_spec", lambda name: None if name == "mujoco_warp" else find(name))
    with pytest.raises(MissingExtraError, match=r"batched environments need mujoco_warp: .*\[gpu\]"):
        train(in_batch(), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_state_is_gone_back_to_in_another_batch() -> None:
    """Pictures, ends, scores and the scenes of later episodes are the same to the bit."""
    first, second = (batched.make("FindDupe", "All", 2, device="cpu", seed=seed) for seed in (0, 1))
    first.reset()
    second.reset()
    observations = first.step([1, 3])[0]
    first.steps[1] = 98  # an episode that is nearly over
    assert torch.equal(second.set_state(first.get_state()), observations)
    for _ in range(3):
        ours, theirs = first.step([10, 4]), second.step([10, 4])
        assert torch.equal(ours[0], theirs[0])
        assert torch.equal(ours[3], theirs[3])
        assert torch.equal(ours[4]["eval_score"], theirs[4]["eval_score"])
    assert second.steps.tolist() == [4, 1]
    first.close()
    second.close()
