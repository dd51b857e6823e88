"""Compares sets of demonstrations: their statistics, and the scores of a policy that is trained on them.

    python tools/research/demonstration_statistics.py [FOLDER ...] [--people human_replays.npz] [--learn] [--tasks A,B]

The columns are the shipped sets 1 and 2, the folders of demonstrations, and episodes of people in the original
simulation. The latter are a file of arrays ``<Task>/<number>/{actions, poses, fingers, score}``. Poses have the shape
(steps + 1, 1 + blocks, 3), with the robot first.

The table of statistics takes seconds. ``--learn`` adds a table of behavioural cloning from states with 10
demonstrations of each task, evaluated in our simulation. A training and its episodes take about a minute of one core.
"""

from __future__ import annotations

import argparse
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from magical_mj import TASKS, demos, sample_scene
from magical_mj.actions import ACTIONS, NOOP, Gripper
from magical_mj.assets.robot import JOINTS
from magical_mj.assets.scene_model import SceneModel
from magical_mj.demos import Demonstration
from magical_mj.demos.recording import strategy
from magical_mj.scene.constants import CONTROL_RATE

Demonstrations = list[Demonstration]
Floats = NDArray[np.float64]

CELL: Final = 0.1  # the side of the counted cells in world units
CLOSED: Final = np.array([action.gripper == Gripper.CLOSE for action in ACTIONS])
LEARNT_FROM: Final = 10  # demonstrations


def people(path: Path, task: str) -> Demonstrations:
    """The recorded episodes of people in a task. Velocities are the differences of the recorded poses."""
    scene = sample_scene(task, "Demo", 0)
    world, size = SceneModel(scene), 3 * len(scene.blocks) + len(JOINTS)
    columns = np.arange(float(size))
    planar, fingers = world.poses(columns).astype(int), world.fingers(columns).astype(int)
    found = []
    with np.load(path) as data:
        for key in sorted(name.removesuffix("/actions") for name in data if name.endswith("/actions")):
            if not key.startswith(f"{task}/"):
                continue
            poses = data[f"{key}/poses"]
            qpos = np.zeros((len(poses), size))
            qpos[:, planar] = poses
            qpos[:, fingers] = data[f"{key}/fingers"]
            qvel = np.diff(qpos, axis=0, prepend=qpos[:1]) * CONTROL_RATE
            actions, score = data[f"{key}/actions"].astype(np.uint8), float(data[f"{key}/score"])
            found.append(Demonstration(task, "Demo", 0, "human", 0, scene, actions, qpos, qvel, score))
    return found


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))


def _path(demo: Demonstration) -> Floats:
    """The positions of the robot. Shape (steps + 1, 2)."""
    world = SceneModel(demo.scene)
    return np.array([world.poses(qpos)[0, :2] for qpos in demo.qpos])


def _entropy(chosen: Demonstrations) -> float:
    pairs = np.zeros((len(ACTIONS), len(ACTIONS)))
    for demo in chosen:
        np.add.at(pairs, (demo.actions[:-1], demo.actions[1:]), 1)
    shares = pairs / pairs.sum()
    given = pairs.sum(axis=1, keepdims=True) / pairs.sum()
    return float(-(shares * np.log2(np.divide(shares, given, out=np.ones_like(shares), where=shares > 0))).sum())


def _different(plans: Sequence[object]) -> float:
    """The expected number of different plans among 10 demonstrations."""
    size, drawn = len(plans), min(LEARNT_FROM, len(plans))
    return sum(1 - math.comb(size - count, drawn) / math.comb(size, drawn) for count in Counter(plans).values())


STATISTICS: Final[Mapping[str, Callable[[Demonstrations], float]]] = {
    "steps": lambda chosen: _mean(len(demo.actions) for demo in chosen),
    "of them until the last action": lambda chosen: _mean(
        1 + np.flatnonzero(demo.actions != NOOP)[-1] for demo in chosen
    ),
    "entropy of an action given the one before, bits": _entropy,
    "switches of action per step": lambda chosen: _mean(
        np.sum(demo.actions[1:] != demo.actions[:-1]) / len(demo.actions) for demo in chosen
    ),
    "share of no-ops": lambda chosen: _mean(np.concatenate([demo.actions for demo in chosen]) == NOOP),
    "share of closed fingers": lambda chosen: _mean(CLOSED[np.concatenate([demo.actions for demo in chosen])]),
    "length of the robot's path": lambda chosen: _mean(
        np.hypot(*np.diff(_path(demo), axis=0).T).sum() for demo in chosen
    ),
    "cells visited": lambda chosen: _mean(len(np.unique(_path(demo) // CELL, axis=0)) for demo in chosen),
    "orders of blocks among 10": lambda chosen: _different([tuple(n for n, _ in strategy(demo)) for demo in chosen]),
    "orders and sides of approach among 10": lambda chosen: _different([strategy(demo) for demo in chosen]),
}
"""Name -> statistic of the demonstrations of a task."""


def learn(chosen: Demonstrations, task: str, seed: int, episodes: int) -> tuple[float, float, float]:
    """Mean scores in Demo and Jitter after behavioural cloning from states, and the loss on held-out episodes."""
    import torch
    from torch.nn.functional import cross_entropy

    from magical_mj.evaluation import evaluate
    from magical_mj.learners import load_settings
    from magical_mj.learners.bc import BehaviouralCloning
    from magical_mj.learners.data import TrainingData, drawn
    from magical_mj.learners.networks import as_input
    from magical_mj.learners.policy import TrainedPolicy

    torch.set_num_threads(1)
    settings = load_settings("bc", task, preset="State", seed=seed, demonstrations=LEARNT_FROM)
    learner = BehaviouralCloning(settings, {task: chosen})
    for _ in range(learner.updates):
        learner.update()
    policy = TrainedPolicy(learner.actor, settings.tasks, settings.preset, learner.learnt)
    played = {"tasks": task, "variants": "Demo,Jitter", "split": "dev", "episodes": episodes, "preset": "State"}
    frame = evaluate(policy, jobs=1, **played)
    scores = frame.groupby("variant")["score"].mean()
    seen = drawn(task, seed, LEARNT_FROM, len(chosen))
    rest = [demo for number, demo in enumerate(chosen) if number not in seen]
    held_out = TrainingData(
        load_settings("bc", task, preset="State", demonstrations=len(rest)), drop_noop=True, demonstrations={task: rest}
    )
    batch = held_out.rows([torch.arange(held_out.sizes[0])])
    with torch.no_grad():
        logits = learner.actor.eval()(as_input(batch.observations, torch.device("cpu")), batch.tasks)
    return float(scores["Demo"]), float(scores["Jitter"]), float(cross_entropy(logits, batch.actions))


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description="Compares sets of demonstrations.")
    parser.add_argument("folders", nargs="*", type=Path, metavar="FOLDER")
    parser.add_argument("--people", type=Path, help="recorded episodes of people")
    parser.add_argument("--tasks", default=",".join(TASKS))
    parser.add_argument("--learn", action="store_true", help="also train and evaluate policies")
    parser.add_argument("--seeds", type=int, default=5, help="trainings for each task")
    parser.add_argument("--episodes", type=int, default=100, help="episodes after each training, in Demo and in Jitter")
    arguments = parser.parse_args()
    tasks = arguments.tasks.split(",")
    sets = {f"set {number}": {task: demos.load(task, set=number) for task in tasks} for number in (1, 2)}
    sets |= {str(folder): {task: demos.load(task, folder) for task in tasks} for folder in arguments.folders}
    if arguments.people:
        sets["people"] = {task: people(arguments.people, task) for task in tasks}

    print(f"| Means over tasks | {' | '.join(sets)} |\n| --- |{' ---: |' * len(sets)}")
    for name, statistic in STATISTICS.items():
        means = [_mean(statistic(chosen) for chosen in by_task.values()) for by_task in sets.values()]
        print(f"| {name} | {' | '.join(f'{mean:.2f}' for mean in means)} |", flush=True)
    if not arguments.learn:
        return
    print(f"\n| Demo / Jitter / held-out loss | {' | '.join(sets)} |\n| --- |{' ---: |' * len(sets)}")
    for task in tasks:
        cells = []
        for by_task in sets.values():
            runs = [learn(by_task[task], task, seed, arguments.episodes) for seed in range(arguments.seeds)]
            cells.append(" / ".join(f"{mean:.2f}" for mean in np.mean(runs, axis=0)))
        print(f"| {task} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
