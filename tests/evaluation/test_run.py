"""Playing: equal scores in all configurations, failures that affect one episode, and workers that die."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pandas as pd
import pytest

import magical_mj
from magical_mj.evaluation import Episode, EpisodeResult, Evaluation, EvaluationSettings, rollouts
from magical_mj.evaluation.scores import read
from magical_mj.policies.interface import LETTERS, actions_of
from magical_mj.utils.errors import EvaluationError, MissingExtraError, SettingsError, UnknownNameError
from magical_mj.utils.parallel import map_unordered
from tests.helpers import agents
from tests.helpers.agents import Acting
from tests.helpers.evaluations import evaluate

# scores are equal


def test_evaluations_that_take_turns_keep_their_policies() -> None:
    settings = EvaluationSettings(tasks="MoveToRegion", variants="Demo", episodes=3, preset="State", jobs=1)
    first, second = (Evaluation({"mine": agents.Stubborn(action)}, settings).play() for action in (1, 2))
    letters = [score.actions[0] for pair in zip(first, second, strict=True) for score in pair]
    assert letters == [LETTERS[1], LETTERS[2]] * 3


def test_policies_act_in_the_thread_that_evaluates() -> None:
    """As in a user's own loop, so that debuggers and signals work."""
    threads: set[int] = set()
    evaluate(Acting(lambda _: threads.add(threading.get_ident()) or 1), episodes=1, jobs=1)
    assert threads == {threading.get_ident()}


def test_scores_are_those_of_a_plain_loop() -> None:
    frame = magical_mj.evaluate(agents.Counting, tasks="MoveToRegion", variants="All", episodes=1)
    env = gymnasium.make("magical_mj/MoveToRegion-TestAll-LoRes4E-v0")
    for row in frame.itertuples():
        policy = agents.Counting()
        policy.reset(Episode("MoveToRegion", "All", row.seed))
        observation, info = env.reset(seed=row.seed)
        taken, done = [], False
        while not done:
            taken.append(policy(observation))
            observation, _, _, done, info = env.step(taken[-1])
        assert (row.score, row.steps, actions_of(row.actions)) == (info["eval_score"], 40, taken)


def test_playing_continues_where_it_was_left(tmp_path: Path) -> None:
    evaluation, late = (
        Evaluation(
            "noop", EvaluationSettings(tasks="FixColour", variants="Demo", episodes=3, out=tmp_path, resume=True)
        )
        for _ in range(2)
    )
    first = next(evaluation.play())
    assert [score.seed for score in evaluation.play()] == [1, 2]
    assert read(tmp_path) == evaluation.scores
    assert evaluation.scores[0] == first
    assert list(late.play()) == []
    assert late.scores == evaluation.scores


def test_order_and_company_do_not_matter() -> None:
    together = evaluate("random,noop", episodes=4)
    for policy in ("random", "noop"):
        alone = evaluate(policy, episodes=4)
        pd.testing.assert_frame_equal(alone, together[together["policy"] == policy].reset_index(drop=True))


def test_rows_are_in_the_order_of_the_arguments(tmp_path: Path) -> None:
    """Also of a resumed evaluation that began with fewer episodes in another order."""
    policies = {"still": agents.Stubborn(0), "ahead": agents.Stubborn(1)}
    where = {"preset": "State", "jobs": 1, "out": tmp_path, "shifts": "friction:1,slip:1"}
    evaluate(policies, **where, tasks="MoveToRegion", variants="Demo", episodes=1)
    where = {**where, "tasks": "FixColour,MoveToRegion", "variants": "Layout,Demo", "episodes": 2, "resume": True}
    rows = magical_mj.evaluate(policies, **where)[["policy", "task", "variant", "seed", "shift"]]
    wanted = product(
        policies, ("FixColour", "MoveToRegion"), ("Layout", "Demo"), range(2), ("", "friction:1", "slip:1")
    )
    assert list(rows.itertuples(index=False, name=None)) == list(wanted)


def test_runs_of_random_differ_and_are_the_same_again() -> None:
    first, second = (evaluate({"luck": ["random", "random"]}, tasks="FixColour") for _ in range(2))
    pd.testing.assert_frame_equal(first, second)
    assert set(first["run"]) == {0, 1}
    assert first[first["run"] == 0]["actions"].tolist() != first[first["run"] == 1]["actions"].tolist()
    later = evaluate({"luck": "random"}, tasks="FixColour", run=1)
    pd.testing.assert_frame_equal(later, first[first["run"] == 1].reset_index(drop=True))


def test_two_jobs_give_the_same_as_one() -> None:
    policies = {"blind": "random", "seeing": agents.Counting, "named": "tests.helpers.agents:Batch"}
    pd.testing.assert_frame_equal(evaluate(policies, episodes=12, jobs=2), evaluate(policies, episodes=12, jobs=1))


class OnlyBatch:
    """The two methods of a policy for batches, and nothing else."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        self.size = len(episodes)

    def act_batch(self, observations: Any) -> list[int]:
        assert len(observations) == self.size
        return [agents.look(observation) for observation in observations]


def test_a_policy_for_batches_plays_side_by_side_and_does_the_same() -> None:
    batch, given, single = (evaluate({"look": policy}) for policy in (OnlyBatch, OnlyBatch(), agents.look))
    pd.testing.assert_frame_equal(batch, single)
    pd.testing.assert_frame_equal(given, single)


def test_a_policy_for_batches_plays_in_a_single_environment_too() -> None:
    episodes = [Episode("MoveToRegion", "Demo", seed) for seed in range(2)]
    env = gymnasium.make("magical_mj/MoveToRegion-Demo-State-v0")
    alone = list(rollouts(env, OnlyBatch(), episodes))
    assert [row.actions for row in alone] == [row.actions for row in rollouts(env, agents.look, episodes)]
    where = {"tasks": "MoveToRegion", "variants": "Demo", "preset": "State", "episodes": 2, "jobs": 1}
    wrapped = magical_mj.evaluate(OnlyBatch(), wrap="gymnasium.wrappers:RecordEpisodeStatistics", **where)
    assert wrapped["actions"].tolist() == [row.actions for row in alone]


def test_dict_observations_side_by_side() -> None:
    class Centre:
        def reset_batch(self, episodes: Any) -> None: ...

        def act_batch(self, observations: dict[str, np.ndarray]) -> list[int]:
            assert observations["ego"].shape[1:] == (96, 96, 12)
            return [int(picture.sum()) % 18 for picture in observations["allo"]]

        def __call__(self, observation: dict[str, np.ndarray]) -> int:
            return int(observation["allo"].sum()) % 18

    settings = {"preset": "LoResStack", "episodes": 2, "variants": "Demo"}
    batch, single = (evaluate({"centre": policy}, **settings) for policy in (Centre(), Centre().__call__))
    pd.testing.assert_frame_equal(batch, single)


def test_rules_reach_the_scores() -> None:
    """Without moving, ClusterShape's demo scores 0.25 in 320 steps by the paper's rules, and 0 in 240 by the code's."""
    for rules, expected in (("paper", (0.25, 320)), ("released", (0.0, 240))):
        frame = evaluate("noop", tasks="ClusterShape", variants="Demo", episodes=1, rules=rules)
        assert (frame["score"].item(), frame["steps"].item()) == expected


def test_a_policy_may_learn_between_evaluations() -> None:
    policy = agents.Stubborn()
    settings: dict[str, Any] = {"preset": "State", "variants": "Demo", "episodes": 2}
    assert set(evaluate(policy, **settings)["actions"]) == {"a" * 40}
    policy.action = 5
    assert set(evaluate(policy, **settings)["actions"]) == {"f" * 40}


def test_policies_that_can_be_closed_are_left_open() -> None:
    policies = {str(action): agents.Stubborn(action) for action in (3, 4)}  # they alternate
    assert evaluate(policies, preset="State")["failure"].isna().all()


# failures


def test_a_failing_policy_costs_only_its_episodes() -> None:
    """Calls that do not return are ended with their worker process, even if they block all other threads."""
    policy = "tests.helpers.agents:Trouble"
    frame = evaluate(policy, variants="Demo", episodes=17, time_limit=1.0, jobs=2).set_index("seed")
    good = frame.loc[range(0, 17, 2)]
    assert good["failure"].isna().all()
    assert (good["steps"] == 40).all()
    reasons = {
        1: "RuntimeError: lost its way",
        3: "18 is not an action",
        5: "TimeLimitError: no end within 1 s",
        7: "TimeLimitError: no end within 1 s",
        9: "TimeLimitError: no end within 1 s",
        11: "None is not an action",
        13: "is not an action",
        15: "is not an action",
    }
    for seed, reason in reasons.items():
        assert frame.loc[seed, "score"] == 0
        assert reason in frame.loc[seed, "failure"]


def test_a_slow_policy_fails_at_its_next_action_in_this_process() -> None:
    policy = agents.Slower()
    policy.usual = 0.01
    frame = evaluate(policy, variants="Demo", time_limit=1.5, jobs=1)
    assert frame["failure"].isna().tolist() == [True, False, True]
    assert frame["failure"][1] == "TimeLimitError: no end within 1.5 s"
    assert 2 < frame["steps"][1] <= 6
    assert frame["steps"].tolist()[::2] == [40, 40]


class SlowBatch(agents.Batch):
    """Does not return if the scene of seed 1 is in its batch."""

    def reset_batch(self, episodes: Any) -> None:
        self.reset(max(episodes, key=lambda episode: episode.seed == 1))

    def reset(self, episode: Episode) -> None:
        if episode.seed == 1:
            time.sleep(1000)


def test_of_a_batch_that_takes_too_long_only_the_slow_episode_fails() -> None:
    frame = evaluate({"look": SlowBatch()}, time_limit=1.0, jobs=2, episodes=2, variants="Demo")
    assert frame["failure"].isna().tolist() == [True, False]
    assert frame["failure"][1] == "TimeLimitError: no end within 1 s"
    good = evaluate(agents.look, episodes=1, variants="Demo")
    assert frame["actions"][0] == good["actions"][0]


def test_one_failure_in_a_batch_does_not_fail_the_others() -> None:
    class Half(agents.Batch):
        def reset(self, episode: Episode) -> None:
            self.seed = episode.seed

        def reset_batch(self, episodes: Any) -> None:
            if any(episode.seed == 1 for episode in episodes):
                raise ValueError("not this one")

        def __call__(self, observation: Any) -> int:
            if self.seed == 1:
                raise ValueError("not this one")
            return super().__call__(observation)

    played = evaluate(Half())
    assert played["failure"].notna().tolist() == [False, True, False] * 2
    others = (
        scores[scores["seed"] != 1].drop(columns="failure") for scores in (played, evaluate({"Half": agents.look}))
    )
    pd.testing.assert_frame_equal(*others)


def test_a_policy_that_exits_has_failed() -> None:
    frame = evaluate("tests.helpers.agents:Leaving", preset="State", variants="Demo")
    assert frame["failure"].isna().tolist() == [True, False, True]
    assert frame["failure"][1].startswith("SystemExit: enough (agents.py, line ")


def test_an_interruption_ends_the_episode_and_keeps_those_before(tmp_path: Path) -> None:
    def interrupting(episode: Episode) -> None:
        if episode.seed == 2:
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        evaluate({"P": Acting(reset=interrupting)}, variants="Demo", out=tmp_path)
    assert [score.seed for score in read(tmp_path)] == [0, 1]
    frame = evaluate({"P": Acting()}, variants="Demo", out=tmp_path, resume=True)
    assert frame["failure"].isna().tolist() == [True] * 3


# selection of policies, tasks and scenes


@pytest.mark.parametrize(
    ("policy", "settings", "hint"),
    [
        ("rndom", {}, "Did you mean 'random'"),
        ("", {}, "give a policy"),
        ("BC=", {}, "BC= lacks a policy after the ="),
        (3, {}, "3 is not a policy"),
        (Path("missing.zip"), {}, "the file missing.zip does not exist"),
        ("no_such_module:thing", {}, "the policy 'no_such_module:thing' cannot be imported"),
        ("tests.helpers.agents:nothing", {}, "tests.helpers.agents has no 'nothing'"),
        ("tests.helpers.agents:NOT_CALLABLE", {}, "is of the type int, and cannot be called"),
        ("noop", {"tasks": "FindDup"}, "Did you mean 'FindDupe'"),
        ("noop", {"tasks": ""}, "at least one of"),
        ("noop", {"variants": "Color"}, "Did you mean 'Colour'"),
        ("noop", {"tasks": "MoveToRegion", "variants": "Shape"}, "It has: Demo"),
        ("noop", {"preset": "LoRes5E"}, "LoRes4E"),
        ("noop", {"backend": "slurm"}, "local, dask"),
        ("noop", {"backend": "dask"}, "needs the scheduler's address"),
        ("noop", {"address": "tcp://there:1"}, "choose the dask backend"),
        ("noop", {"device": "cpu"}, "give --simulator warp"),
        ("noop", {"episods": 3}, "Did you mean 'episodes'"),
        ("noop", {"resume": True}, "give out as well"),
        ("noop", {"retry_failed": True}, "give resume as well"),
        ("noop", {"retry_failed": True, "out": Path("o")}, "give resume as well"),
        ("tests.helpers.agents:Needy", {}, "is a class, and creating an instance without arguments fails: TypeError"),
        (agents.Needy, {}, "is a class, and creating an instance without arguments fails: TypeError"),
        ("leaving:act", {}, "cannot be imported: SystemExit: 3"),
        (Acting(thing=threading.Lock()), {"jobs": 2}, "cannot be sent to other processes (TypeError"),
        (
            Acting(thing=ctypes.pointer(ctypes.c_int())),
            {"jobs": 2},
            "cannot be sent to other processes (ValueError",
        ),
        (Acting(observation_shapes=[(97,)]), {}, "observations of shape (97,), and State gives"),
        (
            Acting(observation_shapes=[(None, 96, 12)]),
            {"preset": "State"},
            "give --preset LoRes4E or LoRes4A or LoRes3EA",
        ),
        (Acting(observation_shapes=[(96, 96, 12)]), {"preset": ""}, "gives a dict: give --preset LoRes4E"),
    ],
)
def test_bad_settings_are_explained(
    policy: Any, settings: dict[str, Any], hint: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "leaving.py").write_text("import sys\nsys.exit(3)\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises((SettingsError, UnknownNameError)) as caught:
        evaluate(policy, **settings)
    assert hint in str(caught.value)


SETTINGS: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 12}


def rows(scores: list[EpisodeResult]) -> list[Any]:
    return sorted((score.key, score.score, score.actions, score.failure) for score in scores)


def meet(folder: Path, patience: float, number: int) -> bool:
    """Whether another unit runs at the same time, in any process."""
    (folder / str(number)).touch()
    start = time.monotonic()
    while not (met := len(list(folder.iterdir())) > 1) and time.monotonic() - start < patience:
        time.sleep(0.01)
    time.sleep(0.1)  # the other process checks as well
    (folder / str(number)).unlink()
    return met


@pytest.mark.weekly
@pytest.mark.filterwarnings("ignore")  # warnings of the libraries
def test_dask_works_on_the_cluster_and_survives_the_loss_of_a_worker(tmp_path: Path) -> None:
    """Plays at most the given number of units at once. One of two workers is killed after the first scores."""
    distributed = pytest.importorskip("distributed")
    magical_mj.evaluate("random,Slow=noop", out=tmp_path / "here", **SETTINGS)  # acts the same, but faster
    killed: list[int] = []
    stored: list[int] = []
    here = distributed.dask.config.set({"temporary-directory": str(tmp_path)})  # it leaves a folder there
    with (
        here,
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            dashboard_address=None,
            env={"PYTHONPATH": str(Path(__file__).parents[2])},
        ) as cluster,
    ):
        address = cluster.scheduler_address
        (tmp_path / "pieces").mkdir()
        for jobs, patience in ((1, 0.1), (None, 60)):
            pieces = map_unordered(partial(meet, tmp_path / "pieces", patience), range(2), jobs, "dask", address)
            assert list(pieces) == [jobs is None] * 2

        def kill_one(_: EpisodeResult) -> None:
            stored.append(len(read(tmp_path / "there")))
            if not killed:
                killed.append(next(iter(cluster.workers.values())).process.pid)
                os.kill(killed[0], signal.SIGKILL)

        magical_mj.evaluate(
            "random,tests.helpers.agents:Slow",
            out=tmp_path / "there",
            jobs=None,
            backend="dask",
            address=address,
            watch=kill_one,
            **SETTINGS,
        )
    assert killed
    assert len(set(stored)) > 30, "each episode as it ends, but for those that are held back until one has succeeded"
    assert rows(read(tmp_path / "there")) == rows(read(tmp_path / "here"))


@pytest.mark.filterwarnings("ignore")
def test_dask_cluster_without_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr("magical_mj.utils.parallel.PATIENCE", 0.1)
    with (
        distributed.dask.config.set({"temporary-directory": str(tmp_path)}),
        distributed.LocalCluster(n_workers=0, dashboard_address=None) as cluster,
        pytest.raises(EvaluationError, match="the dask cluster has no workers: start some with `dask worker tcp"),
    ):
        magical_mj.evaluate("noop", backend="dask", address=cluster.scheduler_address, **SETTINGS)


@pytest.mark.filterwarnings("ignore")
def test_a_cluster_that_is_not_there(tmp_path: Path) -> None:
    """An invalid address is reported before anything is started."""
    distributed = pytest.importorskip("distributed")
    with distributed.dask.config.set({"distributed.comm.timeouts.connect": "1s"}):
        for address in ("tcp://127.0.0.1:9", "foo://127.0.0.1:9"):
            with pytest.raises(EvaluationError, match=rf"no dask scheduler answers at {address}"):
                magical_mj.evaluate("noop", backend="dask", address=address, **SETTINGS)
    for address in ("localhost", "tcp://h:notaport", "tcp://h", "http://h:1/path"):
        with pytest.raises(SettingsError, match="needs the scheduler's address"):
            magical_mj.evaluate("noop", backend="dask", address=address, out=tmp_path / "out", **SETTINGS)
    assert not (tmp_path / "out").exists()


def test_a_dead_worker_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its unit is played again, so the scores are those of an evaluation without a crash."""
    mark = tmp_path / "mark"
    monkeypatch.setenv("FATAL_MARK", str(mark))
    frame = magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=2, out=tmp_path / "dying", **SETTINGS)
    assert mark.exists()
    assert isinstance(frame, pd.DataFrame)
    assert frame["seed"].tolist() == 2 * list(range(SETTINGS["episodes"]))
    magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=1, out=tmp_path / "living", **SETTINGS)
    assert rows(read(tmp_path / "dying")) == rows(read(tmp_path / "living"))


def test_a_policy_that_kills_every_worker_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mark").write_text("always")
    monkeypatch.setenv("FATAL_MARK", str(tmp_path / "mark"))
    with pytest.raises(EvaluationError, match=r"3 worker processes died .*SIGKILL.* --resume continues"):
        magical_mj.evaluate("tests.helpers.agents:Fatal", jobs=2, **SETTINGS)


def test_missing_extras_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtraError, match=r"\[dask\]"):
        magical_mj.evaluate("noop", backend="dask", address="tcp://127.0.0.1:9", **SETTINGS)
    monkeypatch.setattr("magical_mj.utils.extras.find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=r"pip install .*\[eval\]"):
        magical_mj.evaluate("noop", **SETTINGS)


def test_a_policy_has_the_name_that_it_is_given() -> None:
    """Several policies are runs of one method. Names in a mapping are not replaced."""
    actions = [lambda _: 0, lambda _: 1]
    scores = evaluate(actions, name="BC", variants="Demo", episodes=1, jobs=1)
    assert scores[["policy", "run"]].to_numpy().tolist() == [["BC", 0], ["BC", 1]]
    with pytest.raises(SettingsError, match=r"have names already \(A\): leave out name"):
        evaluate({"A": "noop"}, name="BC")
