"""Our networks as stable-baselines3's PPO wants them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.type_aliases import Schedule
from torch import Tensor, nn

from magical_mj.baselines.environments import IMAGES, TASK
from magical_mj.baselines.network import Actor, Heads, Torso, scaled


class Features(BaseFeaturesExtractor):
    """The torso's features with the one-hot task joined to them, which is how it reaches the heads."""

    def __init__(self, observation_space: spaces.Dict, torso: Torso) -> None:
        tasks = observation_space[TASK].shape
        super().__init__(observation_space, torso.features + int(np.prod(tasks or ())))
        self.torso = torso

    def forward(self, observations: Mapping[str, Tensor]) -> Tensor:
        """Shape (n, features + tasks). Pictures come as floats from 0 to 255 made for this, the channels last."""
        stacks = scaled(observations[IMAGES]).permute(0, 3, 1, 2)
        return torch.cat([self.torso(stacks), observations[TASK]], dim=1)


class ForTasks(nn.Module):
    """Heads for features with the task joined to them."""

    def __init__(self, heads: Heads) -> None:
        super().__init__()
        self.heads = heads

    def forward(self, joined: Tensor) -> Tensor:
        """Shape (n, outputs), for shape (n, features + tasks)."""
        inputs = self.heads.weight.shape[2]
        return self.heads(joined[:, :inputs], joined[:, inputs:].argmax(1))


class ActorCritic(ActorCriticPolicy):
    """Stable-baselines3's policy around an `Actor`: action and value share all but the last layer (appendix).

    Args:
        observation_space: of the environments.
        action_space: of the environments.
        lr_schedule: learning rate by what is left of the training.
        actor: the policy.
        critic: the heads that estimate values.
        others: what else PPO gives; nothing that matters here.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Discrete,
        lr_schedule: Schedule,
        actor: Actor,
        critic: Heads,
        **others: Any,
    ) -> None:
        parts = {"features_extractor_class": Features, "features_extractor_kwargs": {"torso": actor.torso}}
        super().__init__(
            observation_space,
            action_space,
            lr_schedule,
            net_arch=[],
            ortho_init=False,
            normalize_images=False,  # `Features` does it, in place
            **parts,
            **others,
        )
        self.action_net, self.value_net = ForTasks(actor.head), ForTasks(critic)
        self.optimizer = torch.optim.Adam(self.parameters(), lr_schedule(1), eps=1e-5)  # stable-baselines3's eps


@torch.no_grad()
def standardise(torso: Torso, stacks: Tensor) -> None:
    """Scales the weights of a new torso so that each unit has mean 0 and deviation 1 over the stacks, before its ReLU.

    Pictures are mostly background. As they are drawn, weights without batch norm answer to that and hardly to the rest:
    policies then act alike wherever they are for tens of thousands of steps. Here each layer begins as if it had batch
    norm (the data-dependent initialisation of Salimans and Kingma, 2016), and has none from then on. The paper does not
    say how weights are drawn.
    """
    values = stacks
    for layer in (*torso.convolutions, nn.Flatten(), *torso.linear):
        if isinstance(layer, nn.Conv2d | nn.Linear):
            answers = layer(values)
            over = [axis for axis in range(answers.dim()) if axis != 1]
            deviation = answers.std(over).clamp(min=1e-6)  # some unit may see nothing
            weight, bias = layer.parameters()
            weight.div_(deviation.reshape(-1, *[1] * (weight.dim() - 1)))
            bias.sub_(answers.mean(over)).div_(deviation)
        values = layer(values)
