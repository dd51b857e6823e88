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
    ):
        other = batched.make("MoveToRegion", variant, count, device="cpu", **{"image_size": 32, **changes})
        other.reset(seed=0)
        other.step([1] * count)
        with pytest.raises(StateError, match=name):
            worlds.set_state(other.get_state())
        assert worlds._steps.tolist() == [0, 0], "nothing is changed"
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
        ({"task": "all", "variant": "all"}, "60 environments"),
        ({"workers": -1}, "workers"),
        ({"preset": "HiRes"}, "preset"),
        ({"autoreset_mode": AutoresetMode.NEXT_STEP}, "SAME_STEP"),
        ({"autoreset_mode": "SAME_STEP"}, "gymnasium.vector"),
    ],
)
def test_wrong_settings_are_named(settings: Any, word: str) -> None:
    with pytest.raises((SettingsError, UnknownNameError), match=word):
        batched.make(**{"task": "MoveToRegion", "num_envs": 1, "device": "cpu", **settings})
