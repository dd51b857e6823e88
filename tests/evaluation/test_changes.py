"""One's own changes of what is played: wrappers, tasks that are like another; and the errors of policies."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.report import report
from magical_mj.evaluation.reports.results import compare
from magical_mj.evaluation.scores import read
from magical_mj.leaderboard import submit
from magical_mj.scene.actions import action_number
from magical_mj.utils.errors import EvaluationError, InvalidActionError, SettingsError
from tests.helpers.agents import Acting
from tests.helpers.commands import Shell
from tests.helpers.evaluations import SMALL

MODULE = """
from dataclasses import replace
import gymnasium
from magical_mj.tasks.find_dupe import SPEC as OLD

class Dark(gymnasium.ObservationWrapper):
    def observation(self, observation):
        return 0 * observation

class Other(gymnasium.Wrapper):
    def __init__(self, env):
        super().__init__(env)
        self.action_space = gymnasium.spaces.Discrete(3)

def sum_is_even(observation):
    return int(observation.sum() != 0)

SPEC = replace(OLD, name="FindQuickly", like="FindDupe", plan=None, steps=50)
FAR = replace(SPEC, name="FindAnything", like="")
"""


@pytest.fixture(autouse=True)
def _module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path("mine.py").write_text(MODULE)


def test_a_wrapper_is_played_in_and_named(tmp_path: Path) -> None:
    plain, dark = (
        magical_mj.evaluate("mine:sum_is_even", out=name, wrap=wrap, jobs=1, **SMALL)
        for name, wrap in (("plain", ""), ("dark", "mine:Dark"))
    )
    assert (set(plain["actions"]), set(dark["actions"])) == ({"b" * 40}, {"a" * 40})
    assert {score.wrap for score in read(tmp_path / "dark")} == {"mine:Dark"}
    text = report([tmp_path / "plain", tmp_path / "dark"], tmp_path / "out").read_text()
    assert "| sum_is_even in mine:Dark |" in text
    assert compare(tmp_path / "plain", tmp_path / "dark").attrs["policies"][1] == "sum_is_even in mine:Dark"
    with pytest.raises(EvaluationError, match="was played in mine:Dark"):
        submit([tmp_path / "dark"], tmp_path / "entry.json.xz")


def test_another_body_is_played_with_and_named(tmp_path: Path) -> None:
    settings: dict[str, Any] = {"variants": "Demo", "episodes": 1, "jobs": 1, "body": "shortstick"}
    frame = magical_mj.evaluate("expert", tasks="MoveToRegion", out="stick", **settings)
    assert (frame["score"].item(), frame["body"].item()) == (1.0, "shortstick")
    assert [problem for *_, problem in replay([("", score) for score in read(tmp_path / "stick")])] == [None]
    assert "| expert with shortstick |" in report([tmp_path / "stick"], tmp_path / "out").read_text()
    with pytest.raises(EvaluationError, match="with the body shortstick"):
        submit([tmp_path / "stick"], tmp_path / "entry.json.xz")
    with pytest.raises(SettingsError, match="FindDupe is not offered with the body"):
        magical_mj.evaluate("noop", tasks="FindDupe", **settings)


@pytest.mark.parametrize(
    ("wrap", "problem"),
    [
        ("Dark", "wrap is package.module:NAME"),
        ("mine:nothing", "mine:nothing cannot be used: ImportError"),
        ("mine:OLD", "mine:OLD cannot be used: TypeError"),
        ("mine:sum_is_even", "mine:sum_is_even cannot be used: AttributeError"),
        ("mine:Other", "with its 18 actions"),
    ],
)
def test_what_is_no_wrapper_is_refused(wrap: str, problem: str) -> None:
    with pytest.raises(SettingsError, match=problem):
        magical_mj.evaluate("noop", wrap=wrap, **SMALL)


def test_policies_play_a_task_that_is_like_theirs(shell: Shell) -> None:
    """By the task's definition, or by --as; the expert takes the plan of the task that it is like."""
    settings: dict[str, Any] = {"variants": "Demo", "episodes": 1, "preset": "State", "jobs": 1}
    told: list[str] = []
    policy = Acting(reset=lambda episode: told.append(episode.task), tasks=("FindDupe",))
    frame = magical_mj.evaluate(policy, tasks="mine:SPEC", **settings)
    assert (told, frame["task"].item(), frame["steps"].item()) == (["FindDupe"], "mine:SPEC", 50)
    magical_mj.evaluate("expert", tasks="mine:SPEC", **settings)
    with pytest.raises(SettingsError, match=r"cannot act in mine:FAR: give --tasks FindDupe, or --as"):
        magical_mj.evaluate(policy, tasks="mine:FAR", **settings)
    magical_mj.evaluate(policy, tasks="mine:FAR", like="FindDupe", **settings)
    line = "evaluate --policy expert --tasks mine:FAR --variants Demo --episodes 1 --jobs 1 --out o"
    assert "FindAnything has no plan" in shell.fails(2, *line.split())
    assert shell(*line.split(), "--as", "FindDupe")[0] == 0
    assert "Did you mean 'FindDupe'" in shell.fails(2, *line.split(), "--as", "FindDup")


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_of_policies_are_chained_and_placed(jobs: int, tmp_path: Path) -> None:
    code = "def deep(x):\n    return {}[x]\n\ndef act(observation):\n    return deep('pose')\n"
    (tmp_path / "theirs.py").write_text(code)
    with pytest.raises(EvaluationError, match=r"KeyError: 'pose' \(theirs.py, line 2\)") as caught:
        magical_mj.evaluate("theirs:act", jobs=jobs, **SMALL)
    assert 'theirs.py", line 5, in act' in "".join(traceback.format_exception(caught.value))


def test_a_missing_package_is_no_failure() -> None:
    def act(observation: Any) -> int:
        import no_such_package  # noqa: F401

        return 0

    with pytest.raises(SettingsError, match=r"lacks a package: ModuleNotFoundError: .*no_such_package"):
        magical_mj.evaluate(act, jobs=1, **SMALL)


@pytest.mark.parametrize(
    ("action", "hint"), [(np.array([4]), "its only entry"), (np.zeros(18), "argmax"), ([0.0] * 18, "argmax")]
)
def test_actions_that_are_arrays_get_a_hint(action: Any, hint: str) -> None:
    with pytest.raises(InvalidActionError, match=hint):
        action_number(action)
