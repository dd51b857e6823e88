"""AIRL: its logits and rewards against the paper's formulas, which state follows which, and what it needs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from magical_mj.learners import load_settings
from magical_mj.learners.gail import AIRL, Shaped
from magical_mj.utils.errors import SettingsError
from tests.helpers.learners import playing

LONG: dict[str, Any] = {"preset": "State", "ppo.steps": 64, "ppo.total_steps": 512}
FAST: dict[str, Any] = {"preset": "State", "discriminator.steps": 60, "discriminator.learning_rate": 1e-2}


def test_loss_and_reward_are_the_papers() -> None:
    """D = exp f / (exp f + pi) for the demonstrator, f = g + discount h(s') - h(s), reward log D - log(1 - D)."""
    learner = AIRL(playing("airl", preset="State"))
    samples = learner.on_device(learner.expert.sample(5, torch.Generator().manual_seed(0)))
    steps, actions, tasks = samples
    before, after = steps[:, :4], steps[:, 1:]
    f = learner.discriminator
    assert isinstance(f, Shaped)
    with torch.no_grad():
        values = f.reward(before, actions, tasks) - f.potential(before, tasks)
        values += learner.settings.ppo.discount * f.potential(after, tasks)
        pi = learner.actor(before, tasks).softmax(1)[torch.arange(5), actions]
        d = values.exp() / (values.exp() + pi)
        torch.testing.assert_close(learner.reward(*samples), d.log() - (1 - d).log())
        loss, _ = learner.loss((torch.cat([steps, steps]), torch.cat([actions, actions]), torch.cat([tasks, tasks])))
    torch.testing.assert_close(loss, -(1 - d).log().mean() - d.log().mean())
    learner.close()


def test_demonstrations_contain_the_following_states() -> None:
    learner = AIRL(playing("airl", preset="State"))
    (last,) = learner.expert.last
    assert last.sum() == 2
    assert last[-1]
    rows = learner.expert.rows([torch.arange(len(last))]).observations
    inner = ~last[:-1]
    torch.testing.assert_close(rows[:-1, 1:][inner], rows[1:, :-1][inner])
    torch.testing.assert_close(rows[last, 4], rows[last, 3])
    learner.close()


def test_rollouts_contain_the_following_states() -> None:
    """Each step has the state of the next, across rollouts too; the last of an episode has its own again."""
    learner = AIRL(playing("airl", **LONG))
    first, second = learner.collect().observations.numpy(), learner.collect().observations.numpy()
    both = np.concatenate([first, second[:1]])
    goes_on = (both[:-1, :, 1:] == both[1:, :, :-1]).all((2, 3))
    ends = (first[:, :, 4] == first[:, :, 3]).all(2) & ~goes_on
    assert (goes_on | ends).all()
    assert 4 <= ends.sum() <= 8  # episodes have 40 steps, and 4 environments play
    learner.close()


def test_the_discriminator_learns() -> None:
    learner = AIRL(playing("airl", **FAST))
    first, *_, last = [learner.update() for _ in range(learner.updates)]
    assert last["loss"] < first["loss"]
    learner.close()


def test_airl_needs_states() -> None:
    with pytest.raises(SettingsError, match="preset State"):
        AIRL(load_settings("airl", "MoveToRegion"))
