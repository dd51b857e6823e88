"""GAIL, WGAIL-GP and AL: their formulas by hand, and trainings that can be repeated and resumed bit for bit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from magical_mj.learners import checkpoint
from magical_mj.learners.apprenticeship import Apprenticeship, Autoencoder, best_weights
from magical_mj.learners.gail import GAIL, WGAILGP, Discriminator, gail_loss, gradient_penalty
from magical_mj.learners.settings import NetworkSettings
from tests.helpers.learners import playing


def test_gails_loss_by_hand() -> None:
    """D = 0.8 and 0.5 for the policy, 0.2 for the demonstrator: -(log 0.8 + log 0.5) / 2 - log(1 - 0.2)."""
    loss = gail_loss(torch.tensor([math.log(4), 0.0]), torch.tensor([-math.log(4)]))
    assert loss.item() == pytest.approx(-(math.log(0.8) + math.log(0.5)) / 2 - math.log(0.8))


def test_gails_reward_is_minus_log_d() -> None:
    learner = GAIL(playing())
    samples = torch.rand(3, 12, 96, 96), torch.tensor([1, 2, 3]), torch.zeros(3, dtype=torch.int64)
    with torch.no_grad():
        torch.testing.assert_close(learner.reward(*samples), -learner.discriminator(*samples).sigmoid().log())
    learner.close()


def test_the_gradient_penalty_by_hand() -> None:
    """D = c_a x w . s for action a has the gradient c_a w whatever s is; ||w|| = 3 x 5 pixels."""
    weights = torch.zeros(12, 4, 4)
    weights[0, 0, 0], weights[11, 3, 2] = 9.0, 12.0
    factors = torch.tensor([1.0, 0.1])

    def discriminator(stacks: torch.Tensor, actions: torch.Tensor, tasks: torch.Tensor) -> torch.Tensor:
        return factors[actions] * (stacks * weights).sum((1, 2, 3))

    actions = torch.tensor([0, 1, 1, 0])
    penalty = gradient_penalty(discriminator, torch.rand(4, 12, 4, 4), actions, torch.zeros(4))
    assert penalty.item() == pytest.approx(((15 - 1) ** 2 + (1.5 - 1) ** 2) / 2)


def test_the_gradient_penalty_trains_the_discriminator() -> None:
    """For D = w . s, the penalty (||w|| - 1)^2 has the gradient 2 (||w|| - 1) w / ||w||."""
    weights = torch.full((12, 4, 4), 0.5, requires_grad=True)
    norm = 0.5 * math.sqrt(12 * 16)
    stacks = torch.rand(3, 12, 4, 4)
    gradient_penalty(lambda s, a, t: (s * weights).sum((1, 2, 3)), stacks, torch.zeros(3), torch.zeros(3)).backward()
    torch.testing.assert_close(weights.grad, 2 * (norm - 1) * weights.detach() / norm)
    assert stacks.grad is None


def test_each_samples_gradient_is_its_own() -> None:
    """The penalty of a batch is the mean of the penalties of its samples alone, in spite of batch norm."""
    discriminator = Discriminator(playing().network, 2)
    generator = torch.Generator().manual_seed(0)
    stacks = torch.rand(4, 12, 96, 96, generator=generator)
    actions, tasks = torch.tensor([0, 5, 9, 17]), torch.tensor([0, 1, 0, 1])
    discriminator.train()(stacks, actions, tasks)  # running statistics that are not the initial ones
    discriminator.eval()
    alone = [gradient_penalty(discriminator, *(part[[n]] for part in (stacks, actions, tasks))) for n in range(4)]
    # rounding depends on the batch's size; with the batch's statistics, the difference is 0.6
    whole = gradient_penalty(discriminator, stacks, actions, tasks)
    torch.testing.assert_close(whole, torch.stack(alone).mean(), atol=1e-4, rtol=0)


def test_wgails_loss_by_hand() -> None:
    """100 x penalty + E_demonstrations D - E_policy D, and the reward is -D."""
    learner = WGAILGP(playing(**{"discriminator.gradient_penalty": 7}))
    with torch.no_grad():
        for weights in learner.discriminator.parameters():
            weights.zero_()
        learner.discriminator.head.weight.zero_()
        learner.discriminator.head.bias.fill_(2.5)
    samples = torch.rand(4, 12, 96, 96), torch.tensor([0, 1, 2, 3]), torch.zeros(4, dtype=torch.int64)
    loss, metrics = learner.loss(samples)
    assert loss.item() == pytest.approx(7)  # D is 2.5 everywhere, and its gradient 0
    assert metrics == {"distance": 0.0, "penalty": pytest.approx(1.0)}
    torch.testing.assert_close(learner.reward(*samples), torch.full((4,), -2.5))
    learner.close()


def test_wgails_sides() -> None:
    """The first half is the policy's: D rises there and falls for the demonstrator's."""
    learner = WGAILGP(playing(**{"discriminator.gradient_penalty": 0}))
    samples = torch.rand(4, 12, 96, 96), torch.tensor([0, 1, 2, 3]), torch.zeros(4, dtype=torch.int64)
    values = learner.discriminator.train()(*samples).detach()
    loss, metrics = learner.loss(samples)  # about 1e-2, with the other sign if the sides are exchanged
    assert loss.item() == pytest.approx((values[2:].mean() - values[:2].mean()).item(), abs=1e-4)
    assert metrics["distance"] == pytest.approx(-loss.item())
    learner.close()


def test_the_weight_vector_is_the_best_of_the_unit_ball() -> None:
    differences = torch.tensor([[3.0, -4.0, 0.0], [0.0, 0.0, 0.0]])
    weights = best_weights(differences)
    torch.testing.assert_close(weights, torch.tensor([[0.6, -0.8, 0.0], [0.0, 0.0, 0.0]]))
    others = torch.nn.functional.normalize(torch.randn(1000, 3, generator=torch.Generator().manual_seed(0)), dim=1)
    assert (others @ differences[0]).max() <= weights[0] @ differences[0]


def test_al_weighs_the_features_of_both_sides() -> None:
    """By the formula, from the demonstrations and rollouts that it draws; the policy's latest samples are kept."""
    learner = Apprenticeship(playing(tasks="MoveToRegion,FixColour", **{"features.samples": 40}))
    first, second = learner.ppo.collect(), learner.ppo.collect()
    learner.learn_reward(first)
    metrics = learner.learn_reward(second)
    everything = learner.expert.rows([torch.arange(size) for size in learner.expert.sizes])
    expert = learner.autoencoder.features(*learner.on_device(everything)[:2])
    novice = [
        learner.autoencoder.features(*learner.on_device(part)[:2]) for part in (*first.batches(16), *second.batches(16))
    ]
    novice = torch.cat(novice).reshape(8, 2, 2, -1)  # steps, tasks, copies of each
    assert [len(features) for features in learner.latest] == [16, 16]  # of the 20 that are asked for
    for task in (0, 1):
        mean = expert[everything.tasks == task].mean(0) - novice[:, task].flatten(0, 1).mean(0)
        # The means nearly cancel, so how a machine rounds their sums shows in the direction.
        torch.testing.assert_close(learner.weights[task], mean / mean.norm(), rtol=1e-3, atol=1e-3)
    assert metrics["distance"] > 0
    third = learner.ppo.collect()
    learner.learn_reward(third)
    assert learner.latest.shape[1] == 20
    stacks, actions, tasks = learner.on_device(next(third.batches(16)))
    expected = torch.einsum(
        "nf,nf->n", learner.autoencoder.features(stacks, actions), learner.weights[[0, 0, 1, 1] * 4]
    )
    torch.testing.assert_close(learner.reward(stacks, actions, tasks), expected)
    learner.close()


@pytest.mark.parametrize("network", [NetworkSettings(), playing().network], ids=["paper", "small"])
def test_the_autoencoder_is_its_own_mirror(network: NetworkSettings) -> None:
    autoencoder = Autoencoder(network, 32)
    stacks, actions = torch.rand(2, 12, 96, 96), torch.tensor([0, 17])
    assert autoencoder.encoder(stacks, actions).shape == (2, 32)
    assert autoencoder(stacks, actions).shape == stacks.shape
    inwards = [layer.weight.shape for layer in autoencoder.encoder.convolutions if isinstance(layer, torch.nn.Conv2d)]
    outwards = [layer.weight.shape for layer in autoencoder.decoder if isinstance(layer, torch.nn.ConvTranspose2d)]
    assert inwards == outwards[::-1]  # a transposed convolution's weights are those of the convolution it mirrors


def test_features_that_are_always_0_are_initialised_again() -> None:
    autoencoder = Autoencoder(playing().network, 6)
    weight, bias = autoencoder.encoder.linear[2].parameters()
    with torch.no_grad():
        bias.fill_(1.0)
        weight.abs_()
        bias[[1, 4]] = -1e3
    samples = torch.rand(5, 12, 96, 96), torch.tensor([0, 3, 3, 8, 17])
    before = autoencoder.features(*samples)
    assert (before <= 0).all(0).tolist() == [False, True, False, False, True, False]
    assert autoencoder.restart(before) == 2
    after = autoencoder.features(*samples)
    assert (after > 0).any(0).all()
    torch.testing.assert_close(after[:, [0, 2, 3, 5]], before[:, [0, 2, 3, 5]])


def test_the_autoencoder_learns_and_then_stays() -> None:
    changes = {"preset": "State", "features.batches": 30, "features.learning_rate": 0.01, "ppo.total_steps": 32}
    learner = Apprenticeship(playing(**changes))
    assert learner.updates == 32
    policy = [weights.clone() for weights in learner.actor.parameters()]
    losses = [learner.update()["reconstruction"] for _ in range(30)]
    assert losses[-1] < losses[0] / 2
    assert all(map(torch.equal, policy, learner.actor.parameters()))
    coder = {name: value.clone() for name, value in learner.autoencoder.state_dict().items()}
    assert learner.update()["reconstruction"] == losses[-1]
    assert all(torch.equal(coder[name], value) for name, value in learner.autoencoder.state_dict().items())
    assert not all(map(torch.equal, policy, learner.actor.parameters()))
    learner.close()


def test_batches_are_half_and_half() -> None:
    """The discriminator sees as many samples of each side and of each task, with no-ops."""
    learner = GAIL(playing(tasks="MoveToRegion,FixColour"))
    tasks = []

    def loss(samples: tuple[torch.Tensor, ...]) -> tuple[torch.Tensor, dict[str, float]]:
        tasks.append(samples[2].tolist())
        return learner.discriminator(*samples).sum(), {}

    learner.loss = loss
    learner.learn_reward(learner.ppo.collect())
    assert tasks == [[0, 0, 1, 1, 0, 0, 1, 1]] * 2
    learner.close()


def test_the_policys_samples_are_of_the_latest_rollouts(tmp_path: Path) -> None:
    """As many as the settings say; what is resumed has them all."""
    learner = GAIL(playing(preset="State", **{"discriminator.rollouts": 3}))
    played, sampled = [], []
    learner.train_discriminator = lambda rollout: sampled.append(rollout) or {}  # type: ignore[method-assign,func-returns-value]
    for _ in range(4):
        played.append(learner.ppo.collect())
        learner.learn_reward(played[-1])
    expected = np.concatenate([rollout.observations for rollout in played[1:]])
    np.testing.assert_array_equal(sampled[-1].observations, expected)
    checkpoint.write(tmp_path / "kept.safetensors", learner.get_state())
    learner.set_state(checkpoint.read(tmp_path / "kept.safetensors"))
    played.append(learner.ppo.collect())
    learner.learn_reward(played[-1])
    expected = np.concatenate([rollout.actions for rollout in played[2:]])
    np.testing.assert_array_equal(sampled[-1].actions, expected)
    learner.close()


def test_rewards_are_of_unaugmented_pictures_by_running_statistics() -> None:
    learner = GAIL(playing())
    rollout = learner.ppo.collect()
    learner.learn_reward(rollout)
    stacks, actions, tasks = learner.on_device(next(rollout.batches(16)))
    with torch.no_grad():
        whole = learner.reward(stacks, actions, tasks)
        assert not learner.discriminator.training
        alone = learner.reward(stacks[3:4], actions[3:4], tasks[3:4])
    torch.testing.assert_close(whole[3:4], alone, atol=1e-4, rtol=0)  # with the batch's statistics it is 2e-2
    learner.close()
