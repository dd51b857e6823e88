"""Behavioural cloning in a few lines of PyTorch, for libraries that only deliver the data."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn


def network(size: int) -> nn.Sequential:
    """A network from states to the logits of actions."""
    with torch.random.fork_rng():
        torch.manual_seed(0)
        return nn.Sequential(nn.Linear(size, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU(), nn.Linear(128, 18))


def cloned(batches: Iterable[tuple[Tensor, Tensor]], actor: nn.Module) -> Callable[[Any], int]:
    """The policy of a network that is trained on batches of states and actions."""
    optimizer = torch.optim.Adam(actor.parameters(), 1e-3)
    for states, actions in batches:
        loss = nn.functional.cross_entropy(actor(states.float()), actions.long())
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()

    @torch.inference_mode()
    def act(state: Any) -> int:
        return int(actor(torch.from_numpy(np.asarray(state))).argmax())

    return act
