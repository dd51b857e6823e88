"""Demonstrations: files that lose nothing and tell of every damage, replay, what learners get, exports, commands."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import gymnasium
import numpy as np
import pytest

import magical_mj
from magical_mj import demos
from magical_mj.cli import main
from magical_mj.cli.demos import make
from magical_mj.demos import Demonstration
from magical_mj.envs.presets import PRESETS
from magical_mj.utils.errors import DemonstrationError, MagicalError, UnknownNameError


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    """A short one."""
    return demos.demonstrate("FixColour", "Demo", 0)


@pytest.fixture
def path(demo: Demonstration, tmp_path: Path) -> Path:
    path = tmp_path / "FixColour-Demo-000.npz"
    demos.write(demo, path)
    return path


def equal(one: Demonstration, other: Demonstration) -> bool:
    fields = [(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(Demonstration)]
    return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in fields)


def damaged(path: Path, **changes: object) -> None:
    """Rewrites a file with other parts, as somebody with numpy could."""
    with np.load(path) as archive:
        parts = {name: archive[name] for name in archive}
    np.savez_compressed(path, **(parts | changes))


# files


def test_a_file_gives_back_what_was_written(demo: Demonstration, path: Path) -> None:
    again = demos.read(path, "FixColour")
    assert equal(again, demo)
    assert again.rescored() == again.score == 1.0
    assert demos.verify(again) == demos.Verdict(scene=True, score=True, replay=True, exact=True, pictures=True)
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_nothing_is_overwritten(demo: Demonstration, path: Path) -> None:
    before = path.read_bytes()
    with pytest.raises(FileExistsError, match="exists already"):
        demos.write(demo, path)
    assert path.read_bytes() == before
    assert [p.name for p in path.parent.iterdir()] == [path.name]


def test_only_names_that_are_found_again_are_written(demo: Demonstration, tmp_path: Path) -> None:
    with pytest.raises(DemonstrationError, match=r"demo must end in \.npz"):
        demos.write(demo, tmp_path / "demo")
    assert not list(tmp_path.iterdir())


def test_no_truncated_file_is_read(path: Path) -> None:
    whole = path.read_bytes()
    for length in (0, 1, 50, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(DemonstrationError, match="damaged or cut short"):
            demos.read(path)


def test_no_flipped_byte_goes_unnoticed(demo: Demonstration, path: Path) -> None:
    whole = path.read_bytes()
    for place in np.random.default_rng(0).integers(len(whole), size=60).tolist():
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        with contextlib.suppress(DemonstrationError):
            assert equal(demos.read(path), demo)  # some bytes of a zip archive mean nothing


@pytest.mark.parametrize("name", ["actions", "qpos", "qvel"])
def test_altered_arrays_are_noticed(name: str, demo: Demonstration, path: Path) -> None:
    array = getattr(demo, name).copy()
    array.flat[3] += 1
    damaged(path, **{name: array})
    with pytest.raises(DemonstrationError, match="altered"):
        demos.read(path)


def test_states_of_another_scene_are_refused(demo: Demonstration) -> None:
    with pytest.raises(DemonstrationError, match="have 21 positions and velocities, not"):
        dataclasses.replace(demo, qpos=demo.qpos[:, :-3])


def test_another_version_another_task_and_other_files_are_named(
    demo: Demonstration, path: Path, tmp_path: Path
) -> None:
    with pytest.raises(DemonstrationError, match="of FixColour, not of MakeLine"):
        demos.read(path, "MakeLine")
    damaged(path, header=np.frombuffer(b'{"format": 99}', np.uint8))
    with pytest.raises(DemonstrationError, match="format 99"):
        demos.read(path)
    damaged(path, header=np.frombuffer(b"no json", np.uint8))
    with pytest.raises(DemonstrationError, match="header"):
        demos.read(path)
    np.savez(path, something=np.zeros(3))
    with pytest.raises(DemonstrationError, match="damaged"):
        demos.read(path)
    np.savez(path, header=np.array([{}], dtype=object), actions=1, qpos=2, qvel=3)  # a pickle is never opened
    with pytest.raises(DemonstrationError, match="damaged"):
        demos.read(path)
    with pytest.raises(FileNotFoundError):
        demos.read(tmp_path / "none.npz")


def test_parts_that_do_not_fit_are_refused(demo: Demonstration) -> None:
    bad = [
        {"actions": demo.actions[1:]},
        {"actions": demo.actions.astype(float)},
        {"actions": np.full_like(demo.actions, 18)},
        {"qpos": demo.qpos * np.nan},
        {"demonstrator": "robot"},
        {"variant": "Nowhere"},
    ]
    for change in bad:
        with pytest.raises(MagicalError):
            dataclasses.replace(demo, **change)


def test_folders_without_demonstrations_are_told(tmp_path: Path) -> None:
    with pytest.raises(DemonstrationError, match="no demonstrations of FindDupe"):
        demos.load("FindDupe", tmp_path)
    with pytest.raises(UnknownNameError):
        demos.load("FindDup")


# what is seen


def test_pictures_from_states_are_those_of_the_episode(demo: Demonstration) -> None:
    env = magical_mj.load("FixColour", scene=demo.scene, image_size=64)
    seen = [env.reset().observation, *(env.step(action).observation for action in demo.actions.tolist())]
    drawn = list(demos.see(demo, ("ego", "allo"), 64))
    assert len(drawn) == len(seen) == 61
    assert all(np.array_equal(a[view], b[view]) for a, b in zip(drawn, seen, strict=True) for view in ("ego", "allo"))


@pytest.mark.parametrize("preset", PRESETS)
def test_observations_are_those_of_the_gymnasium_environment(demo: Demonstration, preset: str) -> None:
    short = dataclasses.replace(demo, actions=demo.actions[:6], qpos=demo.qpos[:7], qvel=demo.qvel[:7])
    env = gymnasium.make(magical_mj.env_id("FixColour", "Demo", preset))
    first, _ = env.reset(seed=demo.scene_seed)
    seen = [first, *(env.step(action)[0] for action in short.actions.tolist())]
    rows = demos.observations(short, preset)
    for number, wanted in enumerate(seen):
        if isinstance(rows, dict):
            assert all(np.array_equal(rows[view][number], wanted[view]) for view in rows)
        else:
            assert np.array_equal(rows[number], wanted)
    env.close()


def test_transitions_are_what_learners_want(demo: Demonstration) -> None:
    both = [demo, demo]
    busy = int((demo.actions != 0).sum())
    seen, acted = demos.transitions(both, preset="LoRes4E")
    assert (seen.shape, seen.dtype) == ((2 * busy, 96, 96, 12), np.uint8)
    assert (acted != 0).all()
    everything = demos.transitions(both, preset="LoRes4E", drop_noop=False)
    assert np.array_equal(everything.actions, np.concatenate([demo.actions, demo.actions]))
    start = everything.observations[0]
    assert all(np.array_equal(start[..., :3], start[..., k : k + 3]) for k in (3, 6, 9))
    with pytest.raises(DemonstrationError):
        demos.transitions([])


def test_streams_draw_nothing_before_it_is_asked_for(demo: Demonstration) -> None:
    def endless() -> Iterator[Demonstration]:
        while True:
            yield demo

    stream = demos.stream(endless(), "LoRes4A")
    assert len(next(stream).actions) == len(next(stream).actions)


# commands


def run(*arguments: object) -> int:
    return main([str(argument) for argument in arguments])


def test_generate_verify_info_video_and_export(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "made"
    generate = (
        "demos",
        "generate",
        "--tasks",
        "MoveToRegion",
        "--variants",
        "All",
        "--out",
        folder,
        "--jobs",
        1,
        "--count",
    )
    assert run(*generate, 2) == 0
    first = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert sorted(first) == ["MoveToRegion-All-000.npz", "MoveToRegion-All-001.npz"]
    assert run(*generate, 3) == 0
    assert "2 of 3 are there already" in capsys.readouterr().out
    assert all((folder / name).read_bytes() == content for name, content in first.items())
    assert run("demos", "verify", folder, "--jobs", 1) == 0
    assert (
        "3 of 3 replay to the same score, 3 through the same states, 3 with the same pictures"
        in capsys.readouterr().out
    )
    assert run("demos", "info", folder / "MoveToRegion-All-001.npz") == 0
    assert "MoveToRegion-All" in capsys.readouterr().out
    assert run("demos", "video", folder / "MoveToRegion-All-001.npz", "--out", tmp_path / "x.mp4", "--size", 32) == 0
    assert (tmp_path / "x.mp4").stat().st_size > 1000
    assert run("demos", "export", folder, "--out", tmp_path / "x.npz", "--preset", "State") == 0
    assert (tmp_path / "x.npz").exists()
    capsys.readouterr()
    assert run("demos", "export", folder, "--out", folder / "x.npz", "--preset", "State") == 2
    assert "would lie among the demonstrations" in capsys.readouterr().err
    assert run("demos", "verify", folder, "--tasks", "MakeLine", "--jobs", 1) == 2
    assert "none of the 3 files is of these tasks" in capsys.readouterr().err


def test_generate_takes_what_another_process_was_faster_to_make(path: Path) -> None:
    before = path.read_bytes()
    assert make(("FixColour", "Demo", 0, 1.0, path)) == ""
    assert path.read_bytes() == before


def test_a_damaged_file_stops_generate_and_verify(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path.write_bytes(path.read_bytes()[:-10])
    generate = ("generate", "--tasks", "FixColour", "--count", 1, "--out", path.parent)
    for code, *command in (2, *generate), (1, "verify", path), (2, "info", path):
        assert run("demos", *command) == code
        assert "damaged or cut short" in capsys.readouterr().err
    assert run("demos", "info", path.parent / "none.npz") == 2


def test_verify_tells_what_does_not_replay(
    demo: Demonstration, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = dataclasses.replace(demo, actions=np.zeros_like(demo.actions))
    demos.write(other, tmp_path / "bad.npz")
    demos.write(demo, tmp_path / "good.npz")
    demos.write(dataclasses.replace(demo, variant="Layout", scene_seed=5), tmp_path / "moved.npz")
    assert run("demos", "verify", tmp_path, "--jobs", 1) == 1
    out, error = capsys.readouterr()
    assert "2 of 3 replay" in out
    assert "moved.npz does not start in the scene that its variant and seed have" in error
    assert "bad.npz does not replay" in error
    assert "good.npz" not in error


def test_a_killed_generate_leaves_only_whole_files_and_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "magical_mj", "demos", "generate", "--tasks", "MatchRegions"]
    process = subprocess.Popen(
        [*command, "--count", "40", "--out", str(tmp_path), "--jobs", "1"],
        stdout=subprocess.DEVNULL,
        start_new_session=True,
    )
    for _ in range(1200):
        if demos.files_in(tmp_path):
            break
        time.sleep(0.1)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    made = demos.load("MatchRegions", tmp_path)
    assert 0 < len(made) < 40
    more = ("--tasks", "MatchRegions", "--count", len(made) + 1)
    assert run("demos", "generate", *more, "--out", tmp_path, "--jobs", 1) == 0
    assert len(demos.load("MatchRegions", tmp_path)) == len(made) + 1


def test_half_written_files_are_not_read(path: Path) -> None:
    shutil.copy(path, path.with_name(f".{path.stem}.123.part.npz"))
    assert demos.files_in(path.parent) == [path]
    assert len(demos.load("FixColour", path.parent)) == 1
