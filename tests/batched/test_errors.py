"""What batched worlds refuse, and what they say then."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from magical_mj import batched
from magical_mj.utils.errors import ClosedError, InvalidActionError, SettingsError, StateError, UnknownNameError

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]


@pytest.mark.parametrize("actions", [[1, 2], [0, 1, 18], [0.5, 1.0, 2.0], [-1, 0, 0], None, "abc", [2**70, 0, 0]])
def test_wrong_actions_are_refused(actions: Any) -> None:
    env = batched.make("MoveToRegion", "Demo", 3, device="cpu", preset="State")
    env.reset(seed=0)
    with pytest.raises(InvalidActionError, match="3 integers"):
        env.step(actions)
    env.close()


def test_states_of_other_worlds_and_closed_environments_are_refused() -> None:
    made = batched.make("MoveToRegion", "Demo", 2, device="cpu", image_size=32)
    for wrong in (None, {}):
        with pytest.raises(StateError, match="get_state"):
            made.set_state(wrong)
    with pytest.raises(ResetNeeded, match="reset"):
        made.step([0, 0])
    made.reset(seed=0)
    for name, variant, count, changes in (
        ("environments", "Demo", 1, {}),
        ("environments", "Jitter", 2, {}),
        ("rules", "Demo", 2, {"rules": "released"}),
        ("preset", "Demo", 2, {"preset": "LoRes4A"}),
        ("image_size", "Demo", 2, {"image_size": 16}),
    ):
        other = batched.make("MoveToRegion", variant, count, device="cpu", **{"image_size": 32, **changes})
        other.reset(seed=0)
        other.step([1] * count)
        with pytest.raises(StateError, match=name):
            made.set_state(other.get_state())
        assert made._steps.tolist() == [0, 0], "nothing is changed"
        other.close()
    made.step([1, 1])
    state, seen = made.get_state(), made.physics.poses
    for damaged in (
        {**state, "kind": None},
        {**state, "physics": {name: state["physics"][name] for name in ("qpos", "act")}},
        {**state, "steps": state["steps"][:1]},
        {**state, "sampler": {"seed": 0, "episodes": [0]}},
        {**state, "observer": {"all": state["observer"]["all"][:, :1]}},
    ):
        with pytest.raises(StateError, match="what get_state"):
            made.set_state(damaged)
        assert torch.equal(made.physics.poses, seen), "nothing is changed"
    made.close()
    for use in (made.reset, made.get_state, lambda: made.step([0, 0]), lambda: made.set_state({})):
        with pytest.raises(ClosedError, match="closed"):
            use()


def test_wrong_settings_are_named() -> None:
    with pytest.raises(SettingsError, match="no device 'cuda:7'"):
        batched.make("MoveToRegion", num_envs=1, device="cuda:7")
    with pytest.raises(SettingsError, match="at least 1"):
        batched.make("MoveToRegion", num_envs=0, device="cpu")
    with pytest.raises(SettingsError, match="60 environments"):
        batched.make("all", "all", 4, device="cpu")
    batched.make("MoveToRegion", num_envs=1, device=torch.device("cpu")).close()  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="workers"):
        batched.make("MoveToRegion", num_envs=1, device="cpu", workers=-1)
    with pytest.raises(UnknownNameError, match="preset"):
        batched.make("MoveToRegion", num_envs=1, device="cpu", preset="HiRes")
    with pytest.raises(SettingsError, match="num_envs"):
        batched.make("MoveToRegion", num_envs=True, device="cpu")
    for mode in (AutoresetMode.NEXT_STEP, "SAME_STEP"):
        with pytest.raises(SettingsError, match="SAME_STEP"):
            batched.make("MoveToRegion", num_envs=1, device="cpu", autoreset_mode=mode)  # type: ignore[arg-type]
