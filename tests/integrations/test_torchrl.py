"""TorchRL: its environments, and a policy that clones our demonstrations."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from tests.helpers.cloning import cloned, network
from tests.helpers.commands import code_block
from tests.helpers.libraries import EPISODES, compare, demonstrations

pytest.importorskip("torchrl", reason="torchrl is missing: make integrations-test LIBRARY=torchrl")

from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer, Unbounded
from torchrl.envs import GymEnv, check_env_specs, default_info_dict_reader
from torchrl.envs.libs.gym import GymWrapper

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_a_cloned_policy_scores_the_same_by_both_paths(record_property: Callable[[str, object], None]) -> None:
    data = demonstrations()
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(len(data["actions"])), batch_size=64)
    rows = {"observation": torch.from_numpy(data["observations"]), "action": torch.from_numpy(data["actions"]).long()}
    buffer.extend(TensorDict(rows, batch_size=len(data["actions"])))
    actor = network(data["observations"].shape[1])
    with torch.random.fork_rng():
        torch.manual_seed(0)
        samples = (buffer.sample() for _ in range(1500))
        act = cloned(((sample["observation"], sample["action"]) for sample in samples), actor)
    policy = TensorDictModule(lambda states: actor(states).argmax(-1), ["observation"], ["action"])

    def returns(env: Any) -> list[float]:
        wrapped = GymWrapper(env, categorical_action_encoding=True)
        return [float(wrapped.rollout(100, policy)["next", "reward"].sum()) for _ in range(EPISODES)]

    compare(record_property, "a network on a `ReplayBuffer`; scores by `rollout`", returns, act)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("FindDupe-TestAll-LoRes4E", {}),
        ("MoveToRegion-Demo-LoResFingers", {}),
        ("MoveToRegion-Demo-State", {"from_pixels": True, "pixels_only": False}),
        ("MoveToRegion-Demo-State", {"action": "continuous"}),
    ],
)
def test_torchrl_finds_nothing_wrong(name: str, options: dict[str, Any]) -> None:
    env = GymEnv(f"magical_mj/{name}-v0", **options)
    check_env_specs(env)
    assert ("pixels" in env.reset()) == ("from_pixels" in options)
    env.close()


def test_the_pages_code_runs(capsys: pytest.CaptureFixture[str]) -> None:
    page = (Path(__file__).parents[2] / "docs" / "integrations.md").read_text("utf-8")
    names: dict[str, Any] = {}
    exec(code_block(page, "python", "import magical_mj\nimport torch"), names)
    assert len(names["rollout"]) == 60
    assert capsys.readouterr().out.startswith("torch.Size([60, ")


def test_torchrl_seeds_are_ours_and_the_info_is_read() -> None:
    env = GymEnv("magical_mj/FixColour-Demo-State-v0")
    env.set_info_dict_reader(default_info_dict_reader(["eval_score"], [Unbounded((), dtype=torch.float64)]))
    env.set_seed(3)
    rollout = env.rollout(100)
    ours = magical_mj.MagicalEnv("FixColour", "Demo", "State")
    np.testing.assert_array_equal(rollout["observation"][0].numpy(), ours.reset(seed=3)[0])
    assert len(rollout) == 60
    assert bool(rollout["next", "truncated"][-1])
    assert float(rollout["next", "eval_score"][-1]) == env._env.unwrapped.score()
    env.close()
    ours.close()


@pytest.mark.slow
def test_torchrl_workers() -> None:
    env = GymEnv("magical_mj:magical_mj/FixColour-Demo-State-v0", num_envs=2)
    assert env.rollout(3)["observation"].shape == (2, 3, len(magical_mj.observations.STATE_NAMES))
    env.close()
