"""Behavioural cloning of SweepToTop from states, per body and across bodies: a table in docs/bodies.md.

    python -m research.bc_xmagical [--updates 3000] [--episodes 50]

A network of 2 x 256 learns speed and turn from the shipped demonstrations of one body, and plays every body in the
test scenes of TestLayout from seed 0 on: of the state, the 16 entries that all bodies have, and of the action, the two
entries that all have. A gripper's grip stays closed, as in its demonstrations.
"""

from __future__ import annotations

import argparse

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from magical_mj import demos
from magical_mj.engine import Engine
from magical_mj.scene.bodies import BODIES
from magical_mj.tasks.sweep_to_top import state_vector

SHARED: slice = slice(0, 16)
SCALES = torch.tensor([1.0, 12.0])
"""Of speed and turn, so that both have about the same size."""


def train(body: str, updates: int) -> nn.Module:
    """The network that imitates the demonstrations of a body."""
    torch.manual_seed(0)
    parts = [demos.transitions([demo], "State") for demo in demos.load("SweepToTop", body=body)]
    states = torch.from_numpy(np.concatenate([np.asarray(part.observations) for part in parts])[:, SHARED])
    actions = torch.from_numpy(np.concatenate([part.actions for part in parts])[:, :2]) * SCALES
    network = nn.Sequential(nn.Linear(16, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, 2), nn.Tanh())
    optimiser = torch.optim.Adam(network.parameters(), 1e-3)
    for _ in range(updates):
        rows = torch.randint(len(states), (256,))
        noisy = states[rows] + 0.01 * torch.randn(256, 16)
        loss = (network(noisy) - actions[rows].clamp(-1, 1)).abs().mean()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    return network


def play(network: nn.Module, body: str, episodes: int) -> float:
    """The mean score of the network with a body."""
    engine, scores = Engine("SweepToTop", "Layout", seed=0, body=body), []
    for seed in range(episodes):
        engine.reset(seed=seed)
        over = False
        while not over:
            over = engine.step(action(network, state_vector(engine.scene), body))
        scores.append(engine.score())
    return float(np.mean(scores))


@torch.no_grad()
def action(network: nn.Module, state: NDArray[np.float32], body: str) -> NDArray[np.float32]:
    """The action for a state vector."""
    shared = (network(torch.from_numpy(state[SHARED])) / SCALES).numpy()
    return np.append(shared, np.float32(1.0)) if BODIES[body].fingers else shared


def main() -> None:
    """Prints the table: whose demonstrations, then the mean score of each body."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--updates", type=int, default=3_000)
    parser.add_argument("--episodes", type=int, default=50)
    options = parser.parse_args()
    torch.set_num_threads(1)
    print("| Trained on | " + " | ".join(BODIES) + " |")
    for body in BODIES:
        network = train(body, options.updates)
        print(
            f"| {body} | " + " | ".join(f"{play(network, other, options.episodes):.2f}" for other in BODIES) + " |",
            flush=True,
        )


if __name__ == "__main__":
    main()
