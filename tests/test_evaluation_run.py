"""Playing: equal scores however it is done, failures that cost one episode, and runs that were killed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import agents
import gymnasium
import numpy as np
import pandas as pd
import pytest
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv

import magical_mj
from magical_mj.errors import EvaluationError, SettingsError, UnknownNameError
from magical_mj.evaluation import Episode, Score, rollouts
from magical_mj.evaluation.episodes import LETTERS, actions_of
from magical_mj.evaluation.scores import SCORES, ScoreFile, read
from magical_mj.evaluation.selection import environments

SMALL: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 3}
TESTS = Path(__file__).parent


def evaluate(policy: Any, **settings: Any) -> pd.DataFrame:
    """All that must not depend on how the episodes were played."""
    return magical_mj.evaluate(policy, **{**SMALL, **settings}).drop(columns="seconds")


def rows(folder: Path) -> set[tuple[Any, ...]]:
    return {(score.key, score.score, score.actions, score.failure) for score in read(folder)}


# equal scores


def test_scores_are_those_of_a_plain_loop() -> None:
    frame = magical_mj.evaluate(agents.Counting, tasks="MatchRegions", variants="All", episodes=2)
    env = gymnasium.make("magical_mj/MatchRegions-TestAll-LoRes4E-v0")
    for row in frame.itertuples():
        policy = agents.Counting()
        policy.reset(Episode("MatchRegions", "All", row.seed))
        observation, info = env.reset(seed=row.seed)
        taken, done = [], False
        while not done:
            taken.append(policy(observation))
            observation, _, _, done, info = env.step(taken[-1])
        assert (row.score, row.steps, actions_of(row.actions)) == (info["eval_score"], 120, taken)


def test_order_and_company_do_not_matter() -> None:
    together = evaluate("random,noop", episodes=4)
    for policy in ("random", "noop"):
        alone = evaluate(policy, episodes=4)
        pd.testing.assert_frame_equal(alone, together[together["policy"] == policy].reset_index(drop=True))


def test_runs_of_random_differ_and_are_the_same_again() -> None:
    first, second = (evaluate({"luck": ["random", "random"]}, tasks="FixColour") for _ in range(2))
    pd.testing.assert_frame_equal(first, second)
    assert set(first["run"]) == {0, 1}
    assert first[first["run"] == 0]["actions"].tolist() != first[first["run"] == 1]["actions"].tolist()
    later = evaluate({"luck": "random"}, tasks="FixColour", run=1)
    pd.testing.assert_frame_equal(later, first[first["run"] == 1].reset_index(drop=True))


def test_two_jobs_give_the_same_as_one() -> None:
    policies = {"blind": "random", "seeing": agents.Counting, "named": "agents:Batch"}
    pd.testing.assert_frame_equal(evaluate(policies, episodes=12, jobs=2), evaluate(policies, episodes=12))


@pytest.mark.parametrize("vectorization", ["sync", "async"])
@pytest.mark.parametrize("policy", [agents.Counting, agents.Batch])
def test_episodes_side_by_side_give_the_same(policy: Any, vectorization: str) -> None:
    """Two at once of three: the last has no company."""
    side_by_side = evaluate(policy, envs=2, vectorization=vectorization)
    pd.testing.assert_frame_equal(side_by_side, evaluate(policy))


def test_side_by_side_in_each_of_several_processes() -> None:
    crowd = evaluate("agents:Counting", envs=2, vectorization="async", jobs=2, variants="Demo")
    pd.testing.assert_frame_equal(crowd, evaluate("agents:Counting", variants="Demo"))


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("kind", ["sync", "async"])
def test_vector_environments_in_every_autoreset_mode(kind: str, mode: AutoresetMode) -> None:
    name = "magical_mj:magical_mj/MoveToRegion-TestLayout-State-v0"
    kwargs: dict[str, Any] = {"autoreset_mode": mode}
    if kind == "async":
        kwargs["context"] = "spawn"
    envs = gymnasium.make_vec(name, 2, kind, vector_kwargs=kwargs)
    assert isinstance(envs, SyncVectorEnv | AsyncVectorEnv)
    episodes = [Episode("MoveToRegion", "Layout", seed) for seed in range(5)]
    found = {policy: list(rollouts(envs, policy(), episodes)) for policy in (agents.Counting, agents.Batch)}
    envs.close()
    for policy, outcomes in found.items():
        plain = list(rollouts(gymnasium.make(name), policy(), episodes))
        assert [(o.score, o.actions, o.failure) for o in outcomes] == [(o.score, o.actions, None) for o in plain]


def test_dict_observations_side_by_side() -> None:
    def centre(observation: dict[str, np.ndarray]) -> int:
        assert observation["ego"].shape == (96, 96, 12)
        return int(observation["allo"].sum()) % 18

    settings = {"preset": "LoResStack", "episodes": 2, "variants": "Demo"}
    pd.testing.assert_frame_equal(evaluate(centre, envs=2, **settings), evaluate(centre, **settings))


def test_rules_reach_the_scores() -> None:
    """Nobody moves: ClusterShape's demo scores 0.25 by the paper's rules, 0 by the code's, and takes longer."""
    for rules, expected in (("paper", (0.25, 320)), ("released", (0.0, 240))):
        frame = evaluate("noop", tasks="ClusterShape", variants="Demo", episodes=1, rules=rules)
        assert (frame["score"].item(), frame["steps"].item()) == expected


def test_letters_are_the_actions() -> None:
    assert len(set(LETTERS)) == len(LETTERS) == len(magical_mj.actions.ACTIONS)


def test_expert_plays() -> None:
    frame = evaluate("expert", variants="Demo", episodes=1)
    assert frame["failure"].isna().all()


# failures


def test_a_failing_policy_costs_only_its_episodes() -> None:
    frame = evaluate("agents:Trouble", variants="Demo", episodes=17, time_limit=0.7).set_index("seed")
    good = frame.loc[range(0, 17, 2)]
    assert good["failure"].isna().all()
    assert (good["steps"] == 40).all()
    reasons = {
        1: "RuntimeError: lost its way",
        3: "18 is not an action",
        5: "no end within 0.7 s",
        7: "no end within 0.7 s",
        9: "no end within 0.7 s",
        11: "None is not an action",
        13: "is not an action",
        15: "is not an action",
    }
    for seed, reason in reasons.items():
        assert frame.loc[seed, "score"] == 0
        assert reason in frame.loc[seed, "failure"]


@pytest.mark.parametrize("kind", ["single", "batch"])
def test_a_failure_side_by_side_costs_nobody_else(kind: str) -> None:
    class Half(agents.Batch if kind == "batch" else agents.Counting):
        def reset(self, episode: Episode) -> None:
            self.steps = episode.seed
            self.seed = episode.seed

        def reset_batch(self, episodes: Any) -> None:
            if any(episode.seed == 1 for episode in episodes):
                raise ValueError("not this one")

        def __call__(self, observation: Any) -> int:
            if self.seed == 1:
                raise ValueError("not this one")
            return super().__call__(observation)

    side_by_side = evaluate(Half(), envs=3)
    assert side_by_side["failure"].notna().tolist() == [False, True, False] * 2
    pd.testing.assert_frame_equal(side_by_side, evaluate(Half()))


# what is asked for


@pytest.mark.parametrize(
    ("policy", "settings", "hint"),
    [
        ("rndom", {}, "Did you mean 'random'"),
        ("", {}, "give a policy"),
        (3, {}, "3 is not a policy"),
        ("no_such_module:thing", {}, "no_such_module:thing cannot be imported"),
        ("agents:nothing", {}, "no attribute 'nothing'"),
        ("agents:NOT_CALLABLE", {}, "is a int, which cannot be called"),
        ("missing.zip", {}, "no file missing.zip"),
        ("noop", {"tasks": "FindDup"}, "Did you mean 'FindDupe'"),
        ("noop", {"tasks": ""}, "at least one of"),
        ("noop", {"variants": "Color"}, "Did you mean 'Colour'"),
        ("noop", {"tasks": "MoveToRegion", "variants": "Shape"}, "It has: Demo"),
        ("noop", {"episodes": 0}, "episodes must be positive"),
        ("noop", {"time_limit": -1}, "time_limit must be positive"),
        ("noop", {"preset": "LoRes5E"}, "LoRes4E"),
        ("noop", {"rules": "mine"}, "paper"),
        ("noop", {"jobs": 0}, "jobs must be at least 1"),
        ("noop", {"backend": "slurm"}, "local, dask, ray"),
        ("noop", {"backend": "dask"}, "needs the scheduler's address"),
        ("noop", {"address": "tcp://there:1"}, "choose the dask or the ray backend"),
        ("noop", {"vectorization": "fast"}, "sync, async"),
    ],
)
def test_bad_settings_are_explained(policy: Any, settings: dict[str, Any], hint: str) -> None:
    with pytest.raises((SettingsError, UnknownNameError)) as caught:
        evaluate(policy, **settings)
    assert hint in str(caught.value)


def test_lists_of_environments() -> None:
    assert environments() == list(magical_mj.ENVIRONMENTS)
    assert environments("MoveToCorner, MoveToRegion", ["Layout", "TestShape"]) == [
        ("MoveToCorner", "Shape"),
        ("MoveToRegion", "Layout"),
    ]


# scores.jsonl


def test_file_holds_everything(tmp_path: Path) -> None:
    frame = magical_mj.evaluate("random", out=tmp_path, **SMALL)
    assert len(read(tmp_path)) == len(frame) == 6
    entry = json.loads((tmp_path / SCORES).read_text().splitlines()[0])
    assert set(entry) == set(frame.columns)
    assert entry["version"] == magical_mj.__version__
    assert entry["rules"] == "paper"
    assert entry["preset"] is None  # random looks at nothing
    assert entry["steps"] == len(entry["actions"]) == 40


def test_resume_does_only_what_is_left(tmp_path: Path) -> None:
    whole = magical_mj.evaluate("random", out=tmp_path / "whole", **SMALL)
    magical_mj.evaluate("random", out=tmp_path / "part", **SMALL)
    path = tmp_path / "part" / SCORES
    lines = path.read_text().splitlines(keepends=True)
    path.write_text("".join(lines[:3]))
    played: list[Score] = []
    again = magical_mj.evaluate("random", out=tmp_path / "part", resume=True, watch=played.append, **SMALL)
    assert len(played) == 3
    assert path.read_text().startswith("".join(lines[:3]))
    pd.testing.assert_frame_equal(again.drop(columns="seconds"), whole.drop(columns="seconds"))
    magical_mj.evaluate("random", out=tmp_path / "part", resume=True, watch=played.append, **SMALL)
    assert len(played) == 3


@pytest.mark.parametrize("cut", [1, 20, -2, -1])
def test_a_half_written_last_line_is_repaired(tmp_path: Path, cut: int) -> None:
    """At any place: what is whole but for its end is kept; all else is played again; the neighbours stay."""
    magical_mj.evaluate("random", out=tmp_path, **SMALL)
    before = rows(tmp_path)
    path = tmp_path / SCORES
    *kept, last = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(kept) + last[:cut])
    assert len(read(tmp_path)) == (6 if cut == -1 else 5)  # reports need no repair
    played: list[Score] = []
    magical_mj.evaluate("random", out=tmp_path, resume=True, watch=played.append, **SMALL)
    assert len(played) == (0 if cut == -1 else 1)
    assert rows(tmp_path) == before
    assert path.read_bytes().startswith(b"".join(kept))


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("{half", "line 3"),
        ("[]", "line 3: it must be an object with the keys policy"),
        ("same", "line 3: the same episode as line 2"),
        ("score", "line 3: the score 1.5 is not in [0, 1]"),
        ("steps", "line 3: steps must not be 'many'"),
        ("\x00\x00", "line 3"),
    ],
)
def test_corrupted_lines_are_named(tmp_path: Path, line: str, hint: str) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    path = tmp_path / SCORES
    lines = path.read_text().splitlines()
    changes: dict[str, dict[str, Any]] = {"score": {"score": 1.5}, "steps": {"steps": "many"}}
    lines[2] = lines[1] if line == "same" else line
    if line in changes:
        lines[2] = json.dumps(json.loads(lines[1]) | changes[line])
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(EvaluationError) as caught:
        read(tmp_path)
    assert hint in str(caught.value)
    with pytest.raises(EvaluationError, match="line 3"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)


@pytest.mark.parametrize(
    ("policy", "change", "difference"),
    [
        ("noop", {"episodes": 4}, "episodes was 3 and is 4"),
        ("noop", {"rules": "released"}, 'rules was "paper" and is "released"'),
        ("noop", {"preset": "LoRes4A"}, 'preset was "LoRes4E" and is "LoRes4A"'),
        ("noop", {"variants": "Demo"}, "environments was"),
        ("random", {}, "policies was"),
    ],
)
def test_changed_settings_are_refused(tmp_path: Path, policy: str, change: dict[str, Any], difference: str) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    before = (tmp_path / SCORES).read_bytes()
    with pytest.raises(SettingsError) as caught:
        magical_mj.evaluate(policy, out=tmp_path, resume=True, **{**SMALL, **change})
    assert difference in str(caught.value)
    assert (tmp_path / SCORES).read_bytes() == before


def test_a_changed_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.evaluation.sources.LOADERS", {".toy": lambda path, trust: agents.look})
    model = tmp_path / "model.toy"
    model.write_text("one")
    settings = {**SMALL, "episodes": 1, "variants": "Demo"}
    magical_mj.evaluate(str(model), out=tmp_path / "out", **settings)
    model.write_text("two")
    with pytest.raises(SettingsError, match="sha256"):
        magical_mj.evaluate(str(model), out=tmp_path / "out", resume=True, **settings)


def test_folders_are_not_mixed_up(tmp_path: Path) -> None:
    magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    with pytest.raises(EvaluationError, match="--resume"):
        magical_mj.evaluate("noop", out=tmp_path, **SMALL)
    with ScoreFile(tmp_path), pytest.raises(EvaluationError, match="another evaluation"):
        magical_mj.evaluate("noop", out=tmp_path, resume=True, **SMALL)
    with pytest.raises(EvaluationError, match="cannot write into /dev/null/folder"):
        magical_mj.evaluate("noop", out="/dev/null/folder", **SMALL)


def killed_and_resumed(folder: Path, kills: int, jobs: int) -> set[tuple[Any, ...]]:
    """The rows of an evaluation that was killed so many times at random moments, each time with work left."""
    command = [sys.executable, "-m", "magical_mj", "evaluate", "--policy", "random,agents:Slow", "--out", str(folder)]
    command += [
        "--tasks",
        "MoveToRegion",
        "--variants",
        "Demo,Layout",
        "--episodes",
        "60",
        "--jobs",
        str(jobs),
        "--resume",
    ]
    rng = random.Random(jobs)
    for _ in range(kills):
        process = subprocess.Popen(command, cwd=TESTS, stdout=subprocess.DEVNULL, start_new_session=True)
        size = lambda: (folder / SCORES).stat().st_size if (folder / SCORES).exists() else 0  # noqa: E731
        before, start = size(), time.monotonic()
        while size() == before and time.monotonic() - start < 60:
            time.sleep(0.01)
        time.sleep(rng.uniform(0, 0.3))
        assert process.poll() is None, "it ended before it could be killed"
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    subprocess.run(command, cwd=TESTS, stdout=subprocess.DEVNULL, check=True)
    return rows(folder)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_killed_runs_end_with_the_same_rows(tmp_path: Path, jobs: int) -> None:
    settings = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 60}
    whole = magical_mj.evaluate("random,agents:Slow", out=tmp_path / "whole", **settings)
    found = killed_and_resumed(tmp_path / "killed", kills=2, jobs=jobs)
    assert len(found) == len(whole) == 240
    assert found == rows(tmp_path / "whole")
