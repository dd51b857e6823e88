"""The policies that act in the page on which one plays: trained, exported, checked and scored. `make policies`.

One for each task, by behavioural cloning from states with the settings of the state track, but for a smaller network.
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
"""Units of the last two layers, instead of 256: a file has 0.27 MB."""
MOST_BYTES: Final = 300_000
VARIANTS: Final = ("Demo", "Layout")
STATES: Final = 200
"""States in which the exported policy must prefer the same actions."""


def make(task: str) -> dict[str, float]:
    """Train and export the policy of a task; returns its mean scores in some variants, 100 episodes each."""
    run, file = RUNS / task, FOLDER / f"{task}.onnx"
    changes: dict[str, Any] = {"preset": "State", "network.hidden": HIDDEN}
    train(load_settings("bc", task, **changes), run, resume=run.exists())
    export_policy(run, file, overwrite=True)
    if file.stat().st_size > MOST_BYTES:
        raise SystemExit(f"{file} has {file.stat().st_size:,} bytes, and may have {MOST_BYTES:,}")
    check(run, file, task)
    there = [variant for variant in VARIANTS if (task, variant) in ENVIRONMENTS]
    scores = magical_mj.evaluate(run, tasks=task, variants=",".join(there), preset="State")
    return {variant: round(float(scores["score"][scores["variant"] == variant].mean()), 2) for variant in there}


def check(run: Path, file: Path, task: str) -> None:
    """Raise SystemExit unless the file prefers the same actions as the trained network in all states."""
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
