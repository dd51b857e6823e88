"""Which stored episodes can be replayed. Others are reported, but neither shown nor counted as replayed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import pytest

import magical_mj
from magical_mj.evaluation import Episode, rollouts
from magical_mj.evaluation.folder import SETTINGS, read_settings
from magical_mj.evaluation.replay import obstacle, replay
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.scores import read
from magical_mj.leaderboard import submit, verify
from magical_mj.policies.interface import RandomAgent
from magical_mj.utils.errors import EvaluationError, UntrustedNameError
from tests.helpers.commands import Shell
from tests.helpers.evaluations import SMALL, TEMPLATE

WRAPPER = """
import gymnasium

class Back(gymnasium.Wrapper):
    def step(self, action):
        return self.env.step(2)
"""
TINY = {**SMALL, "variants": "Demo", "episodes": 2, "jobs": 1}


def test_an_episode_in_a_wrapper_is_not_replayed(tmp_path: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    """The wrapper drives back after no-ops, so a film of the policy's actions would show a robot at rest."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "back.py").write_text(WRAPPER)
    magical_mj.evaluate("noop", out=tmp_path / "wrapped", wrap="back:Back", **TINY)
    magical_mj.evaluate("noop", out=tmp_path / "plain", **TINY)
    reason = "it was played in the wrapper back:Back, which may have changed its actions and states"

    assert f"noop in wrapped cannot be filmed: {reason}" in shell.fails(2, "report", "wrapped", "--videos")
    assert not (tmp_path / "wrapped" / "report").exists()
    code, _, error = shell("report", "plain", "wrapped", "--videos", "--out", "both")
    assert (code, error) == (0, f"magical-mj: noop in wrapped cannot be filmed: {reason}\n")
    assert [path.name for path in (tmp_path / "both").glob("*.mp4")] == ["best-noop-MoveToRegion.mp4"]

    findings = verify(tmp_path / "wrapped", jobs=1)
    assert findings.episodes == 0
    assert f"2 episodes cannot be replayed: {reason}" in findings.unfit
    with pytest.raises(EvaluationError, match=r"cannot be scored by the rules 'released': run 0, .*wrapper back:Back"):
        report([tmp_path / "wrapped"], tmp_path / "page", rules="released")
    with pytest.raises(EvaluationError, match=r"cannot be an entry.*wrapper back:Back"):
        submit([tmp_path / "wrapped"], tmp_path / "entry.json.xz")


class Still(gymnasium.Wrapper):  # type: ignore[type-arg]
    """Takes no-op actions."""


def test_rollouts_say_in_what_they_were_played(tmp_path: Path) -> None:
    """Replayed with the evaluation's shift and body, episodes end equally; in a wrapper, they may not."""
    options: Any = {"shifts": "latency:2", "body": "shortstick"}
    name, episodes = "magical_mj/MoveToRegion-Demo-State-v0", [Episode("MoveToRegion", "Demo", 0)]
    for env in (gymnasium.make(name, **options), gymnasium.make_vec(name, 1, vectorization_mode="sync", **options)):
        (row,) = rollouts(env, RandomAgent(), episodes)
        assert (row.shift, row.body, row.wrap, obstacle(row)) == ("latency:2", "shortstick", "", None)
        assert [problem for _, _, problem in replay([("", row)], jobs=1)] == [None]
        env.close()
    (row,) = rollouts(Still(gymnasium.make(name)), RandomAgent(), episodes)
    assert (row.wrap, row.body) == (f"{__name__}:Still", "gripper")


@pytest.mark.parametrize(
    ("change", "recorded", "reason"),
    [
        ({"worlds": "batched"}, {}, "it was played in batched environments"),
        ({"wrap": "mine:Wrapper"}, {}, "it was played in the wrapper mine:Wrapper"),
        ({}, {"protocol": 0}, "it follows protocol 0, but this version plays 1"),
        ({"shift": "camera:3"}, {"shift_protocol": 99}, "it follows shift protocol 99"),
        ({"task": "Gone"}, {}, "unknown task 'Gone'"),
        ({"rules": "mine"}, {}, "unknown set of rules 'mine'"),
        ({"body": "stick"}, {}, "stick"),
        ({"shift": "fog:3"}, {}, "unknown shift 'fog'"),
        ({"shift": "body:snake"}, {}, "snake"),
    ],
)
def test_obstacles_to_a_replay_are_named(change: dict[str, Any], recorded: dict[str, Any], reason: str) -> None:
    assert reason in (obstacle(replace(TEMPLATE, **change), recorded) or "none")


def test_the_renderer_and_the_policy_are_no_obstacles(tmp_path: Path) -> None:
    """Actions are replayed without pictures."""
    magical_mj.evaluate("random", out=tmp_path, renderer="software", shifts="latency:2,body:shortstick", **TINY)
    assert {obstacle(row, read_settings(tmp_path)) for row in read(tmp_path)} == {None}
    findings = verify(tmp_path, jobs=1)
    assert (findings.episodes, findings.differing) == (6, [])


def test_a_task_whose_code_has_changed_is_not_filmed(
    tmp_path: Path, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
    name = "replayed_task:SPEC"
    (tmp_path / "replayed_task.py").write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.move_to_region import SPEC as OLD\n"
        'SPEC = replace(OLD, name="Replayed")\n'
    )
    magical_mj.evaluate("noop", out=tmp_path / "o", **{**TINY, "tasks": name})
    (row, _), settings = read(tmp_path / "o"), read_settings(tmp_path / "o")
    assert obstacle(row, settings, [name]) is None
    settings[f"code of {name}"] = "0"
    assert obstacle(row, settings, [name]) == f"the code of {name} has changed since it was played"
    (tmp_path / "o" / SETTINGS).write_text(json.dumps(settings))
    assert "cannot be filmed: the code of" in shell.fails(2, "report", "o", "--videos", "--trusted", name)
    with pytest.raises(UntrustedNameError):
        obstacle(replace(row, task="others_task:SPEC"))
