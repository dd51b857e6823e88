"""Does variation in other tasks teach a policy what to ignore? Pretraining on k tasks, then BC on another one.

    python -m tools.research.pretraining --out runs/pretraining [--held-out FindDupe,...] [--tasks 0,1,3,7] [--seeds 2]
    python -m tools.pretraining runs/pretraining    # stores the scores for the table of docs/learners.md

For each held-out task, number k of other tasks and seed:

1. a policy with a head for each of k random other tasks clones the expert from states, in all variants of these tasks.
   Its demonstrations start in scenes of the dev split, and are cached for all runs;
2. a policy for the held-out task starts with the layers below the head, and clones 10 demonstrations of the demo scene;
3. it plays the test scenes of the held-out task.

With k = 0, step 1 is left out. Each result is a line of OUT/scores.jsonl. Called again, the command continues, and
prints the means so far.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
import torch

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.demos import Demonstration, stored
from magical_mj.evaluation import evaluate
from magical_mj.learners import load_settings
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.tasks.registry import SPLITS
from magical_mj.variants import VARIANTS
from tools.pretraining import BUDGET

TRAINED_IN: Final = 1_000
"""The first dev scene of the pretraining. Earlier ones serve other purposes."""


def others(held_out: str, count: int, seed: int) -> tuple[str, ...]:
    """Random other tasks. Those of a smaller number are among those of a larger one."""
    rng = np.random.default_rng([seed, zlib.crc32(held_out.encode())])
    return tuple(rng.permutation([task for task in TASKS if task != held_out]).tolist()[:count])


@cache
def demonstrations(task: str, scenes: int, path: Path) -> Sequence[Demonstration]:
    """The expert's demonstrations in this number of scenes of each variant of a task."""
    first = SPLITS["dev"] + TRAINED_IN
    variants = [variant for name, variant in ENVIRONMENTS if name == task]
    keys = [(task, variant, first + number) for variant in variants for number in range(scenes)]
    return [stored.replay(one, path) for one in stored.complete(keys, path, jobs=1)]


def trained(learner: BehaviouralCloning) -> BehaviouralCloning:
    """The learner after all its updates."""
    for _ in range(learner.updates):
        learner.update()
    return learner


def result(held_out: str, count: int, seed: int, options: argparse.Namespace) -> dict[str, list[float]]:
    """The score of each episode in each variant of the held-out task, in the order of the scenes."""
    learner = BehaviouralCloning(
        load_settings("bc", held_out, preset="State", seed=seed, device="cpu", **{"bc.batches": options.batches})
    )
    if count:
        known = others(held_out, count, seed)
        settings = load_settings(
            "bc", known, preset="State", seed=seed, device="cpu", **{"bc.batches": options.pretraining}
        )
        path = options.out / "experts.jsonl"
        before = BehaviouralCloning(settings, {task: demonstrations(task, options.scenes, path) for task in known})
        learner.actor.torso.load_state_dict(trained(before).actor.torso.state_dict())
    policy = trained(learner).policy()
    played = {"tasks": held_out, "variants": options.variants, "episodes": options.episodes}
    frame = evaluate(policy, preset="State", jobs=1, **played).sort_values("seed")
    return {str(variant): scores.tolist() for variant, scores in frame.groupby("variant")["score"]}


def main(arguments: Sequence[str] | None = None) -> None:
    """Computes what is missing, and prints the means. By default, the arguments are those of the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--held-out", default="FixColour,MatchRegions")
    parser.add_argument("--tasks", default="0,1,3,7", help="the numbers k")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenes", type=int, default=4, help="demonstrations of each variant of the other tasks")
    parser.add_argument("--pretraining", type=int, default=6_000, help="batches on the other tasks")
    parser.add_argument("--batches", type=int, default=3_000, help="batches on the held-out task")
    parser.add_argument("--variants", default="Demo,Layout,Colour,All", help="variants of the held-out task")
    parser.add_argument("--episodes", type=int, default=30)
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    path = options.out / "scores.jsonl"
    budget = {name: getattr(options, name) for name in BUDGET}
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    numbers = [int(text) for text in options.tasks.split(",")]
    if not set(numbers) <= set(range(len(TASKS))):
        parser.error(f"--tasks must be numbers from 0 to {len(TASKS) - 1}, separated by commas, not {options.tasks}")
    tasks: list[str] = options.held_out.split(",")
    for seed, held_out, count in [(s, task, k) for s in range(options.seeds) for task in tasks for k in numbers]:
        key: dict[str, Any] = {"held_out": held_out, "tasks": count, "seed": seed, **budget}
        if not any(key.items() <= row.items() for row in done):
            done.append({**key, "scores": result(held_out, count, seed, options)})
            with path.open("a") as file:
                file.write(json.dumps(done[-1]) + "\n")
    rows = [
        {"tasks": row["tasks"], **{variant: np.mean(scores) for variant, scores in row["scores"].items()}}
        for row in done
        if budget.items() <= row.items() and row["tasks"] in numbers
    ]
    frame = pd.DataFrame(rows).groupby("tasks").mean()
    print(frame.reindex(columns=[variant for variant in VARIANTS if variant in frame]).round(2))


if __name__ == "__main__":
    main()
