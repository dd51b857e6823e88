"""CleanRL: its script ppo.py, with the lines changed that docs/integrations.md shows."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.libraries import EPISODES, compare, returns

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
    agent = names["agent"]

    @torch.inference_mode()
    def act(state: Any) -> int:
        return int(agent.actor(torch.as_tensor(state)[None]).argmax())

    compare(
        record_property,
        f"`ppo.py`, {steps:,} steps in Demo, whose {len(names['SCORES'])} episodes have scores",
        lambda env: [returns(env, act) for _ in range(EPISODES)],
        act,
        least=0.0,
    )
    assert np.isfinite(names["SCORES"]).all()
