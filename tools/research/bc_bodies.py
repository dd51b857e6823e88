"""Behavioural cloning from states with each body, tested on all bodies: the tables in docs/bodies-transfer.md.

    python -m tools.research.bc_bodies [--tasks SweepToTop,MoveToRegion] [--updates 3000] [--episodes 50]

A network of 2 x 256 learns from the demonstrations of one body, and plays every body. In SweepToTop, it learns speed
and turn from the 16 entries of the state that all bodies have, with 50 shipped demonstrations in TestLayout. It is
tested in other scenes of TestLayout, and a gripper stays closed. In the other tasks, it learns to choose one of the 18
actions from 25 demonstrations of the expert in Demo, and is tested in Jitter. Sticks ignore the fingers' part of an
action.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import closing
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj import demos
from magical_mj.engine import Engine
from magical_mj.scene.bodies import BODIES
from magical_mj.tasks.registry import task_spec
from magical_mj.xmagical.sweep_to_top import state_vector

SWEEP = "SweepToTop"
SCALES = torch.tensor([1.0, 12.0])
"""The factors of speed and turn, so that both targets have about the same size."""

Policy = Callable[[NDArray[np.float32], str], Any]
"""The action for a state vector and a body."""


def demonstrations(task: str, body: str) -> list[demos.Demonstration]:
    """The demonstrations with a body."""
    if task == SWEEP:
        return demos.load(SWEEP, body=body)
    return [demos.demonstrate(task, "Demo", 10_000 + number, body=body) for number in range(25)]


def fitted(states: Tensor, outputs: int, loss: Callable[[Tensor, Tensor], Tensor], updates: int) -> nn.Module:
    """Trains a network on states that are not normalised. `loss` takes the outputs and the numbers of their rows."""
    torch.manual_seed(0)
    size = states.shape[1]
    network = nn.Sequential(nn.Linear(size, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, outputs))
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    for _ in range(updates):
        rows = torch.randint(len(states), (256,))
        error = loss(network(states[rows] + 0.01 * torch.randn(256, size)), rows)
        optimiser.zero_grad()
        error.backward()
        optimiser.step()
    return network


def train(task: str, body: str, updates: int) -> Policy:
    """The policy that imitates the demonstrations of a body."""
    parts = [demos.transitions([demo], "State") for demo in demonstrations(task, body)]
    states = torch.from_numpy(np.concatenate([np.asarray(part.observations) for part in parts]))
    actions = torch.from_numpy(np.concatenate([part.actions for part in parts]))
    if task == SWEEP:
        wanted = (actions[:, :2] * SCALES).clamp(-1, 1)
        network = fitted(states[:, :16], 2, lambda out, rows: (out.tanh() - wanted[rows]).abs().mean(), updates)

        def speeds(state: NDArray[np.float32], body: str) -> NDArray[np.float32]:
            shared = (network(torch.from_numpy(state[:16])).tanh() / SCALES).numpy()
            return np.append(shared, np.float32(1.0)) if BODIES[body].fingers else shared

        return speeds
    labels = actions.long()
    network = fitted(states, 18, lambda out, rows: nn.functional.cross_entropy(out, labels[rows]), updates)
    return lambda state, _: int(network(torch.from_numpy(state)).argmax())


@torch.no_grad()
def play(policy: Policy, task: str, body: str, episodes: int) -> float:
    """The mean score of a policy that plays with a body."""
    scores = []
    with closing(Engine(task, "Layout" if task == SWEEP else "Jitter", seed=0, body=body)) as engine:
        for seed in range(episodes):
            engine.reset(seed=seed)
            over = False
            while not over:
                state = state_vector(engine.scene) if task == SWEEP else engine.state_vector()
                over = engine.step(policy(state, body))
            scores.append(engine.score())
    return float(np.mean(scores))


def main() -> None:
    """Prints the tables: a row for the body of the demonstrations, with the mean score of each tested body."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tasks", default="SweepToTop,MoveToRegion,FixColour,MoveToCorner")
    parser.add_argument("--updates", type=int, default=3_000)
    parser.add_argument("--episodes", type=int, default=50)
    options = parser.parse_args()
    torch.set_num_threads(1)
    for task in options.tasks.split(","):
        bodies = task_spec(task).bodies
        print(f"| {task} | " + " | ".join(bodies) + " |")
        for body in bodies:
            policy = train(task, body, options.updates)
            means = [f"{play(policy, task, other, options.episodes):.2f}" for other in bodies]
            print(f"| {body} | " + " | ".join(means) + " |", flush=True)


if __name__ == "__main__":
    main()
