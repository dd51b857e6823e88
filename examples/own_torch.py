"""Behavioural cloning in a PyTorch loop of your own, from the shipped demonstrations to a score: run this file."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

import magical_mj
from magical_mj import demos

TASK, BATCHES = "MoveToRegion", 1000


class Policy:
    """Takes the most probable action of a network. `evaluate` reads which observations it needs."""

    preset = "State"

    def __init__(self, network: nn.Module) -> None:
        """Acts by this network, which returns 18 logits."""
        self.network = network

    def __call__(self, observation: Any) -> int:
        """The action for one state vector."""
        with torch.inference_mode():
            return int(self.network(torch.as_tensor(observation)[None]).argmax())


def main() -> None:
    """Trains a network, and prints its mean scores."""
    torch.manual_seed(0)
    observations, actions = (torch.as_tensor(part) for part in demos.transitions(demos.load(TASK), Policy.preset))
    network = nn.Sequential(nn.Linear(observations.shape[1], 128), nn.ReLU(), nn.Linear(128, 18))
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    for _ in range(BATCHES):
        rows = torch.randint(len(actions), (64,))
        loss = nn.functional.cross_entropy(network(observations[rows]), actions[rows].long())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    scores = magical_mj.evaluate(Policy(network), name="own", tasks=TASK, variants="Demo,Jitter,Layout", episodes=20)
    print(scores.groupby("variant", sort=False)["score"].mean())


if __name__ == "__main__":
    main()
