"""What PPO plays and learns from: environments that stop anywhere, even minibatches, rewards from outside."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from magical_mj.learners.data import Rollout, TrainingData
from magical_mj.learners.learner import seeded
from magical_mj.learners.networks import ONE_HOT, Actor, Heads, Torso, as_input, standardise
from magical_mj.learners.policy import load_policy, save_policy
from magical_mj.learners.ppo import PPO, RewardNormaliser, even_minibatches
from magical_mj.learners.settings import TrainingSettings
from magical_mj.learners.vector_envs import training_envs
from magical_mj.policies.interface import Episode
from tests.helpers.learners import playing

CPU = torch.device("cpu")


def improver(settings: TrainingSettings) -> PPO:
    with seeded(settings.seed):
        actor = Actor(settings.network, len(settings.tasks))
        critic = Heads(len(settings.tasks), actor.torso.features, 1)
        generator = torch.Generator().manual_seed(0)
        return PPO(settings, training_envs(settings), actor, critic, generator)


@pytest.fixture
def ppo() -> Iterator[PPO]:
    learner = improver(playing())
    yield learner
    learner.environments.close()


def test_copies_are_split_evenly_between_tasks() -> None:
    environments = training_envs(playing(tasks="MoveToRegion,FixColour"))
    assert environments.tasks.tolist() == [0, 0, 1, 1]
    observations = environments.reset()
    assert observations.shape == (4, 96, 96, 12)
    assert observations.dtype == np.uint8
    environments.close()


def test_copies_start_at_different_times_of_their_episodes() -> None:
    """Copies of each of the tasks, whose episodes have 40 steps: two of them begin in the middle of one."""
    environments = training_envs(playing(tasks="MoveToRegion,MoveToCorner"))
    environments.reset()
    assert [len(state["actions"]) for state in environments.get_state()] == [0, 20, 0, 40]
    environments.close()


def test_an_episode_that_ends_is_truncated_and_the_next_one_begins() -> None:
    environments = training_envs(playing())
    environments.reset()
    ends = []
    for _ in range(40):
        step = environments.step(np.ones(4, int))
        ends.append(step.ended)
    assert np.sum(ends, axis=0).tolist() == [1, 1, 1, 1]
    assert [int(np.argmax(end)) for end in np.transpose(ends)] == [39, 29, 19, 9]
    assert step.ended.tolist() == [True, False, False, False]
    assert not step.broken.any()
    assert step.last.shape == (4, 96, 96, 12)
    assert not np.array_equal(step.last[0], step.observations[0])
    assert 0 <= step.scores[0] <= 1
    assert [state["episode"] for state in environments.get_state()] == [1, 1, 1, 1]
    environments.close()


def test_environments_are_restored_in_mid_episode() -> None:
    settings = playing(tasks="MoveToRegion,FixColour", preset="State")
    first, second = training_envs(settings), training_envs(settings)
    rng = np.random.default_rng(0)
    first.reset()
    for _ in range(30):
        seen = first.step(rng.integers(18, size=4)).observations
    np.testing.assert_array_equal(second.set_state(first.get_state()), seen)
    for _ in range(30):
        actions = rng.integers(18, size=4)
        for ours, theirs in zip(first.step(actions), second.step(actions), strict=True):
            np.testing.assert_array_equal(ours, theirs)
    first.close()
    second.close()


def test_minibatches_are_even_over_tasks() -> None:
    """Every sample comes once, and each minibatch of 8 has two or three of each of three tasks."""
    tasks = np.repeat([0, 1, 2], 2)
    generator = torch.Generator().manual_seed(0)
    before = np.random.get_state()[1]  # noqa: NPY002
    batches, again = ([batch.numpy() for batch in even_minibatches(tasks, 4, 8, generator)] for _ in range(2))
    assert sorted(np.concatenate(batches)) == list(range(24))  # 6 x step + environment
    assert not np.array_equal(batches, again)
    for batch in batches:
        assert set(np.bincount(tasks[batch % 6])) <= {2, 3}
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002


def test_rollouts_are_drawn_evenly_over_tasks() -> None:
    numbers = np.arange(24, dtype=np.uint8).reshape(4, 6)  # 6 x step + copy
    images = np.broadcast_to(numbers[..., None, None, None], (4, 6, 1, 1, 1))
    rollout = Rollout(*map(torch.as_tensor, (images.copy(), numbers.astype(np.int64), np.repeat([0, 1], 3))))
    generator = torch.Generator().manual_seed(0)
    drawn = [rollout.sample(6, generator) for _ in range(50)]
    for batch in drawn:
        assert batch.tasks.tolist() == [0, 0, 0, 1, 1, 1]
        np.testing.assert_array_equal(batch.observations[:, 0, 0, 0], batch.actions)
        np.testing.assert_array_equal(batch.actions % 6 // 3, batch.tasks)
    assert {int(action) for batch in drawn for action in batch.actions} == set(range(24))
    whole = list(rollout.batches(10))
    assert [len(batch.actions) for batch in whole] == [10, 10, 4]
    assert torch.cat([batch.actions for batch in whole]).tolist() == list(range(24))
    assert torch.cat([batch.tasks for batch in whole]).tolist() == 4 * [0, 0, 0, 1, 1, 1]


def test_pictures_are_scaled_once_and_stay_fast(ppo: PPO) -> None:
    """What the torso gets is exactly what `as_input` makes of the stacks, channels last in memory."""
    got = []
    ppo.policy.actor.torso.register_forward_pre_hook(lambda _, inputs: got.append(inputs[0]))
    rollout = ppo.collect()
    ppo.improve(np.zeros((4, 4), np.float32))
    assert len(got) == 4 + 1 + 4  # collecting; its last values; two epochs of two minibatches
    for stacks in got:
        assert stacks.is_contiguous(memory_format=torch.channels_last)
        assert stacks.max() <= 1
    np.testing.assert_array_equal(got[0], as_input(rollout.observations[0], CPU))


def test_the_saved_policy_has_the_logits_of_the_one_that_plays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "set_num_threads", lambda _: None)  # sums of the tests after this would differ in bits
    settings = playing(tasks="MoveToRegion,FixColour")
    ppo = improver(settings)
    ppo.collect()
    ppo.improve(np.random.default_rng(0).normal(size=(4, 4)).astype(np.float32))
    seen, tasks, actor = ppo.environments.reset(), torch.tensor([0, 0, 1, 1]), ppo.policy.actor
    save_policy(tmp_path, actor, settings)
    saved = load_policy(tmp_path)
    with torch.inference_mode():
        logits = ppo.policy(seen, tasks)[0].logits
        theirs = saved.actor(as_input(seen, CPU), tasks).log_softmax(1)
        np.testing.assert_array_equal(actor(as_input(seen, CPU), tasks).log_softmax(1), theirs)
    torch.testing.assert_close(logits, theirs, rtol=0, atol=1e-4)  # rows of another length; an update changes 7e-3
    assert logits.shape == (4, ONE_HOT)
    saved.reset_batch([Episode("FixColour", "Demo", 0, 0)] * 2)
    assert saved.act_batch(seen[2:]).shape == (2,)
    ppo.environments.close()


def test_a_task_trains_its_own_heads_only() -> None:
    """PPO's loss for samples of the second task has no gradient in the first task's heads."""
    ppo = improver(playing(tasks="MoveToRegion,FixColour"))
    distributions, values = ppo.policy(ppo.environments.reset()[2:], torch.tensor([1, 1]))
    (values.sum() + distributions.log_prob(torch.tensor([3, 4])).sum() + distributions.entropy().sum()).backward()
    for heads in (ppo.policy.actor.head, ppo.policy.critic):
        for weights in heads.parameters():
            assert weights.grad is not None
            assert not weights.grad[0].any()
            assert weights.grad[1].any()
    assert ppo.policy.actor.torso.linear[0].weight.grad.any()
    ppo.environments.close()


def test_new_policies_tell_pictures_apart() -> None:
    """Before its ReLU, each unit has mean 0 and deviation 1 over the stacks; untouched, it hardly depends on them."""
    data = TrainingData(playing(), drop_noop=False)
    stacks = as_input(data.rows([torch.arange(data.sizes[0])]).observations, CPU)
    with seeded(0):
        torso = Torso(playing().network)
    assert torso.linear[:3](torso.convolutions(stacks).flatten(1)).std(0).max() < 0.1
    standardise(torso, stacks)
    values = stacks
    for layer in (*torso.convolutions, torch.nn.Flatten(), *torso.linear):
        values = layer(values)
        if isinstance(layer, torch.nn.Conv2d | torch.nn.Linear):
            by_unit = values.detach().transpose(0, 1).flatten(1)
            torch.testing.assert_close(by_unit.mean(1), torch.zeros(len(by_unit)), rtol=0, atol=1e-3)
            seen = by_unit.std(1) > 1e-3  # all but units that get nothing from the few before them
            torch.testing.assert_close(by_unit[seen].std(1), torch.ones(int(seen.sum())), rtol=1e-3, atol=0)
            assert seen.float().mean() > 0.8


def test_rewards_from_outside_become_returns(ppo: PPO) -> None:
    """Generalised advantages by definition. The value of a truncated episode's last state is added to its reward."""
    rng = np.random.default_rng(0)
    for _ in range(3):  # in the third rollout, the steps 9 to 12, the last copy's first episode ends
        ppo.collect()
    rewards = rng.normal(size=(4, 4)).astype(np.float32)
    steps, gamma, decay = ppo.steps, ppo.settings.discount, ppo.settings.discount * ppo.settings.gae_lambda
    with torch.no_grad():
        following = ppo.policy(ppo.observations, torch.zeros(4, dtype=torch.int64))[1].numpy()
    assert np.flatnonzero(steps.bootstrap).tolist() == np.flatnonzero(steps.ended).tolist() == [1 * 4 + 3]
    expected, after = np.zeros((4, 4)), np.zeros(4)
    for step in (3, 2, 1, 0):
        goes_on = ~steps.ended[step]
        error = rewards[step] + steps.bootstrap[step] + gamma * following * goes_on - steps.values[step]
        after = error + decay * goes_on * after
        expected[step], following = after, steps.values[step]
    np.testing.assert_allclose(ppo.advantages(rewards), expected, atol=1e-4)  # of float32; values are about 6e-3


def test_the_learning_rate_falls_to_zero(ppo: PPO) -> None:
    """From the settings' rate in the first of four updates by equal steps: it is 0 after the last."""
    rates = []
    for _ in range(4):
        ppo.collect()
        ppo.improve(np.zeros((4, 4), np.float32))
        rates.append(ppo.optimizer.param_groups[0]["lr"])
    np.testing.assert_allclose(rates, 3e-4 * np.array([1, 0.75, 0.5, 0.25]))


def test_the_score_is_that_of_the_last_episodes_that_ended(ppo: PPO) -> None:
    ppo.score = 0.125
    scores = []
    for _ in range(4):
        ppo.collect()
        scores.append(ppo.improve(np.zeros((4, 4), np.float32))["score"])
    assert scores[:2] == [0.125, 0.125]  # nothing has ended yet
    assert scores[2] in (0.0, 1.0)  # MoveToRegion's, of the one that has
    assert scores[3] == scores[2]


def test_rewards_are_normalised_by_all_of_their_task_so_far() -> None:
    tasks = np.array([0, 0, 1, 1])
    normalise = RewardNormaliser(0.1, tasks)
    rng = np.random.default_rng(0)
    sizes = np.array([1.0, 1.0, 50.0, 50.0])
    first, second = rng.normal(5, 3, (8, 4)) * sizes, rng.normal(9, 1, (8, 4)) * sizes
    normalise(first)
    so_far, expected = np.concatenate([first, second]), np.empty((8, 4))
    for task in (0, 1):
        own = so_far[:, tasks == task]
        expected[:, tasks == task] = (second[:, tasks == task] - own.mean()) / own.std() * 0.1
    np.testing.assert_allclose(normalise(second), expected, atol=1e-4)
    other = RewardNormaliser(0.1, tasks)
    other.set_state(normalise.get_state())
    np.testing.assert_array_equal(other(first), normalise(first))
    same = RewardNormaliser(0.1, tasks)(np.full((100, 4), 7.0))
    assert np.abs(same).max() < 1e-3
