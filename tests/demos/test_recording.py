"""Recording demonstrations: from people and from experts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.scene.actions import ACTIONS
from magical_mj.utils.errors import DemonstrationError, InvalidSeedError


def test_actions_may_be_recorded_as_triples() -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    env.reset()
    recorder = demos.Recorder(env)
    for action in (ACTIONS[0], ACTIONS[10], 3):
        recorder.step(action)
    assert recorder.demonstration("human").actions.tolist() == [0, 10, 3]


def test_an_episode_is_recorded_from_its_start_to_its_end() -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    env.reset()
    recorder = demos.Recorder(env)
    for _ in range(env.horizon or 0):
        recorder.step(0)
    with pytest.raises(DemonstrationError, match="the episode is over"):
        recorder.step(0)
    demo = recorder.demonstration("expert", np.int64(3))  # pyright: ignore[reportArgumentType]
    assert len(demo.actions) == env.horizon
    assert (demo.scene_seed, demo.seed) == (0, 3)
    assert type(demo.seed) is int
    env.reset()
    env.step(1)
    with pytest.raises(DemonstrationError, match="the episode began 1 steps ago"):
        demos.Recorder(env)


def test_what_a_recorder_did_not_see_is_no_demonstration() -> None:
    """Not episodes that were stepped or begun anew without it, and not those that began in a scene of no seed."""
    env = magical_mj.Engine("ClusterShape", "Layout", seed=5, rules="released")
    env.reset()
    recorder = demos.Recorder(env)
    recorder.step(0)
    demo = recorder.demonstration("human")
    assert (demo.task, demo.variant, demo.scene_seed, demo.seed) == ("ClusterShape", "Layout", 5, 5)
    assert demo.score == demo.rescored()  # by the paper's rules, whatever those of the environment are
    for elsewhere in (lambda: env.step(1), env.reset):
        elsewhere()
        for use in (lambda: recorder.step(1), lambda: recorder.demonstration("human")):
            with pytest.raises(DemonstrationError, match="reset or stepped without the recorder"):
                use()
    env.reset(scene=demo.scene)
    with pytest.raises(DemonstrationError, match="seed"):
        demos.Recorder(env).demonstration("human")


def test_numbers_of_numpy_are_seeds_too(tmp_path: Path) -> None:
    demo = demos.demonstrate("MoveToRegion", "Demo", np.int64(3))  # pyright: ignore[reportArgumentType]
    demos.write(demo, tmp_path / "a.npz")
    assert demos.read(tmp_path / "a.npz").scene_seed == 3
    with pytest.raises(InvalidSeedError, match="is not a seed"):
        demos.demonstrate("MoveToRegion", "Demo", -1)


def test_what_no_expert_reaches_is_no_demonstration() -> None:
    with pytest.raises(DemonstrationError, match=r"10 experts tried MoveToRegion-Demo .*; the best reached 1\.00"):
        demos.demonstrate("MoveToRegion", "Demo", 0, least_score=1.5)
