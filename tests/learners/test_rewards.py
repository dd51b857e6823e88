"""`evaluate-reward`: its two figures for known rewards, and the learnt ones of all methods."""

from __future__ import annotations

import json
import lzma
from pathlib import Path
from typing import cast

import numpy as np
import pandas as pd
import pytest
import torch
from torch import Tensor

from magical_mj import demos
from magical_mj.evaluation import evaluate
from magical_mj.leaderboard import check_entries, read_entry, submit, verify
from magical_mj.learners import METHODS, train
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.policy import load_policy
from magical_mj.learners.rewards import (
    KINDS,
    OnLearntReward,
    agreement,
    agreements,
    evaluate_rewards,
    learner_of_reward,
    learns_reward,
    rewards,
)
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.facts import Learnt
from magical_mj.utils.errors import EvaluationError, SettingsError, TrainingError, UnknownNameError
from tests.helpers.commands import Shell
from tests.helpers.learners import check_resumes, from_states, playing, stopped

NAMES = ("robot.x", "robot.y", "region0.x_min", "region0.y_min", "region0.x_max", "region0.y_max")
X, Y, *BOX = (STATE_NAMES.index(name) for name in NAMES)


class Scored(BehaviouralCloning):
    """Its reward is the change of MoveToRegion's score, so that an episode's sum is its score."""

    learns_reward = True

    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        def inside(states: Tensor) -> Tensor:
            now = states[:, -1]
            x_min, y_min, x_max, y_max = (now[:, index] for index in BOX)
            x, y = now[:, X], now[:, Y]
            return ((x_min < x) & (x < x_max) & (y_min < y) & (y < y_max)).float()

        return inside(following) - inside(observations)


class Constant(BehaviouralCloning):
    learns_reward = True

    def learnt_reward(self, observations: Tensor, following: Tensor, actions: Tensor, tasks: Tensor) -> Tensor:
        return torch.ones(len(actions))


@pytest.mark.parametrize(("method", "wanted"), [(Scored, (1.0, 1.0)), (Constant, (0.0, 0.5))])
def test_the_score_itself_agrees_fully_and_a_constant_not_at_all(
    method: type[BehaviouralCloning], wanted: tuple[float, float]
) -> None:
    learner = method(from_states())
    episodes = demos.load("MoveToRegion", set="graded")
    sums = [float(rewards(learner, episode).sum()) for episode in episodes]
    assert agreement(sums, [episode.score for episode in episodes]) == pytest.approx(wanted)


def test_the_figures_treat_ties_as_half() -> None:
    assert agreement([3, 2, 2, 1], [1.0, 1.0, 0.0, 0.0])[1] == pytest.approx(3.5 / 4)
    assert agreement([1, 2, 3], [0.1, 0.5, 0.5])[0] == pytest.approx(np.sqrt(0.75))
    assert agreement([3, 2, 1], [0.0, 0.5, 1.0]) == pytest.approx((-1.0, 0.0))
    assert np.isnan(agreement([1, 2], [1.0, 1.0])).all()
    assert np.isnan(agreement([1, 2], [0.0, 0.5])[1])


def test_the_rewards_of_all_methods_are_judged_on_the_same_episodes(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    playing_methods = ("gail", "airl", "wgail-gp", "al")
    for method in playing_methods:
        train(playing(method, preset="State"), tmp_path / method)
    for method in ("iq-learn", "bc"):
        train(from_states(method=method), tmp_path / method)
    rewarding = {*playing_methods, "iq-learn"}
    runs = [str(tmp_path / method) for method in (*playing_methods, "iq-learn", "bc")]
    options = ("--variants", "Layout", "--scenes", "2", "--jobs", "1", "--out", "sums.csv")
    code, output, _ = shell("evaluate-reward", *runs, *options)
    assert code == 0
    assert all(name in output for name in (*rewarding, "Layout"))
    frame = pd.read_csv("sums.csv")
    assert set(frame["method"]) == rewarding == set(filter(learns_reward, METHODS))
    assert set(frame["kind"]) == set(KINDS)
    assert set(frame.loc[frame["kind"] == "policy", "player"]) == {*rewarding, "bc"}
    scores = {method: group["score"].tolist() for method, group in frame.groupby("method")}
    assert len({tuple(row) for row in scores.values()}) == 1
    assert set(frame.loc[frame["kind"] == "expert", "score"]) == {1.0}
    assert frame["seed"].min() >= 10_000_000
    found = agreements(frame)
    assert len(found) == len(rewarding)
    assert found["auc"].between(0, 1).all()
    assert frame.groupby("method")["sum"].nunique().min() >= 6  # tiny policies may play equal episodes


def test_trainings_without_a_reward_are_refused(tmp_path: Path) -> None:
    train(from_states(), tmp_path / "bc")
    with pytest.raises(SettingsError, match=r"none of these trainings has learnt a reward: give a training of .*gail"):
        evaluate_rewards(str(tmp_path / "bc"))
    with pytest.raises(SettingsError, match=r"nowhere is not the folder of a training: it has no config\.toml"):
        evaluate_rewards([tmp_path / "nowhere"])
    with pytest.raises(SettingsError, match="is given twice, and its episodes would count double"):
        evaluate_rewards([tmp_path / "bc", tmp_path / "bc" / ".." / "bc"])
    with pytest.raises(SettingsError, match=r"scenes must be an integer of at least 1, not 1\.5"):
        evaluate_rewards([tmp_path / "bc"], scenes=cast("int", 1.5))
    stopped(tmp_path / "gail", playing("gail", preset="State"))
    with pytest.raises(TrainingError, match="is not finished: --resume continues it"):
        evaluate_rewards([tmp_path / "gail"], "Demo", 1)


def test_ppo_learns_from_a_learnt_reward_in_another_variant(tmp_path: Path) -> None:
    train(playing("gail", preset="State"), tmp_path / "gail")
    settings = playing("ppo", preset="State", **{"reward.run": tmp_path / "gail", "reward.variant": "Layout"})
    learner = OnLearntReward(settings)
    starts = learner.environments.reset()[:, -1]
    assert len({tuple(box) for box in starts[:, BOX].tolist()}) == len(starts)  # each has a layout of its own
    reward = learner_of_reward(tmp_path / "gail", playing("gail", preset="State"))
    rollout = learner.collect()
    batch = learner.on_device(next(rollout.batches(16)))
    expected = reward.learnt_reward(batch[0][:, :-1], batch[0][:, 1:], *batch[1:])
    torch.testing.assert_close(learner.reward(*batch), expected)
    learner.close()
    reward.close()
    check_resumes("ppo", {"preset": "State", "reward.run": tmp_path / "gail", "reward.variant": "Layout"}, tmp_path)


def test_an_entry_declares_that_its_policies_played_in_a_test_variant(tmp_path: Path) -> None:
    """An evaluation records it, and an entry keeps it when its card changes."""
    train(from_states(method="iq-learn"), tmp_path / "iq")
    for variant in ("Demo", "Layout"):
        chosen = {"preset": "State", "reward.run": tmp_path / "iq", "reward.variant": variant}
        train(playing("ppo", **chosen), tmp_path / variant)
    card = tmp_path / "card.toml"
    card.write_text('privileges = ["states", "simulator in training"]')
    where = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 1, "jobs": 1}
    for name in ("Demo", "Layout"):
        evaluate({"PPO": tmp_path / name}, out=tmp_path / f"scores of {name}", **where)
        if name != "Demo":
            with pytest.raises(SettingsError, match=r'PPO learnt in scenes of Layout: add "other scenes" to'):
                submit([tmp_path / f"scores of {name}"], tmp_path / "entry.json.xz", card=card)
    assert submit([tmp_path / "scores of Demo"], tmp_path / "demo.json.xz", card=card).played_in == []
    assert b"played_in" not in lzma.decompress((tmp_path / "demo.json.xz").read_bytes())
    card.write_text('method = "PPO"\nprivileges = ["other scenes"]')
    (tmp_path / "entry").mkdir()
    submit([tmp_path / "scores of Layout"], tmp_path / "entry" / "layout.json.xz", card=card)
    card.rename(tmp_path / "entry" / "card.toml")
    assert read_entry(tmp_path / "entry").played_in == ["Layout"]
    assert not check_entries({"": read_entry(tmp_path / "entry")}, jobs=1)[""].unfit
    (tmp_path / "entry" / "card.toml").write_text('method = "PPO"\nprivileges = ["states"]')
    problem = 'it learnt in scenes of Layout: add "other scenes" to the card\'s privileges'
    assert check_entries({"": read_entry(tmp_path / "entry")}, jobs=1)[""].unfit == [problem]
    assert verify(tmp_path / "entry", jobs=1).unfit == [problem]


def test_what_a_policy_learnt_from_is_checked_and_recorded(tmp_path: Path) -> None:
    def policy(_: object) -> int:
        return 0

    for variants in (["All", "Layout"], "all of them"):
        with pytest.raises(SettingsError, match=r"played_in must be variants, .* not"):
            Learnt(played_in=variants)  # pyright: ignore[reportArgumentType]
    policy.learnt = Learnt(played_in="Layout,All")  # pyright: ignore[reportFunctionMemberAccess]
    evaluate({"X": policy}, tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1, out=tmp_path)
    assert json.loads((tmp_path / "run.json").read_text())["policies"][0]["played_in"] == "Layout,All"


def test_an_entry_is_not_made_from_damaged_settings(tmp_path: Path) -> None:
    evaluate("noop", tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1, out=tmp_path)
    (tmp_path / "run.json").write_text((tmp_path / "run.json").read_text().replace('"policies": [', '"policies": [1, '))
    with pytest.raises(EvaluationError, match=r"run\.json"):
        submit([tmp_path], tmp_path / "entry.json.xz")


def test_ppo_records_the_demonstrations_of_its_reward(tmp_path: Path) -> None:
    train(from_states(method="iq-learn", **{"demos.set": 2}), tmp_path / "iq")
    with pytest.raises(SettingsError, match=r"was learnt from demonstrations of set 2: add --set demos\.set=2"):
        train(playing("ppo", preset="State", **{"reward.run": tmp_path / "iq"}), tmp_path / "ppo")


def test_ppo_records_the_other_tasks_of_its_reward(tmp_path: Path) -> None:
    train(from_states(method="iq-learn", tasks="FixColour,MoveToRegion"), tmp_path / "iq")
    train(playing("ppo", preset="State", **{"reward.run": str(tmp_path / "iq")}), tmp_path / "ppo")
    assert load_policy(tmp_path / "ppo").learnt.other_tasks == ["FixColour"]


def test_ppo_does_not_continue_on_another_reward(tmp_path: Path) -> None:
    train(from_states(method="iq-learn"), tmp_path / "iq")
    settings = playing("ppo", **{"preset": "State", "reward.run": str(tmp_path / "iq")})
    stopped(tmp_path / "ppo", settings)
    (tmp_path / "iq").rename(tmp_path / "before")
    train(from_states(method="iq-learn", seed=1), tmp_path / "iq")
    with pytest.raises(TrainingError, match=r"the reward in .* has changed since"):
        train(settings, tmp_path / "ppo", resume=True)


def test_ppo_says_what_reward_it_needs(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match=r"ppo needs a learnt reward: --set reward\.run=RUN"):
        train(playing("ppo", preset="State"), tmp_path / "run")
    train(from_states(), tmp_path / "bc")
    with pytest.raises(SettingsError, match="is a training of bc, which does not learn a reward"):
        train(playing("ppo", **{"preset": "State", "reward.run": str(tmp_path / "bc")}), tmp_path / "run")
    train(from_states(method="iq-learn"), tmp_path / "iq")
    with pytest.raises(SettingsError, match="is for MoveToRegion with the preset State, not for FixColour"):
        train(playing("ppo", "FixColour", preset="State", **{"reward.run": tmp_path / "iq"}), tmp_path / "run")
    chosen = {"preset": "State", "reward.run": tmp_path / "iq", "reward.variant": "Shape"}
    with pytest.raises(UnknownNameError, match="MoveToRegion has no variant 'Shape'"):
        train(playing("ppo", **chosen), tmp_path / "run")
