"""Does variation in other tasks teach a policy what to ignore? Pretraining on other tasks, then BC on another one.

    python -m tools.research.pretraining --out runs/states [--held-out FindDupe,...] [--tasks 0,1,3,7] [--seeds 2]
    python -m tools.research.pretraining --out runs/pictures --preset LoRes4E --seeds 1
    python -m tools.research.pretraining --out runs/pictures --preset LoRes4E --seeds 1 --encoder runs/next.safetensors
    python -m tools.pretraining runs/states runs/pictures    # stores the scores for the table of docs/pretraining.md

For each held-out task, number k of other tasks and seed:

1. a policy with a head for each of k random other tasks clones the expert, in all variants of these tasks. Its
   demonstrations start in scenes of the dev split, and are cached for all runs;
2. a policy for the held-out task starts with the layers below the head, and clones 10 demonstrations of the demo scene;
3. it plays the test scenes of the held-out task.

With k = 0, step 1 is left out, and there is a control with as many batches on the held-out task as both steps have
together. With an encoder of tools.research.encoders, only step 2 is made, on its frozen convolutions. From images,
networks are those of `--quick`. Each result is a line of OUT/scores.jsonl. Called again, the command continues, and
prints the means so far.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import pandas as pd
import torch

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.demos import Demonstration, stored
from magical_mj.evaluation import evaluate
from magical_mj.learners import load_settings
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.settings import LEARNABLE, STATE, TrainingSettings
from magical_mj.tasks.registry import SPLITS
from magical_mj.variants import VARIANTS
from tools.pretraining import BUDGET
from tools.research.encoders import description

TRAINED_IN: Final = 1_000
"""The first dev scene of the pretraining. Earlier ones serve other purposes."""


class Run(NamedTuple):
    """A policy for a held-out task."""

    held_out: str
    start: str
    """"scratch", "cloning" of other tasks, or the name that tools.research.encoders gives an encoder."""
    tasks: int
    """The number of other tasks in the pretraining."""
    pretraining: int
    """The number of batches on them."""
    batches: int
    """The number of batches on the held-out task."""
    seed: int


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
    return [one.verified(path) for one in stored.complete(keys, path, jobs=1)]


def trained(learner: BehaviouralCloning) -> float:
    """Makes all updates of the learner. Returns its accuracy in the last tenth of them."""
    found = [learner.update()["accuracy"] for _ in range(learner.updates)]
    return float(np.mean(found[-max(1, len(found) // 10) :]))


def settings_for(
    tasks: str | tuple[str, ...], batches: int, seed: int, preset: str, encoder: Path | None = None
) -> TrainingSettings:
    """The settings of BC."""
    changes = {"bc.batches": batches, **({"bc.encoder": encoder} if encoder else {})}
    return load_settings("bc", tasks, quick=preset != STATE, preset=preset, seed=seed, device="cpu", **changes)


def started(run: Run, options: argparse.Namespace) -> tuple[BehaviouralCloning, float | None]:
    """The learner of the held-out task before its first batch, and how well the pretraining learnt."""
    preset: str = options.preset
    learner = BehaviouralCloning(settings_for(run.held_out, run.batches, run.seed, preset, options.encoder))
    if options.encoder:
        facts = description(options.encoder)
        return learner, facts.get("explained", facts.get("accuracy"))
    if run.start == "scratch":
        return learner, None
    known, path = others(run.held_out, run.tasks, run.seed), options.out / "experts.jsonl"
    found = {task: demonstrations(task, options.scenes, path) for task in known}
    before = BehaviouralCloning(settings_for(known, run.pretraining, run.seed, preset), found)
    accuracy = trained(before)
    learner.actor.torso.load_state_dict(before.actor.torso.state_dict())
    return learner, round(accuracy, 4)


def result(run: Run, options: argparse.Namespace) -> dict[str, Any]:
    """The score of each episode in each variant, in the order of the scenes, and how well the pretraining learnt."""
    learner, learnt = started(run, options)
    trained(learner)
    learner.recalibrate()
    played = {"tasks": run.held_out, "variants": options.variants, "episodes": options.episodes}
    how = {"preset": options.preset, "renderer": learner.settings.renderer, "jobs": 1}
    frame = evaluate(learner.policy(), **how, **played).sort_values("seed")
    scores = {str(variant): scores.tolist() for variant, scores in frame.groupby("variant")["score"]}
    return {"learnt": learnt, "scores": scores}


def planned(options: argparse.Namespace) -> Iterator[Run]:
    """The runs of the command."""
    facts = description(options.encoder) if options.encoder else {}
    counts = [] if facts else [int(text) for text in options.tasks.split(",")]
    held_out: list[str] = options.held_out.split(",")
    for seed, task in [(seed, task) for seed in range(options.seeds) for task in held_out]:
        if facts:
            yield Run(task, facts["start"], len(facts["tasks"]), facts["batches"], options.batches, seed)
        for count in counts:
            if count:
                yield Run(task, "cloning", count, options.pretraining, options.batches, seed)
            else:
                yield Run(task, "scratch", 0, 0, options.batches, seed)
                yield Run(task, "scratch", 0, 0, options.pretraining + options.batches, seed)


def main(arguments: Sequence[str] | None = None) -> None:
    """Computes what is missing, and prints the means. By default, the arguments are those of the command."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--preset", choices=LEARNABLE, default=STATE, help="the observations")
    parser.add_argument("--held-out", default="FixColour,MatchRegions")
    parser.add_argument("--tasks", default="0,1,3,7", help="the numbers k")
    parser.add_argument("--encoder", type=Path, help="a file by tools.research.encoders, instead of --tasks")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenes", type=int, default=4, help="demonstrations of each variant of the other tasks")
    parser.add_argument("--pretraining", type=int, help="batches on the other tasks; by default twice --batches")
    parser.add_argument(
        "--batches", type=int, help="batches on the held-out task; by default 3,000 from states, 1,000 from images"
    )
    parser.add_argument("--variants", default="Demo,Layout,Colour,All", help="variants of the held-out task")
    parser.add_argument("--episodes", type=int, default=30)
    options = parser.parse_args(arguments)
    options.batches = options.batches or (3_000 if options.preset == STATE else 1_000)
    options.pretraining = options.pretraining or 2 * options.batches
    if not {*options.tasks.split(",")} <= {str(count) for count in range(len(TASKS))}:
        parser.error(f"--tasks must be numbers from 0 to {len(TASKS) - 1}, separated by commas, not {options.tasks}")
    learnt_from = description(options.encoder)["tasks"] if options.encoder else []
    if seen := [task for task in options.held_out.split(",") if task in learnt_from]:
        parser.error(f"{options.encoder} learnt from episodes of {', '.join(seen)}: give another one, or --held-out")
    options.out.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    path = options.out / "scores.jsonl"
    budget = {name: getattr(options, name) for name in BUDGET}
    done = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    rows: list[dict[str, Any]] = []
    for run in planned(options):
        key = {**run._asdict(), **budget}
        found = next((row for row in done if key.items() <= row.items()), None)
        if found is None:
            found = {**key, **result(run, options)}
            with path.open("a") as file:
                file.write(json.dumps(found) + "\n")
        means = {variant: np.mean(scores) for variant, scores in found["scores"].items()}
        rows.append({**run._asdict(), **means})
    frame = pd.DataFrame(rows).groupby(["start", "tasks", "pretraining", "batches"]).mean(numeric_only=True)
    print(frame.reindex(columns=[variant for variant in VARIANTS if variant in frame]).round(2))


if __name__ == "__main__":
    main()
