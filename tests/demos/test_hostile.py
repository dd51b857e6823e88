"""Demonstrations that strangers made, and that do not hold what they say."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from magical_mj import demos
from magical_mj.cli import main
from magical_mj.demos import Demonstration
from magical_mj.demos.files import ARRAYS, _digest
from magical_mj.utils.errors import DemonstrationError, UntrustedNameError


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    return demos.demonstrate("MoveToRegion", "Demo", 0)


@pytest.fixture
def path(demo: Demonstration, tmp_path: Path) -> Path:
    demos.write(demo, tmp_path / "MoveToRegion-Demo-000.npz")
    return tmp_path / "MoveToRegion-Demo-000.npz"


def forge(path: Path, header: dict[str, Any] | bytes | None = None, **arrays: Any) -> None:
    """Rewrites a file with other content and a digest that fits it, as somebody who knows this package could."""
    with np.load(path) as archive:
        parts = {name: archive[name] for name in archive} | arrays
    if isinstance(header, bytes):
        text = header
    else:
        whole = {**json.loads(parts["header"].tobytes()), **(header or {})}
        whole.pop("digest")
        text = json.dumps({**whole, "digest": _digest(whole, {name: parts[name] for name in ARRAYS})}).encode()
    np.savez_compressed(path, **{**parts, "header": np.frombuffer(text, np.uint8)})


def test_that_a_task_must_be_named_is_said_once(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    forge(path, {"task": "mine:SPEC"})
    path.with_name("MoveToRegion-Demo-001.npz").write_bytes(path.read_bytes())
    assert main(["demos", "verify", str(path.parent)]) == 1
    out, error = capsys.readouterr()
    assert "0 of 2 replay" in out
    assert error.count("--tasks mine:SPEC") == 1


@pytest.mark.parametrize("command", ["info", "verify"])
def test_a_file_chooses_no_code(
    path: Path, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = f"stranger_{command}"
    (tmp_path / f"{name}.py").write_text(
        'from pathlib import Path\nPath("ran").touch()\nfrom dataclasses import replace\n'
        'from magical_mj.tasks.move_to_region import SPEC as OURS\nSPEC = replace(OURS, name="Strange")\n'
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    forge(path, {"task": f"{name}:SPEC"})
    assert main(["demos", command, str(path)]) > 0
    assert f"--tasks {name}:SPEC" in " ".join(capsys.readouterr().err.split())
    assert not Path("ran").exists()
    with pytest.raises(UntrustedNameError, match="trust"):
        demos.read(path)
    assert demos.read(path, trusted=[f"{name}:SPEC"]).name == demos.read(path, f"{name}:SPEC").name == "Strange-Demo"
    assert Path("ran").exists()


def test_strangers_tasks_beside_those_that_were_asked_for_do_not_matter(
    path: Path, demo: Demonstration, capsys: pytest.CaptureFixture[str]
) -> None:
    forge(path, {"task": "stranger:SPEC"})
    demos.write(demo, path.with_name("good.npz"))
    for command in ("info", "verify"):
        assert main(["demos", command, str(path.parent), "--tasks", "MoveToRegion"]) == 0
        out, error = capsys.readouterr()
        assert "MoveToRegion-Demo" in out or "1 of 1 replay" in out
        assert "stranger" not in out + error
        assert main(["demos", command, str(path.parent)]) != 0
        assert "names stranger:SPEC" in " ".join(capsys.readouterr().err.split())
    assert main(["demos", "info", str(path.parent), "--tasks", "FindDupe"]) == 2
    assert "there are MoveToRegion-Demo, stranger:SPEC" in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("header", "problem"),
    [
        (b"[" * 200_000, "unreadable header"),
        ({"score": "1.0"}, r"the score must be a number in \[0, 1\], not '1.0'"),
        ({"score": None}, "the score must be a number"),
        ({"score": 5.0}, "the score must be a number"),
        ({"score": float("nan")}, "the score must be a number"),
        ({"scene_seed": "abc"}, "seeds must be integers of at least 0, not 'abc'"),
        ({"scene_seed": -3}, "seeds must be integers"),
        ({"seed": [1]}, "seeds must be integers"),
        ({"package": 3}, "must be texts"),
    ],
)
def test_headers_are_checked(path: Path, header: Any, problem: str) -> None:
    forge(path, header)
    with pytest.raises(DemonstrationError, match=problem):
        demos.read(path)


def test_damaged_files_and_wrong_folders_cost_nobody_the_episode(demo: Demonstration, tmp_path: Path) -> None:
    first, _ = demos.keep(demo, tmp_path)
    first.write_bytes(first.read_bytes()[:100])
    second, is_new = demos.keep(demo, tmp_path)
    assert is_new
    assert demos.read(second).score == demo.score
    assert demos.keep(demo, tmp_path) == (second, False)
    with pytest.raises(FileExistsError, match=first.name):
        demos.keep(demo, first)
    with pytest.raises(DemonstrationError, match="there are no demonstrations"):
        demos.load("FindDupe", "")  # as of a variable that is not set


def test_a_small_file_that_unpacks_to_much_is_not_unpacked(path: Path) -> None:
    forge(path, actions=np.zeros(60_000_000, np.uint8))
    assert path.stat().st_size < 200_000
    with pytest.raises(DemonstrationError, match="damaged or cut short, or not a demonstration"):
        demos.read(path)


def test_verify_finds_states_and_actions_that_do_not_belong(path: Path, demo: Demonstration) -> None:
    assert demos.verify(demos.read(path)).good
    still = {name: np.repeat(getattr(demo, name)[-1:], len(demo.actions) + 1, axis=0) for name in ("qpos", "qvel")}
    forge(path, **still)
    assert not demos.verify(demos.read(path)).scene
    forge(
        path,
        actions=np.concatenate([demo.actions, np.ones(200, np.uint8)]),
        qpos=np.concatenate([demo.qpos, np.repeat(demo.qpos[-1:], 200, axis=0)]),
        qvel=np.concatenate([demo.qvel, np.repeat(demo.qvel[-1:], 200, axis=0)]),
    )
    verdict = demos.verify(demos.read(path))
    assert verdict.scene
    assert not verdict.replay


def test_verify_names_every_file(path: Path, demo: Demonstration, capsys: pytest.CaptureFixture[str]) -> None:
    """Also one whose scene is not one of its task, which ends the verdicts of no other."""
    forge(path, {"task": "MatchRegions"})
    demos.write(demo, path.with_name("good.npz"))
    assert main(["demos", "verify", str(path.parent)]) == 1
    said = capsys.readouterr()
    assert "1 of 2 replay to the same score" in " ".join(said.out.split())
    assert path.name in said.err
    assert "good.npz" not in said.err


def test_what_cannot_be_read_costs_no_episode(demo: Demonstration, tmp_path: Path) -> None:
    (tmp_path / "MoveToRegion-Demo-expert-000.npz").symlink_to(tmp_path / "nowhere")
    (tmp_path / "MoveToRegion-Demo-expert-001.npz").mkdir()
    assert demos.keep(demo, tmp_path) == (tmp_path / "MoveToRegion-Demo-expert-002.npz", True)


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"actions": [0, 1]}, "actions must be an array"),
        ({"scene": None}, "the scene must be a magical_mj.Scene, not None"),
        ({"score": "1"}, "the score must be a number"),
        ({"seed": 1.5}, "seeds must be integers"),
    ],
)
def test_other_kinds_are_refused(changes: dict[str, Any], says: str, demo: Demonstration) -> None:
    with pytest.raises(DemonstrationError, match=says):
        replace(demo, **changes)


def test_equal_demonstrations_have_equal_names(demo: Demonstration) -> None:
    made = replace(demo, scene_seed=np.int64(demo.scene_seed), score=np.float64(1), variant="Demo")  # pyright: ignore[reportArgumentType]
    assert (made.name, type(made.scene_seed), type(made.score)) == (demo.name, int, float)
    jitter = demos.demonstrate("MoveToRegion", "TestJitter", 0)
    assert jitter.name == "MoveToRegion-Jitter"
    assert replace(jitter, variant="TestJitter").name == jitter.name


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


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_plan_that_fails_is_named_in_a_line(
    broken: str, tmp_path: Path, jobs: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["demos", "generate", "--tasks", f"{broken}:FAILS", "--variants", "Jitter", "--count", "2"]
    assert main([*command, "--jobs", jobs, "--out", str(tmp_path / "demos")]) != 0
    said = " ".join(capsys.readouterr().err.split())
    assert "Fails.plan failed: ZeroDivisionError: division by zero" in said
    assert "Traceback" not in said


def test_two_tasks_of_one_name_take_two_folders(
    broken: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """In one folder, the second one's demonstrations would be taken as made already."""
    tasks = f"{broken}:ONE,{broken}:OTHER"
    assert main(["demos", "generate", "--tasks", tasks, "--count", "1", "--out", str(tmp_path / "demos")]) == 2
    assert "are both called Same, and so would be their files: use two folders" in " ".join(
        capsys.readouterr().err.split()
    )
    assert not (tmp_path / "demos").exists()
