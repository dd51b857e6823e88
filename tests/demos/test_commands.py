"""The subcommands of `magical-mj demos`."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from magical_mj import demos
from magical_mj.cli.demos import write_one
from magical_mj.demos import Demonstration
from magical_mj.policies.interface import AGENTS, Episode
from magical_mj.tasks.registry import SPLITS
from tests.demos.test_files import forge
from tests.helpers.commands import Shell


def said(shell: Shell, *arguments: object, code: int = 0) -> str:
    """What a command prints, in one line."""
    ended, out, error = shell("demos", *arguments)
    assert ended == code
    return " ".join(f"{out} {error}".split())


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    return demos.load("MoveToRegion")[0]


def test_generate_verify_info_video_and_export(shell: Shell) -> None:
    generate = ("generate", "--tasks", "MoveToRegion", "--variants", "All", "--out", "made", "--jobs", 1)
    said(shell, *generate, "--count", 2)
    folder = Path("made")
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(first) == ["MoveToRegion-All-000.npz", "MoveToRegion-All-001.npz"]
    assert "2 of 3 exist already" in said(shell, *generate, "--count", 3)
    assert all((folder / name).read_bytes() == content for name, content in first.items())
    verified = said(shell, "verify", "made", "--jobs", 1)
    assert "3 of 3 replay to the same score, 3 through the same states, 3 with the same pictures" in verified
    assert "MoveToRegion-All" in said(shell, "info", folder / "MoveToRegion-All-001.npz")
    said(shell, "video", folder / "MoveToRegion-All-001.npz", "--out", "x.mp4", "--size", 32)
    assert Path("x.mp4").stat().st_size > 1000
    said(shell, "export", "made", "--out", "x.npz", "--preset", "State")
    assert Path("x.npz").exists()
    assert "would be in the folder" in said(shell, "export", "made", "--out", folder / "x.npz", code=2)
    assert "none of the 3 demonstrations" in said(shell, "verify", "made", "--tasks", "MakeLine", "--jobs", 1, code=2)


def test_generate_keeps_no_demonstration_below_the_least_score(shell: Shell) -> None:
    idle = demos.recorded("MoveToRegion", "All", 0, [0] * 40, "expert")
    path = Path("made", "MoveToRegion-All-000.npz")
    demos.write(idle, path)
    generate = ("generate", "--tasks", "MoveToRegion", "--variants", "All", "--out", "made", "--jobs", 1, "--count", 2)
    refused = said(shell, *generate, "--least-score", 0.5, code=2)
    assert "000.npz exists already, but its score 0.00 is less than 0.5: give another folder" in refused
    assert [demos.read(path).score for path in demos.files_in("made")] == [0.0]
    assert "1 of 2 exist already" in said(shell, *generate, "--least-score", 0)


def test_rollouts_of_a_policy_are_episodes_in_scenes_of_no_test_which_exports_take(shell: Shell) -> None:
    command = ("rollouts", "--tasks", "MoveToRegion", "--variants", "All", "--out", "made", "--jobs", 1)
    assert "2 episodes with 80 steps" in said(shell, *command, "--steps", 41)
    assert "2 of 3 exist already" in said(shell, *command, "--steps", 81)
    played = [demos.read(path) for path in demos.files_in("made")]
    assert [(demo.scene_seed, demo.demonstrator) for demo in played] == [
        (SPLITS["dev"] + k, "random") for k in range(3)
    ]
    agent = AGENTS["random"]()
    agent.reset(Episode("MoveToRegion", "All", SPLITS["dev"]))
    assert played[0].actions.tolist() == [agent(None) for _ in range(40)]
    assert all(demos.verify(demo).good for demo in played)
    said(shell, "export", "made", "--to", "webdataset", "--preset", "State", "--out", "set")
    card = Path("set", "README.md").read_text()
    assert "# MoveToRegion-All: 3 episodes\n" in card
    assert "by actions drawn independently and uniformly" in card


def test_rollouts_of_another_policy_with_the_same_name_are_not_added(
    shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Otherwise a data set would mix two policies, or the command would do nothing."""
    monkeypatch.syspath_prepend(tmp_path)
    for name, action in (("one_driver", 4), ("other_driver", 5)):
        (tmp_path / f"{name}.py").write_text(f"def policy(_):\n    return {action}\n")
    command = ("rollouts", "--tasks", "MoveToRegion", "--variants", "Demo", "--out", "made", "--jobs", 1)
    said(shell, *command, "--policy", "one_driver:policy", "--steps", 41)
    assert "2 of 3 exist already" in said(shell, *command, "--policy", "one_driver:policy", "--steps", 81)
    for steps in (81, 121):
        refusal = said(shell, *command, "--policy", "other_driver:policy", "--steps", steps, code=2)
        assert "MoveToRegion-Demo-policy-10000000.npz is by another policy with the same name" in refusal
    assert {tuple(demos.read(path).actions) for path in demos.files_in("made")} == {(4,) * 40}


def test_generate_takes_what_another_process_was_faster_to_make(demo: Demonstration, tmp_path: Path) -> None:
    demos.write(demo, tmp_path / "demo.npz")
    before = (tmp_path / "demo.npz").read_bytes()
    assert write_one(lambda *_: demo, (("MoveToRegion", "Demo", 0), tmp_path / "demo.npz")) == ""
    assert (tmp_path / "demo.npz").read_bytes() == before


def test_a_damaged_file_is_reported(demo: Demonstration, shell: Shell) -> None:
    path = Path("MoveToRegion-Demo-000.npz")
    demos.write(demo, path)
    path.write_bytes(path.read_bytes()[:-10])
    generate = ("generate", "--tasks", "MoveToRegion", "--count", 1, "--out", ".", "--jobs", 1)
    for code, *command in (2, *generate), (1, "verify", path, "--jobs", 1), (2, "info", path):
        assert "is damaged, truncated, or not a demonstration" in said(shell, *command, code=code)
    assert "none.npz" in shell.fails(2, "demos", "info", "none.npz")


def test_verify_tells_what_does_not_replay_of_every_file(demo: Demonstration, shell: Shell) -> None:
    demos.write(dataclasses.replace(demo, actions=np.zeros_like(demo.actions)), "bad.npz")
    demos.write(demo, "good.npz")
    demos.write(dataclasses.replace(demo, variant="Layout", scene_seed=5), "moved.npz")
    demos.write(demo, "another.npz")
    forge(Path("another.npz"), {"task": "MatchRegions"})  # whose scene is not one of that task
    demos.write(demo, "longer.npz")
    forge(
        Path("longer.npz"),
        actions=np.concatenate([demo.actions, np.ones(200, np.uint8)]),
        **{name: np.append(getattr(demo, name), [getattr(demo, name)[-1]] * 200, axis=0) for name in ("qpos", "qvel")},
    )
    demos.write(demo, "still.npz")
    states = {name: np.repeat(getattr(demo, name)[-1:], len(demo.qpos), axis=0) for name in ("qpos", "qvel")}
    forge(Path("still.npz"), **states)
    error = said(shell, "verify", ".", "--jobs", 1, code=1)
    assert "3 of 6 replay" in error
    for name in ("moved", "still"):
        assert f"{name}.npz does not start in the scene" in error
    for name in ("bad", "longer"):
        assert f"{name}.npz does not replay" in error
    assert "another.npz" in error
    assert "good.npz" not in error


def test_verify_counts_what_it_cannot_replay_by_itself(demo: Demonstration, shell: Shell) -> None:
    """Files that name the code of a task are not replayed unless the command names the task, too."""
    for number in range(2):
        demos.write(demo, f"{number}.npz")
        forge(Path(f"{number}.npz"), {"task": "mine:SPEC"})
    printed = said(shell, "verify", ".", "--jobs", 1, code=1)
    assert printed.startswith("2 not replayed magical-mj: ")
    assert "--tasks mine:SPEC" in printed
    demos.write(demo, "ours.npz")
    assert said(shell, "verify", ".", "--jobs", 1, code=1).startswith(
        "1 of 1 replay to the same score, 1 through the same states, 1 with the same pictures 2 not replayed"
    )


def test_tasks_in_files_run_only_if_the_user_names_them(demo: Demonstration, shell: Shell) -> None:
    """And do not matter beside those that were asked for."""
    for name in ("one.npz", "other.npz"):
        demos.write(demo, name)
        forge(Path(name), {"task": "stranger:SPEC"})
    demos.write(demo, "good.npz")
    for code, *command in (2, "info", "."), (1, "verify", ".", "--jobs", 1):
        assert "stranger" not in said(shell, *command, "--tasks", "MoveToRegion")
        error = said(shell, *command, code=code)
        assert "--tasks stranger:SPEC" in error
    error = shell.fails(2, "demos", "info", ".", "--tasks", "FindDupe")
    assert "the files hold MoveToRegion-Demo, stranger:SPEC" in error


def test_a_generate_that_was_interrupted_says_what_is_kept_and_goes_on(shell: Shell) -> None:
    command = [sys.executable, "-m", "magical_mj", "demos", "generate", "--tasks", "MoveToRegion", "--out", "made"]
    for ends_by, code in ((signal.SIGINT, 130), (signal.SIGKILL, -9)):
        process = subprocess.Popen(
            [*command, "--count", "900", "--jobs", "1"], stderr=subprocess.PIPE, text=True, start_new_session=True
        )
        before = len(demos.files_in("made"))
        while len(demos.files_in("made")) == before:
            time.sleep(0.05)
        os.killpg(process.pid, ends_by)
        _, error = process.communicate()
        assert process.returncode == code
        episodes = demos.load("MoveToRegion", "made")
        assert before < len(episodes) < 900
        if ends_by == signal.SIGINT:
            assert f"{len(episodes)} of 900 demonstrations are in made" in error
    more = ("--tasks", "MoveToRegion", "--count", len(episodes) + 1)
    said(shell, "generate", *more, "--out", "made", "--jobs", 1)
    assert len(demos.load("MoveToRegion", "made")) == len(episodes) + 1


@pytest.fixture
def broken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """A module with a task whose plan fails anywhere but in the demo scene, and with two tasks of one name."""
    name = f"broken_{tmp_path.name}"
    (tmp_path / f"{name}.py").write_text(
        "from dataclasses import replace\n"
        "from magical_mj.tasks.move_to_region import SPEC as OURS\n"
        "def plan(initial, now, noise):\n"
        "    return OURS.plan(initial, now, noise) if now.robot == OURS.demo.robot else 1 / 0\n"
        'FAILS = replace(OURS, name="Fails", plan=plan)\n'
        'ONE, OTHER = replace(OURS, name="Same"), replace(OURS, name="Same", demo=FAILS.demo)\n'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    yield name
    del sys.modules[name]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_plan_that_fails_is_named_in_a_line(broken: str, shell: Shell, jobs: int) -> None:
    command = ("generate", "--tasks", f"{broken}:FAILS", "--variants", "Jitter", "--count", 2)
    error = said(shell, *command, "--jobs", jobs, "--out", "made", code=2)
    assert "Fails.plan failed: ZeroDivisionError" in error


def test_two_tasks_of_one_name_take_two_folders(broken: str, shell: Shell) -> None:
    """In one folder, the second one's demonstrations would be taken as made already."""
    tasks = f"{broken}:ONE,{broken}:OTHER"
    assert "same name" in shell.fails(2, "demos", "generate", "--tasks", tasks, "--count", 1, "--out", "made")
    assert not Path("made").exists()


@pytest.mark.parametrize("which", ["1", "graded"])
def test_a_data_set_of_several_environments_is_refused(shell: Shell, tmp_path: Path, which: str) -> None:
    where = ("--tasks", "MoveToCorner,MoveToRegion", "--to", "webdataset", "--preset", "State", "--force")
    code, _, error = shell("demos", "export", "--set", which, *where, "--out", str(tmp_path / "data"))
    assert code == 2
    assert "a data set holds one environment" in " ".join(error.replace("│", " ").split())
    assert not (tmp_path / "data").exists()
