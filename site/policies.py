"""Trains, exports, checks and scores the policies of the page for playing: `make policies`.

There is one for each task, trained by behavioural cloning from states. The settings are those of the state track,
except for a smaller network.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch

import magical_mj
from magical_mj.learners import load_policy, load_settings, train
from magical_mj.learners.policy import export_policy
from magical_mj.policies.interface import histories
from magical_mj.policies.models import onnx_runtime
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS

ROOT: Final = Path(__file__).parent.parent
FOLDER: Final = ROOT / "site" / "policies"
RUNS: Final = ROOT / "out" / "policies"
HIDDEN: Final = 128
"""The number of units of the last two layers, instead of 256. A file then has 0.27 MB."""
MOST_BYTES: Final = 300_000
VARIANTS: Final = ("Demo", "Layout")
STATES: Final = 200
"""The number of states for comparing the exported policy with the trained one."""


def make(task: str) -> dict[str, float]:
    """Trains and exports the policy of a task. Returns its mean scores in `VARIANTS`, with 100 episodes each."""
    run, file = RUNS / task, FOLDER / f"{task}.onnx"
    changes: dict[str, Any] = {"preset": "State", "network.hidden": HIDDEN}
    train(load_settings("bc", task, **changes), run, resume=run.exists())
    export_policy(run, file, overwrite=True)
    if file.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{file} has {file.stat().st_size:,} bytes, more than the limit of {MOST_BYTES:,}")
    check(run, file, task)
    variants = [variant for variant in VARIANTS if (task, variant) in ENVIRONMENTS]
    scores = magical_mj.evaluate(run, tasks=task, variants=",".join(variants), preset="State")
    return {variant: round(float(scores["score"][scores["variant"] == variant].mean()), 2) for variant in variants}


def check(run: Path, file: Path, task: str) -> None:
    """Raises a SystemExit unless the file chooses the same actions as the trained network."""
    demos = magical_mj.demos.load(task)
    every = np.concatenate([histories(np.asarray(magical_mj.demos.observations(demo, "State"))) for demo in demos])
    seen = every[np.linspace(0, len(every) - 1, STATES).astype(int)]
    with torch.inference_mode():
        ours = load_policy(run).actor(torch.as_tensor(seen), torch.zeros(STATES, dtype=torch.long)).argmax(1).numpy()
    (logits,) = onnx_runtime().InferenceSession(file).run(None, {"observations": seen})
    if (ours != np.asarray(logits).argmax(1)).any():
        raise SystemExit(f"{file} acts differently than {run}")


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "scores.json").write_text(json.dumps({task: make(task) for task in TASKS}, indent=1) + "\n")
