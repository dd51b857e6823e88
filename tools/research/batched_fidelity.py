"""Measures the deviation of batched environments from MuJoCo: from states in mid-episode, and over open-loop episodes.

python tools/research/batched_fidelity.py actions [--states 200] [--steps 10] [--device cpu]
python tools/research/batched_fidelity.py replays [--tasks FindDupe,...] [--count 25] [--device cpu] [--human ARCHIVE]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path

import mujoco
import numpy as np
import torch
from numpy.typing import NDArray

import magical_mj
from magical_mj.batched.physics import Physics
from magical_mj.batched.scenes import BatchScenes, capacity_for
from magical_mj.scene import Scene

BATCH = 60
"""The number of environments in a batch. Warp's CPU device takes 60 to 190 ms for an action of one of them."""


def table(scene: Scene) -> NDArray[np.float64]:
    """x, y, angle of the robot and of each block. Shape (1 + blocks, 3)."""
    return np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])


def held(rng: np.random.Generator, steps: int) -> list[int]:
    """Random actions, each held for a few steps, so that the robot moves far."""
    actions: list[int] = []
    while len(actions) < steps:
        actions += [int(rng.integers(18))] * int(rng.integers(2, 7))
    return actions[:steps]


def take_over(physics: Physics, world: int, data: mujoco.MjData) -> None:
    """Copies the state of a simulation to an environment of the batch with the same scene."""
    state, slots = physics.get_state(), 3 * physics.blocks
    own = len(data.qpos) - (physics.model.nq - slots)  # coordinates of the scene's blocks
    for name in ("qpos", "qvel", "qacc_warmstart"):
        row = state[name][world]
        given = torch.from_numpy(getattr(data, name).copy()).to(row)
        row[:own], row[slots:] = given[:own], given[own:]
    state["act"][world] = torch.from_numpy(data.act.copy()).to(state["act"])
    physics.set_state(state)


def compare(states: int, steps: int, device: str) -> None:
    """Prints the distance error of the worst body after one and after all actions, over states of all environments."""
    rng = np.random.default_rng(0)
    rows: list[tuple[str, NDArray[np.float64]]] = []
    pairs = magical_mj.ENVIRONMENTS
    for first in range(0, states, BATCH):
        chosen = [pairs[number % len(pairs)] for number in range(first, min(first + BATCH, states))]
        envs = [magical_mj.Engine(*pair, seed=first) for pair in chosen]
        for env in envs:
            for action in held(rng, int(rng.integers((env.horizon or 1) - steps))):
                env.step(action)
        scenes = [env.initial_scene for env in envs]
        physics = Physics(BatchScenes.of(scenes, *capacity_for(scenes)), device)
        for world, env in enumerate(envs):
            take_over(physics, world, env.data)
        plans = np.array([held(rng, steps) for _ in envs])
        errors = np.zeros((len(envs), steps))
        for step in range(steps):
            physics.step(torch.from_numpy(plans[:, step]).to(device))
            poses = physics.poses.cpu().numpy()
            for world, env in enumerate(envs):
                env.step(int(plans[world, step]))
                wanted = table(env.scene)
                errors[world, step] = np.linalg.norm(poses[world, : len(wanted), :2] - wanted[:, :2], axis=-1).max()
        rows += [(f"{task}-{variant}", error) for (task, variant), error in zip(chosen, errors, strict=True)]
        print(f"{len(rows)} states", flush=True)
    every = np.array([errors for _, errors in rows])
    for step in (1, steps):
        median, most, worst = np.quantile(every[:, step - 1], (0.5, 0.95, 1.0))
        print(f"after {step}: median {median:.1e}, 95 % below {most:.1e}, at most {worst:.1e}")
    for name, errors in sorted(rows, key=lambda row: -row[1][-1])[:10]:
        print(f"  {name}: {errors[0]:.1e} after one action, {errors[-1]:.1e} after {steps}")


def sequences(
    tasks: Sequence[str], human: Path | None, count: int
) -> Iterator[tuple[str, str, Scene, NDArray[np.int64]]]:
    """Yields demonstrator, task, scene and actions of the sequences to replay."""
    for task in tasks:
        for demo in magical_mj.demos.load(task)[:count]:
            yield "expert", task, demo.scene, demo.actions.astype(np.int64)
    if human is not None:
        with np.load(human) as data:
            for task in tasks:
                found = [key for key in data.files if key.startswith(f"{task}/") and key.endswith("/actions")]
                for key in found[:count]:
                    yield "people", task, magical_mj.sample_scene(task, "Demo", 0), data[key].astype(np.int64)


def replay(tasks: Sequence[str], human: Path | None, count: int, device: str) -> None:
    """Prints the mean scores of sequences replayed in MuJoCo and in batched environments, by task."""
    groups: dict[tuple[str, str], list[tuple[Scene, NDArray[np.int64]]]] = {}
    for who, task, scene, actions in sequences(tasks, human, count):
        groups.setdefault((who, task), []).append((scene, actions))
    for (who, task), cases in groups.items():
        ours = []
        for scene, actions in cases:
            env = magical_mj.Engine(task, scene=scene)
            for action in actions:
                env.step(int(action))
            ours.append(env.score())
        scenes, length = [scene for scene, _ in cases], max(len(actions) for _, actions in cases)
        arrays = BatchScenes.of(scenes, *capacity_for(scenes))
        physics = Physics(arrays, device)
        ends = np.zeros(len(cases))
        for step in range(length):
            plan = [int(actions[step]) if step < len(actions) else 0 for _, actions in cases]
            physics.step(torch.tensor(plan, device=device))
            for world, (scene, actions) in enumerate(cases):
                if step == len(actions) - 1:
                    final = arrays.scene(world, physics.poses[world].cpu().numpy())
                    ends[world] = magical_mj.score(task, scene, final)
        print(f"{who} {task}: {len(cases)} sequences, here {np.mean(ours):.3f}, batched {ends.mean():.3f}", flush=True)


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("actions", "replays"))
    parser.add_argument("--states", type=int, default=200)
    parser.add_argument("--steps", type=int, default=10)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--tasks", default=",".join(magical_mj.TASKS), help="the tasks of the replays")
    parser.add_argument("--human", type=Path, help="an archive of people's sequences, task/number/actions")
    parser.add_argument("--count", type=int, default=25, help="sequences of each task, of experts and of people")
    chosen = parser.parse_args()
    if chosen.human is not None and not chosen.human.is_file():
        parser.error(f"{chosen.human} does not exist")
    if chosen.what == "actions":
        compare(chosen.states, chosen.steps, chosen.device)
    else:
        replay(chosen.tasks.split(","), chosen.human, chosen.count, chosen.device)


if __name__ == "__main__":
    main()
