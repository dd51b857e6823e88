"""Behavioural cloning: its data, its network, its loss; and IQ-Learn, whose loss is another."""

from __future__ import annotations

import math
import platform
import subprocess
import sys
from collections import Counter, defaultdict

import numpy as np
import pytest
import torch

from magical_mj import demos
from magical_mj.actions import NOOP
from magical_mj.learners import load_settings
from magical_mj.learners.bc import BehaviouralCloning, IQLearn, iq_loss, usable
from magical_mj.learners.data import TrainingData, drawn
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import Heads, Torso, as_input
from magical_mj.learners.settings import InverseSettings, NetworkSettings
from magical_mj.utils.errors import DemonstrationError, SettingsError
from tests.helpers.learners import tiny


def test_the_seed_draws_ten_of_twenty_five() -> None:
    draws = {tuple(drawn("FindDupe", seed, 10, 25)) for seed in range(5)}
    assert len(draws) == 5
    assert all(len(set(draw)) == 10 and set(draw) <= set(range(25)) for draw in draws)
    assert drawn("FindDupe", 0, 10, 25) != drawn("MakeLine", 0, 10, 25)
    assert drawn("FindDupe", 3, 25, 25) == list(range(25))
    with pytest.raises(DemonstrationError, match="demonstrations is 26, but there are 25 demonstrations of FindDupe"):
        drawn("FindDupe", 0, 26, 25)


def test_every_method_learns_from_the_same_demonstrations() -> None:
    """The transitions are those of the drawn demonstrations, with or without the no-ops."""
    settings = tiny(tasks="FixColour", seed=3)
    chosen = [demos.load("FixColour")[number] for number in drawn("FixColour", 3, 2, 25)]
    for drop_noop in (True, False):
        images, actions = demos.transitions(chosen, drop_noop=drop_noop, renderer=settings.renderer)
        data = TrainingData(settings, drop_noop=drop_noop)
        assert data.sizes == [len(actions)]
        batch = data.rows([torch.arange(len(actions))])
        np.testing.assert_array_equal(batch.observations, images)
        np.testing.assert_array_equal(batch.actions, actions)
        assert (NOOP in actions) != drop_noop


def test_every_task_counts_equally() -> None:
    data = TrainingData(tiny(tasks="MoveToRegion,FixColour"), drop_noop=True)
    assert data.sizes[0] != data.sizes[1]
    generator = torch.Generator().manual_seed(0)
    batches = [data.sample(5, generator) for _ in range(200)]
    shares = torch.stack([batch.tasks.bincount(minlength=2) for batch in batches])
    assert set(shares[:, 0].tolist()) == {2, 3}
    assert shares[:, 0].sum() == pytest.approx(500, abs=30)  # the odd one goes to either task alike
    first = data.rows([torch.arange(data.sizes[0]), torch.arange(0)])
    pictures = {image.tobytes() for image in first.observations.numpy()}
    drawn = batches[0].observations.numpy()
    assert [image.tobytes() in pictures for image in drawn] == (batches[0].tasks == 0).tolist()


def test_the_network_is_the_papers() -> None:
    """Figure "Base architecture": 4,608 activations after five convolutions, then 256 and 256."""
    torso = Torso(NetworkSettings(), batch_norm=True, actions=True)
    assert torso.flat == 4608
    kinds = [type(layer).__name__ for layer in torso.convolutions]
    assert kinds == 5 * ["Conv2d", "BatchNorm2d", "ReLU"]
    shapes = [tuple(layer.weight.shape) for layer in torso.convolutions if isinstance(layer, torch.nn.Conv2d)]
    assert shapes == [(64, 12, 5, 5), (128, 64, 3, 3), *3 * [(128, 128, 3, 3)]]
    assert [tuple(p.shape) for p in torso.linear.parameters()] == [(256, 4608 + 18), (256,), (256, 256), (256,)]
    assert not any(isinstance(layer, torch.nn.BatchNorm2d) for layer in Torso(NetworkSettings()).convolutions)
    assert torso(torch.zeros(2, 12, 96, 96), torch.tensor([0, 17])).shape == (2, 256)


def test_pixels_become_small_numbers() -> None:
    images = np.random.default_rng(0).integers(0, 256, (2, 96, 96, 12)).astype(np.uint8)
    stacks = as_input(images, torch.device("cpu"))
    assert stacks.shape == (2, 12, 96, 96)
    assert stacks[1, 5, 7, 9] == pytest.approx(images[1, 7, 9, 5] / 255)
    assert stacks.is_contiguous(memory_format=torch.channels_last)


def test_a_head_is_a_linear_map_of_its_own() -> None:
    with seeded(0):
        heads = Heads(3, 4, 2)
    features = torch.randn(5, 4, generator=torch.Generator().manual_seed(0))
    tasks = torch.tensor([0, 2, 2, 1, 0])
    expected = torch.stack([heads.weight[t] @ x + heads.bias[t] for x, t in zip(features, tasks, strict=True)])
    torch.testing.assert_close(heads(features, tasks), expected)


def test_the_loss_is_the_log_loss() -> None:
    """With a head of zeros all actions are equally probable; with a bias the softmax is known by hand."""
    learner = BehaviouralCloning(tiny(**{"bc.learning_rate": 1e-12, "bc.final_learning_rate": 1e-12}))
    with torch.no_grad():
        learner.actor.head.weight.zero_()
        learner.actor.head.bias.zero_()
    assert learner.update()["loss"] == pytest.approx(math.log(18), rel=1e-4)
    with torch.no_grad():
        learner.actor.head.bias[0, 7] = 100.0
    _, actions, _ = TrainingData(learner.settings, drop_noop=True).sample(4, _after_one_draw(learner))
    expected = 100.0 * (actions != 7).float().mean().item()
    assert learner.update()["loss"] == pytest.approx(expected, rel=1e-4)


def _after_one_draw(learner: BehaviouralCloning) -> torch.Generator:
    generator = torch.Generator()
    generator.set_state(learner.get_state()["draw"])
    return generator


def test_recalibration_makes_batch_norms_averages_those_of_the_present_weights() -> None:
    """And changes nothing of the training to come."""
    learner, other = BehaviouralCloning(tiny(augment="none")), BehaviouralCloning(tiny(augment="none"))
    for _ in range(3):
        learner.update()
        other.update()
    learner.recalibrate()
    norm = next(layer for layer in learner.actor.modules() if isinstance(layer, torch.nn.BatchNorm2d))
    images, _, _ = learner.data.rows([torch.arange(learner.data.sizes[0])])
    with torch.no_grad():
        expected = learner.actor.torso.convolutions[0](as_input(images, learner.device)).mean((0, 2, 3))
    torch.testing.assert_close(norm.running_mean, expected, atol=0.02, rtol=0.1)
    assert learner.update() == other.update()


def test_bfloat16_learns_the_same_within_its_precision() -> None:
    losses = [
        [learner.update()["loss"] for _ in range(5)]
        for learner in (BehaviouralCloning(tiny(precision=precision)) for precision in ("float32", "bfloat16"))
    ]
    np.testing.assert_allclose(losses[1], losses[0], rtol=0.1)
    assert losses[0] != losses[1]


@pytest.mark.slow
def test_it_can_learn_demonstrations_by_heart() -> None:
    """99 % of what anybody can know: demonstrators did different things where they saw the very same."""
    changes = {"demonstrations": 3, "augment": "none", "network.hidden": 64, "network.channels": 16}
    changes |= {"network.first_channels": 8, "bc.batch_size": 32, "bc.batches": 150}
    learner = BehaviouralCloning(tiny(**changes))
    for _ in range(learner.updates):
        learner.update()
    data = learner.data
    images, actions, tasks = data.rows([torch.arange(data.sizes[0])])
    learner.actor.eval()
    with torch.no_grad():
        predicted = learner.actor(as_input(images, learner.device), tasks).argmax(1)
    done: dict[bytes, Counter[int]] = defaultdict(Counter)
    for image, action in zip(images.numpy(), actions.tolist(), strict=True):
        done[image.tobytes()][action] += 1
    known = sum(max(counter.values()) for counter in done.values())
    assert 0.9 * len(actions) < known < len(actions)
    assert (predicted == actions).sum() >= 0.99 * known


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries manage memory otherwise")
def test_freed_memory_is_kept_by_the_process() -> None:
    # in its own process, as trainings are: elsewhere, the heap may be fragmented
    done = subprocess.run([sys.executable, "-c", FAULTS], capture_output=True, text=True, check=True)
    assert int(done.stdout) < 20_000  # otherwise it would be 200,000


FAULTS = """
import resource, torch
from magical_mj.learners.learner import keep_freed_memory
keep_freed_memory()
faults = []
for _ in range(20):
    torch.ones(20_000_000)  # 80 MB, twenty thousand pages
    faults.append(resource.getrusage(resource.RUSAGE_SELF).ru_minflt)
print(faults[-1] - faults[9])  # at first, the heap grows
"""


SETTINGS = InverseSettings(discount=0.9, temperature=0.5, alpha=0.25)
SMALL = {
    "preset": "State",
    "device": "cpu",
    "evaluations": 0,
    "demonstrations": 2,
    "network.entity": 16,
    "network.hidden": 32,
    "bc.batches": 150,
}


def test_the_loss_is_the_papers() -> None:
    """E[V(s) - discount V(s')] - E[r - r^2 / (4 alpha)], computed with Q and V as they are in the paper."""
    generator = torch.Generator().manual_seed(0)
    q, q_next = (torch.randn((5, 18), generator=generator) for _ in range(2))
    actions = torch.randint(18, (5,), generator=generator)
    temperature, discount = SETTINGS.temperature, SETTINGS.discount
    v, v_next = (temperature * (values / temperature).exp().sum(1).log() for values in (q, q_next))
    r = q[torch.arange(5), actions] - discount * v_next
    expected = (v - discount * v_next).mean() - (r - r**2 / (4 * SETTINGS.alpha)).mean()
    loss, rewards = iq_loss(q / temperature, q_next / temperature, actions, SETTINGS)
    torch.testing.assert_close(loss * temperature, expected)
    torch.testing.assert_close(rewards, r)


def test_gradients_also_reach_the_values_of_successors() -> None:
    """At Q = 0 by hand: r = -discount * temperature log 18, of which the square falls if V(s') does."""
    logits, following = (torch.zeros((1, 18), requires_grad=True) for _ in range(2))
    loss, rewards = iq_loss(logits, following, torch.tensor([3]), SETTINGS)
    loss.backward()
    r = -SETTINGS.discount * SETTINGS.temperature * torch.tensor(18.0).log()
    torch.testing.assert_close(rewards, r[None])
    pull = r / (2 * SETTINGS.alpha)  # of the square, by each of Q(s, a) and -discount V(s')
    assert logits.grad is not None
    assert following.grad is not None
    cloning = torch.full((18,), 1 / 18)
    cloning[3] -= 1
    cloning[3] += pull
    torch.testing.assert_close(logits.grad[0], cloning)
    torch.testing.assert_close(following.grad[0], torch.full((18,), -SETTINGS.discount / 18) * pull)


def test_each_row_learnt_from_has_its_successor_behind_it() -> None:
    settings = load_settings("iq-learn", "FixColour", **SMALL)
    data = TrainingData(settings, drop_noop=False)
    rows = usable(data, 0)
    assert (data.actions[0][rows] != NOOP).all()
    first, following = (data.rows([numbers]).observations for numbers in (rows, rows + 1))
    torch.testing.assert_close(first[:, 1:], following[:, :-1])  # histories overlap
    acting = (data.actions[0] != NOOP).sum()
    assert acting - 2 <= len(rows) <= acting
    assert data.last[0].nonzero()[:, 0].tolist()[-1] == len(data.actions[0]) - 1
    assert not data.last[0][rows].any()


def test_it_learns_the_demonstrations() -> None:
    learner = IQLearn(load_settings("iq-learn", "MoveToRegion", **SMALL))
    metrics = [learner.update() for _ in range(learner.updates)]
    assert metrics[-1]["accuracy"] > 0.7 > metrics[0]["accuracy"]
    assert abs(metrics[-1]["reward"]) < abs(metrics[0]["reward"])


def test_large_alpha_is_behavioural_cloning() -> None:
    logits, actions = torch.randn((4, 18), generator=torch.Generator().manual_seed(1)), torch.tensor([0, 5, 17, 2])
    loss, _ = iq_loss(logits, logits, actions, InverseSettings(alpha=1e9))
    torch.testing.assert_close(loss, torch.nn.functional.cross_entropy(logits, actions))


def test_iq_learn_needs_states() -> None:
    with pytest.raises(SettingsError, match="preset State"):
        IQLearn(load_settings("iq-learn", "MoveToRegion"))
