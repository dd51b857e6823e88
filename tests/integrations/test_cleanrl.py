"""CleanRL: its script ppo.py, with a few lines changed, and its network."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from tests.helpers.cloning import cloned
from tests.helpers.libraries import EPISODES, compare, demonstrations

pytest.importorskip("cleanrl", reason="cleanrl is missing: make integrations-test LIBRARY=cleanrl")

CHANGES = {
    "from distutils.util import strtobool\n": "from ast import literal_eval as strtobool\n",
    "import gym\n": "import gymnasium as gym\nimport magical_mj\n",
    r"envs = gym\.vector\.SyncVectorEnv\(\n.*?\n    \)\n": """\
envs = gym.make_vec(
        args.env_id, args.num_envs, vectorization_mode="sync", reward="score",
        vector_kwargs={"autoreset_mode": gym.vector.AutoresetMode.SAME_STEP},
    )
""",
    r"envs\.reset\(\)\)": "envs.reset(seed=args.seed)[0])",
    r"next_obs, reward, done, info = (envs\.step\(.*?\))\n": r"""\
next_obs, reward, ended, cut, info = \1
            done = ended | cut
""",
    r" {12}for item in info:\n.*?break\n": """\
            if "final_info" in info:
                scores = info["final_info"]["eval_score"][info["_final_info"]]
                writer.add_scalar("charts/score", scores.mean(), global_step)
                SCORES.extend(scores.tolist())
""",
}
"""Patterns in the script, and what replaces them."""


def test_ppo_trains_and_scores_the_same_by_both_paths(
    record_property: Callable[[str, object], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(next(iter(find_spec("cleanrl").submodule_search_locations)))  # type: ignore[union-attr, arg-type]
    text = (folder / "ppo.py").read_text()
    for pattern, replacement in CHANGES.items():
        text, count = re.subn(pattern, replacement, text, flags=re.DOTALL)
        assert count == 1, pattern
    monkeypatch.chdir(tmp_path)
    steps = 8192
    options = ["--env-id", "magical_mj/MoveToRegion-Demo-State-v0", "--total-timesteps", str(steps), "--cuda", "False"]
    monkeypatch.setattr(sys, "argv", ["ppo.py", *options])
    names: dict[str, Any] = {"__name__": "__main__", "__file__": "ppo.py", "SCORES": []}
    threads = torch.get_num_threads()
    exec(compile(text, "ppo.py", "exec"), names)
    torch.set_num_threads(threads)
    assert len(names["SCORES"]) == steps // 40  # every episode's end is seen
    assert np.isfinite(names["SCORES"]).all()
    data, actor = demonstrations(), names["agent"].actor  # so short a PPO scores 0
    draw = torch.Generator().manual_seed(0)
    samples = (torch.randint(len(data["actions"]), (64,), generator=draw).numpy() for _ in range(1500))
    rows = ((torch.from_numpy(data["observations"][one]), torch.from_numpy(data["actions"][one])) for one in samples)
    act = cloned(rows, actor)

    @torch.inference_mode()
    def final_scores(env: gymnasium.Env[Any, Any]) -> Any:
        """As the changed script reads them: side by side, at the end of the episodes."""
        mode = {"autoreset_mode": gymnasium.vector.AutoresetMode.SAME_STEP}
        assert env.unwrapped.spec is not None
        envs = gymnasium.make_vec(env.unwrapped.spec, EPISODES, "sync", vector_kwargs=mode)
        states, _ = envs.reset(seed=0)
        info: dict[str, Any] = {}
        while "final_info" not in info:
            states, *_, info = envs.step(actor(torch.from_numpy(states)).argmax(1).numpy())
        envs.close()
        assert info["_final_info"].all()
        return info["final_info"]["eval_score"]

    compare(
        record_property,
        f"`ppo.py`, {steps:,} steps with {len(names['SCORES'])} scores; then its network, cloned, by `final_info`",
        final_scores,
        act,
    )
