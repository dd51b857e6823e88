"""Continuous actions: the same episodes in single, vector and wrapped environments."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import magical_mj
from magical_mj.actions import to_discrete, to_vector
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import InvalidActionError, SettingsError, UnknownNameError
from magical_mj.wrappers import ContinuousActions
from magical_mj.xmagical.suite import suite_id

ID = "magical_mj/FixColour-Demo-State-v0"


def wrapped() -> gymnasium.Env[Any, Any]:
    return ContinuousActions(gymnasium.make(ID))


def made() -> gymnasium.Env[Any, Any]:
    return gymnasium.make(ID, action="continuous")


@pytest.mark.parametrize("make", [wrapped, made])
def test_a_demonstration_played_by_its_vectors_ends_where_it_ended(make: Any) -> None:
    demo = magical_mj.demos.load("FixColour")[0]
    env = make()
    env.reset(seed=0, options={"scene": demo.scene})
    for vector in magical_mj.actions.to_vector(demo.actions):
        _, _, _, truncated, info = env.step(vector)
    assert truncated
    assert info["eval_score"] == 1.0
    env.close()


@pytest.mark.parametrize("make", [wrapped, made])
@pytest.mark.filterwarnings("ignore:.*different from the unwrapped version.*:UserWarning")
def test_gymnasium_finds_nothing_wrong(make: Any) -> None:
    env = make()
    assert env.action_space == gymnasium.spaces.Box(-1.0, 1.0, (3,), np.float32)
    check_env(env.unwrapped if make is made else env, skip_render_check=True)
    env.close()


def test_vectors_of_environments_take_batches_of_vectors() -> None:
    envs = gymnasium.make_vec(ID, 2, action="continuous")
    envs.reset(seed=[0, 1])
    assert envs.single_action_space.shape == (3,)
    observations, *_ = envs.step(magical_mj.actions.to_vector([1, 13]))
    assert len(observations) == 2
    envs.close()


def test_the_wrapper_is_part_of_the_spec() -> None:
    env = wrapped()
    spec = gymnasium.envs.registration.EnvSpec.from_json(env.spec.to_json())
    again = gymnasium.make(spec)
    assert again.action_space == env.action_space
    env.close()
    again.close()


@pytest.mark.parametrize("make", [wrapped, made])
@pytest.mark.parametrize("action", [np.array([np.nan, 0.0, 0.0]), np.zeros(2), 3])
def test_a_wrong_vector_is_refused(make: Any, action: Any) -> None:
    env = make().unwrapped if make is made else ContinuousActions(gymnasium.make(ID, disable_env_checker=True))
    env.reset(seed=0)
    with pytest.raises(InvalidActionError, match="three finite numbers"):
        env.step(action)
    env.close()


def test_tensors_that_numpy_cannot_convert_are_refused() -> None:
    """Valid ones are accepted, by each interface."""
    torch = pytest.importorskip("torch")
    zeros = torch.zeros(3)
    unlike = [
        torch.zeros(3, requires_grad=True),
        torch.zeros(3, dtype=torch.bfloat16),
        torch.zeros(3, dtype=torch.complex64),
        torch.zeros(3, device="meta"),
    ]
    suite = gymnasium.make(suite_id("gripper"), disable_env_checker=True)
    envs = gymnasium.make_vec(ID, 1, action="continuous")
    unchecked = ContinuousActions(gymnasium.make(ID, disable_env_checker=True))
    for env, batch in ((suite, ()), (envs, (1,)), (unchecked, ())):
        env.reset(seed=0)
        env.step(zeros.reshape(*batch, 3))
        env.step(zeros.half().reshape(*batch, 3))
        for tensor in unlike:
            with pytest.raises(InvalidActionError, match=r"finite numbers|one for each environment"):
                env.step(tensor.reshape(*batch, 3))
        env.close()
    with pytest.raises(InvalidActionError, match=r"give tensor\.detach\(\)\.float\(\)\.cpu\(\)"):
        to_discrete(unlike[0])
    for numbers in (torch.zeros(1, requires_grad=True), torch.zeros(1, dtype=torch.bfloat16)):
        with pytest.raises(InvalidActionError, match="integers"):
            to_vector(numbers)


def test_each_environment_draws_its_own_actions() -> None:
    first, second = (magical_mj.MagicalEnv("MoveToRegion", preset="State", action="continuous") for _ in range(2))
    for env in (first, second):
        env.action_space.seed(0)
    assert first.action_space.sample().tolist() == second.action_space.sample().tolist()


def test_only_discrete_environments_are_wrapped() -> None:
    with pytest.raises(InvalidActionError, match="18 discrete actions"):
        ContinuousActions(made())
    with pytest.raises(UnknownNameError, match="continuous"):
        gymnasium.make(ID, action="continous")


def test_the_released_horizon_is_kept_where_the_id_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in the processes of asynchronous vector environments, for tasks given as "package.module:SPEC"."""
    name = magical_mj.env_id("ClusterShape", "Demo", "State")
    spec = gymnasium.spec(name)
    monkeypatch.delitem(gymnasium.registry, name)
    env = gymnasium.make(spec, rules="released")
    assert env.spec is not None
    assert env.spec.max_episode_steps == task_spec("ClusterShape").released_steps != spec.max_episode_steps
    with pytest.raises(SettingsError, match="max_episode_steps=999 is more than"):
        gymnasium.make(spec, max_episode_steps=999)
