"""An evaluation continues only with the code and the files that it began with."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path
from typing import Any

import pytest

import magical_mj
from magical_mj.cli import main
from magical_mj.utils.errors import SettingsError

MODULES = {
    "policies": """
from pathlib import Path
import numpy as np
from kept.deep import DRIVE
class Reads:
    preset = "State"
    def __init__(self):
        self.action = int(Path("weights.txt").read_text())
    def __call__(self, _):
        return self.action
class Imports:  # repeats a demonstration
    preset = "State"
    def reset(self, episode):
        from magical_mj import demos
        self.actions = iter(demos.load("MoveToRegion")[0].actions.tolist())
    def __call__(self, _):
        return DRIVE * next(self.actions)
class Draws:
    preset = "State"
    def __call__(self, _):
        return int(np.random.default_rng().integers(18))
""",
    "kept/__init__": "",
    "kept/deep": "DRIVE = 1",
    "amount": "TURN = 1\nPLACE = 0.3",
    "wrapped": """
import gymnasium, pathlib
class Turned(gymnasium.ActionWrapper):
    def action(self, action):
        import amount
        return action * amount.TURN * int(pathlib.Path("weights.txt").read_text())
""",
    "shifted": """
import amount
from dataclasses import replace
from magical_mj.shifts import Shift
class Moved(Shift):
    name, summary = "Moved", "the robot starts elsewhere"
    def scene(self, scene, rules):
        return replace(scene, robot=replace(scene.robot, x=amount.PLACE))
""",
    "tasked": """
import amount
from dataclasses import replace
from pathlib import Path
from magical_mj.tasks.move_to_region import SPEC as REGION
def score(initial, final, rules="paper"):
    return REGION.score(initial, final, rules) * float(Path("weights.txt").read_text()) / amount.TURN
SPEC = replace(REGION, name="Tasked", score=score)
""",
}
CASES: dict[str, tuple[dict[str, Any], str, str]] = {
    "a file that a policy reads": ({"policy": "policies:Reads"}, "weights.txt", "0"),
    "a module that a policy imports": ({"policy": "policies:Imports"}, "kept/deep.py", "DRIVE = 0"),
    "a shift's helper": ({"policy": "noop", "shifts": "shifted:Moved:1"}, "amount.py", "TURN = 1\nPLACE = 0.2"),
    "a wrapper's helper": ({"policy": "policies:Imports", "wrap": "wrapped:Turned"}, "amount.py", "TURN = 0"),
    "a file that a wrapper reads": ({"policy": "policies:Imports", "wrap": "wrapped:Turned"}, "weights.txt", "0"),
    "a task's helper": ({"policy": "policies:Imports", "tasks": "tasked:SPEC"}, "amount.py", "TURN = 2\nPLACE = 0.3"),
    "a file that a score reads": ({"policy": "policies:Imports", "tasks": "tasked:SPEC"}, "weights.txt", "0.5"),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with own modules."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # a changed file may have the same size and time
    for name, text in MODULES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / f"{name}.py").write_text(text)
    (tmp_path / "weights.txt").write_text("1")
    return tmp_path


def evaluated(policy: str, episodes: int, **settings: Any) -> Any:
    """The scores of an evaluation that continues, by a process that has imported nothing yet."""
    for name in list(sys.modules):
        if name.partition(".")[0] in {key.partition("/")[0] for key in MODULES}:
            del sys.modules[name]
    few = {"tasks": "MoveToRegion", "variants": "Demo", "jobs": 1, "out": "out", "resume": True, "preset": "State"}
    return magical_mj.evaluate(policy, episodes=episodes, **{**few, **settings})


@pytest.mark.parametrize("what", CASES)
def test_what_has_changed_is_noticed(what: str, folder: Path) -> None:
    settings, file, changed = CASES[what]
    before = evaluated(episodes=1, **settings)
    original = (folder / file).read_text()
    (folder / file).write_text(changed)
    for episodes in (1, 2):
        with pytest.raises(SettingsError, match=r"differ|changed|another|other settings"):
            evaluated(episodes=episodes, **settings)
    (folder / file).write_text(original)
    after = evaluated(episodes=2, **settings)
    assert len(after) == 2 * len(before)


def test_one_run_is_one_policy_in_all_folders(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated("P=policies:Imports", 1, out="a")
    (folder / "kept/deep.py").write_text("DRIVE = 0")
    evaluated("P=policies:Imports", 1, out="b", first_seed=1)
    for command in (["report", "a", "b", "--out", "r"], ["submit", "a", "b", "--out", "e.json.xz"]):
        assert main(command) == 1
        error = " ".join(capsys.readouterr().err.split())
        assert "run 0 of P is not the same in a and b, which both hold MoveToRegion-Demo: they differ in code" in error


def test_a_folder_given_twice_counts_once(folder: Path) -> None:
    evaluated("P=policies:Imports", 1, out="a")
    assert main(["report", "./a", str(folder / "a"), "--out", "a/report"]) == 0
    assert main(["report", "a", "a/"]) == 0
    assert "1 episode in each environment" in (folder / "a/report/report.md").read_text()


def test_comparisons_of_different_tasks_print_no_warning(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluated("A=policies:Reads", 2, out="a", tasks="MoveToCorner,MoveToRegion", variants="Demo,Jitter")
    evaluated("B=policies:Reads", 2, out="b", tasks="MoveToRegion", variants="Jitter,Demo", first_seed=1)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["compare", "a", "b"]) == 0
    assert "without 8 scenes that only one of them has played" in " ".join(capsys.readouterr().out.split())


def test_two_runs_of_one_deterministic_object_are_said_to_be_one(folder: Path) -> None:
    evaluated("P=policies:Imports,P=policies:Imports,Q=policies:Draws,Q=policies:Draws", 2, out="a")
    assert main(["report", "a"]) == 0
    text = " ".join((folder / "a/report/report.md").read_text().split())
    assert "the runs 0 and 1 of P act alike in 2 common episodes, so that they are one run" in text
    assert "of Q act alike" not in text


def test_policies_with_unseeded_random_numbers_continue(folder: Path) -> None:
    """Nobody can say whether they have changed."""
    evaluated("policies:Draws", 1)
    assert len(evaluated("policies:Draws", 2)) == 2
