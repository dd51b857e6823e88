"""IQ-Learn: its loss against the paper's formula, which steps it learns from, and that it learns."""

from __future__ import annotations

import pytest
import torch

from magical_mj.learners import load_settings
from magical_mj.learners.data import Dataset
from magical_mj.learners.iq_learn import IQLearn, iq_loss, usable
from magical_mj.learners.settings import InverseSettings
from magical_mj.scene.actions import NOOP
from magical_mj.utils.errors import SettingsError

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
    data = Dataset(settings, drop_noop=False)
    rows = usable(data, 0)
    assert (data.actions(0)[rows] != NOOP).all()
    first, following = (torch.from_numpy(data.rows([numbers]).observations) for numbers in (rows, rows + 1))
    torch.testing.assert_close(first[:, 1:], following[:, :-1])  # histories overlap
    acting = (data.actions(0) != NOOP).sum()
    assert acting - len(data.lengths[0]) <= len(rows) <= acting
    assert not set(rows.tolist()) & {sum(data.lengths[0][: number + 1]) - 1 for number in range(2)}


def test_it_learns_the_demonstrations() -> None:
    learner = IQLearn(load_settings("iq-learn", "MoveToRegion", **SMALL))
    metrics = [learner.update() for _ in range(learner.updates)]
    assert metrics[-1]["accuracy"] > 0.7 > metrics[0]["accuracy"]
    assert abs(metrics[-1]["reward"]) < abs(metrics[0]["reward"])


def test_large_alpha_is_behavioural_cloning() -> None:
    logits, actions = torch.randn((4, 18), generator=torch.Generator().manual_seed(1)), torch.tensor([0, 5, 17, 2])
    loss, _ = iq_loss(logits, logits, actions, InverseSettings(alpha=1e9))
    torch.testing.assert_close(loss, torch.nn.functional.cross_entropy(logits, actions))


def test_it_needs_states() -> None:
    with pytest.raises(SettingsError, match="preset State"):
        IQLearn(load_settings("iq-learn", "MoveToRegion"))
