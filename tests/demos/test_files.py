"""Demonstrations as files, also the shipped ones: they lose nothing, tell of every damage, and choose no code."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import lzma
import os
import shutil
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import magical_mj
from magical_mj import TASKS, demos
from magical_mj.demos import Demonstration, shipped
from magical_mj.demos.demonstration import ARRAYS, MOST_BYTES, _digest
from magical_mj.demos.recording import REST
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError, SettingsError, UnknownNameError, UntrustedNameError
from tools.pack_demonstrations import pack


@pytest.fixture(scope="module")
def demo() -> Demonstration:
    return demos.load("MoveToRegion")[0]


@pytest.fixture
def path(demo: Demonstration, tmp_path: Path) -> Path:
    demos.write(demo, tmp_path / "MoveToRegion-Demo-000.npz")
    return tmp_path / "MoveToRegion-Demo-000.npz"


def equal(one: Demonstration, other: Demonstration) -> bool:
    fields = [(getattr(one, f.name), getattr(other, f.name)) for f in dataclasses.fields(Demonstration)]
    return all(np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b for a, b in fields)


def parts_of(path: Path) -> dict[str, Any]:
    with np.load(path) as archive:
        return {name: archive[name] for name in archive}


def forge(path: Path, header: dict[str, Any] | None = None, **arrays: Any) -> None:
    """Rewrites a file with other content and a digest that fits it, as somebody who knows this package could."""
    parts = parts_of(path) | arrays
    fields = json.loads(parts["header"].tobytes()) | (header or {})
    fields.pop("digest")
    text = json.dumps({**fields, "digest": _digest(fields, {name: parts[name] for name in ARRAYS})}).encode()
    np.savez_compressed(path, **{**parts, "header": np.frombuffer(text, np.uint8)})


def compressed_by(compression: int, path: Path) -> bytes:
    """The same members in an archive of another compression."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", compression) as archive, zipfile.ZipFile(path) as members:
        for name in members.namelist():
            archive.writestr(name, members.read(name))
    return content.getvalue()


def test_a_file_gives_back_what_was_written_and_is_not_overwritten(demo: Demonstration, path: Path) -> None:
    again = demos.read(path, "MoveToRegion")
    assert equal(again, demo)
    assert again.rescored() == again.score == 1.0
    before = path.read_bytes()
    with pytest.raises(FileExistsError):
        demos.write(demo, path)
    assert path.read_bytes() == before
    with pytest.raises(DemonstrationError, match=r"\.npz"):
        demos.write(demo, path.with_name("demo"))  # which would not be found again
    assert list(path.parent.iterdir()) == [path]


def test_no_damage_goes_unnoticed_or_raises_something_else(demo: Demonstration, path: Path) -> None:
    whole = path.read_bytes()
    for length in (0, 1, 50, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(DemonstrationError, match="damaged"):
            demos.read(path)
    for compression in (zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED, zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2):
        path.write_bytes(whole)
        archive = compressed_by(compression, path)
        for place in np.random.default_rng(0).integers(len(archive), size=60).tolist():
            path.write_bytes(archive[:place] + bytes([archive[place] ^ 0x55]) + archive[place + 1 :])
            with contextlib.suppress(DemonstrationError):
                assert equal(demos.read(path), demo)  # some bytes of a zip archive mean nothing


def test_altered_arrays_are_noticed(demo: Demonstration, path: Path) -> None:
    parts = parts_of(path)
    for name in ARRAYS:
        array = getattr(demo, name).copy()
        array.flat[3] += 1
        np.savez_compressed(path, **parts | {name: array})
        with pytest.raises(DemonstrationError, match="altered"):
            demos.read(path)


def test_another_version_another_task_and_other_files_are_named(path: Path) -> None:
    with pytest.raises(DemonstrationError, match="not of MakeLine"):
        demos.read(path, "MakeLine")
    parts = parts_of(path)
    for text, problem in ((b'{"format": 99}', "format 99"), (b"no json", "header"), (b"[" * 200_000, "header")):
        np.savez_compressed(path, **parts | {"header": np.frombuffer(text, np.uint8)})
        with pytest.raises(DemonstrationError, match=problem):
            demos.read(path)
    for other in ({"something": np.zeros(3)}, parts | {"header": np.array([{}], dtype=object)}):  # a pickle
        np.savez(path, **other)
        with pytest.raises(DemonstrationError, match="damaged"):
            demos.read(path)
    with pytest.raises(FileNotFoundError):
        demos.read(path.with_name("none.npz"))
    with pytest.raises(SettingsError, match="path"):
        demos.read(b"none.npz")  # pyright: ignore[reportArgumentType]


def test_headers_are_checked(path: Path) -> None:
    headers: list[dict[str, Any]] = [
        *({"score": score} for score in ("1.0", None, True, 5.0, float("nan"))),
        *({"scene_seed": seed} for seed in ("abc", -3, 1.5, True)),
        {"seed": [1]},
        {"package": 3},
        {"demonstrator": "robot"},
        {"variant": "Nowhere"},
        {"variant": ["Demo"]},
        {"task": None},
        {"scene": {}},
    ]
    whole = path.read_bytes()
    for header in headers:
        path.write_bytes(whole)
        forge(path, header)
        with pytest.raises(DemonstrationError, match=f"{path.name} does not describe"):
            demos.read(path)


def test_arrays_that_do_not_fit_are_neither_read_nor_written(demo: Demonstration, path: Path) -> None:
    changes = [
        {"actions": demo.actions[1:]},
        {"actions": demo.actions.astype(float)},
        {"actions": np.full_like(demo.actions, 18)},
        {"qpos": demo.qpos * np.nan},
        {"qpos": demo.qpos[:, :-3]},
        {"qvel": demo.qvel[0]},
    ]
    for change in changes:
        with pytest.raises(DemonstrationError):
            demos.write(dataclasses.replace(demo, **change), path.with_name("other.npz"))
        forge(path, **change)
        with pytest.raises(DemonstrationError, match="does not describe"):
            demos.read(path)
        path.unlink()
        demos.write(demo, path)


def test_sizes_are_bounded_before_anything_is_unpacked(path: Path) -> None:
    whole = path.read_bytes()
    forge(path, actions=np.zeros(60_000_000, np.uint8))
    assert path.stat().st_size < 200_000
    with pytest.raises(DemonstrationError, match=f"{MOST_BYTES:,}"):
        demos.read(path)
    path.write_bytes(whole)
    path.write_bytes(compressed_by(zipfile.ZIP_LZMA, path))  # whose reader unpacks as much as there is
    with pytest.raises(DemonstrationError, match="deflate"):
        demos.read(path)
    os.truncate(path, MOST_BYTES + 1)
    with pytest.raises(DemonstrationError, match=f"{MOST_BYTES:,}"):
        demos.read(path)


def test_a_new_episode_is_saved_whatever_lies_beside_it(demo: Demonstration, tmp_path: Path) -> None:
    names = [tmp_path / f"MoveToRegion-Demo-expert-{number:03}.npz" for number in range(7)]
    names[0].symlink_to(tmp_path / "nowhere")
    names[1].mkdir()
    os.mkfifo(names[2])
    names[3].symlink_to("/dev/zero")
    demos.write(demo, names[4])
    names[4].write_bytes(names[4].read_bytes()[:100])
    with zipfile.ZipFile(names[5], "w", zipfile.ZIP_LZMA) as archive:
        archive.writestr("header.npy", b"x" * 1000)
    names[5].write_bytes(names[5].read_bytes().replace(lzma.compress(b"")[-4:], b"0000"))
    assert demos.keep(demo, tmp_path) == (names[6], True)
    assert equal(demos.read(names[6]), demo)
    assert demos.keep(demo, tmp_path) == (names[6], False)
    with pytest.raises(FileExistsError):
        demos.keep(demo, names[6])


def test_only_whole_files_of_the_task_are_found(path: Path, tmp_path: Path) -> None:
    shutil.copy(path, path.with_name(f".{path.stem}.0123abcd-4567cdef.part.npz"))
    assert demos.files_in(path.parent) == [path]
    assert len(demos.load("MoveToRegion", path.parent)) == 1
    for folder in (tmp_path, ""):  # as of a variable that is not set
        with pytest.raises(DemonstrationError, match="no demonstrations of FindDupe"):
            demos.load("FindDupe", folder)
    with pytest.raises(UnknownNameError):
        demos.load("FindDup")


def test_a_file_chooses_no_code(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "stranger_read.py").write_text(
        'from pathlib import Path\nPath("ran").touch()\nfrom dataclasses import replace\n'
        'from magical_mj.tasks.move_to_region import SPEC as OURS\nSPEC = replace(OURS, name="Strange")\n'
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", sys.path[:])
    task = "stranger_read:SPEC"
    forge(path, {"task": task})
    with pytest.raises(UntrustedNameError, match=task):
        demos.read(path)
    assert not Path("ran").exists()
    assert demos.read(path, trusted=[task]).name == demos.read(path, task).name == "Strange-Demo"
    assert Path("ran").exists()


@pytest.mark.parametrize("task", TASKS)
def test_25_demonstrations_of_each_task_are_shipped_and_differ(task: str) -> None:
    shipped = demos.load(task)
    assert len(shipped) == 25
    assert {(d.task, d.variant, d.demonstrator, d.score) for d in shipped} == {(task, "Demo", "expert", 1.0)}
    assert all(d.scene == magical_mj.sample_scene(task, "Demo", d.scene_seed) for d in shipped)
    assert max(len(d.actions) for d in shipped) <= task_spec(task).horizon()
    assert all(len(d.actions) == task_spec(task).horizon() or not d.actions[-REST:].any() for d in shipped)
    assert len({d.actions.tobytes() for d in shipped}) == 25
    assert demos.diversity(demo for demo in shipped).ways > 0.05


def test_packed_demonstrations_are_the_same_and_tell_of_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    assert shipped.load_shipped("FixColour", "FixColour") == []
    monkeypatch.undo()
    ours = demos.load("FixColour")
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    demos.write(ours[7], tmp_path / "single.npz")
    pack([ours[3], demos.read(tmp_path / "single.npz")], tmp_path / "FixColour.npz.xz")
    again = demos.load("FixColour")
    assert [demo.digest for demo in again] == [ours[3].digest, ours[7].digest]
    assert again[1].qvel.tobytes() == ours[7].qvel.tobytes()
    with pytest.raises(DemonstrationError, match="not of MakeLine"):
        shipped.load_shipped("MakeLine", "FixColour")
    content = bytearray(lzma.decompress((tmp_path / "FixColour.npz.xz").read_bytes()))
    content[content.index(b"expert")] ^= 1
    (tmp_path / "FixColour.npz.xz").write_bytes(lzma.compress(content))
    with pytest.raises((DemonstrationError, zipfile.BadZipFile)):
        demos.load("FixColour")


def test_packed_demonstrations_are_read_to_the_bit_under_any_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The smallest numbers, in a process that takes the smallest ones for 0, and whose numpy raises errors."""
    demo, rng = demos.load("MoveToRegion")[0], np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(-330, -280, (2, *demo.qpos.shape))
    qpos, qvel = np.where(rng.random(sizes.shape) < 0.2, 0.0, sizes) * rng.choice([-1, 1], sizes.shape)
    odd = replace(demo, qpos=qpos, qvel=qvel)
    pack([odd, demo], tmp_path / "MoveToRegion.npz.xz")
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    torch = pytest.importorskip("torch")  # there is none where MuJoCo 4 is tested
    torch.set_flush_denormal(True)
    try:
        with np.errstate(all="raise"):
            again = demos.load("MoveToRegion")
    finally:
        torch.set_flush_denormal(False)
    assert [other.qpos.tobytes() for other in again] == [qpos.tobytes(), demo.qpos.tobytes()]


def test_50_demonstrations_of_sweep_to_top_by_each_body_are_played_again() -> None:
    content = hashlib.sha256(lzma.decompress(shipped.FILES[1].read_bytes())).hexdigest()
    assert content.startswith("722db557a49ef4d5"), "policies that learnt from it no longer compare"
    rows = shipped.stored_rows(shipped.FILES[1])
    for body in task_spec("SweepToTop").bodies:
        ours = demos.load("SweepToTop", body=body)
        own = [row for row in rows if row.body == body]
        assert len(ours) == len(own) == 50
        assert [(d.scene_seed, d.seed) for d in ours] == [(row.seed, row.seed) for row in own]
        assert [d.score for d in ours] == pytest.approx([row.score for row in own], abs=0.01)
        assert {d.actions.shape[1] for d in ours} == {3 if body == "gripper" else 2}


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_shipped_demonstrations_replay(task: str) -> None:
    """Four of them: `magical-mj demos verify` replays all."""
    assert all(demos.verify(demo).good for demo in demos.load(task)[::7])
