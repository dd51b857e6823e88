"""The demonstrations that come with the package: 25 of each task, all different, all replaying."""

from __future__ import annotations

import lzma
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj import TASKS, demos
from magical_mj.demos import shipped
from magical_mj.demos.recording import REST
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import DemonstrationError


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
    shipped.pack([ours[3], demos.read(tmp_path / "single.npz")], tmp_path / "FixColour.npz.xz")
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


def test_what_was_packed_is_read_to_the_bit_under_any_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The smallest numbers, in a process that takes the smallest ones for 0, and whose numpy raises errors."""
    demo, rng = demos.load("MoveToRegion")[0], np.random.default_rng(0)
    sizes = 10.0 ** rng.uniform(-330, -280, (2, *demo.qpos.shape))
    qpos, qvel = np.where(rng.random(sizes.shape) < 0.2, 0.0, sizes) * rng.choice([-1, 1], sizes.shape)
    odd = replace(demo, qpos=qpos, qvel=qvel)
    shipped.pack([odd, demo], tmp_path / "MoveToRegion.npz.xz")
    monkeypatch.setattr(shipped, "FOLDER", tmp_path)
    torch.set_flush_denormal(True)
    try:
        with np.errstate(all="raise"):
            again = demos.load("MoveToRegion")
    finally:
        torch.set_flush_denormal(False)
    assert [other.qpos.tobytes() for other in again] == [qpos.tobytes(), demo.qpos.tobytes()]


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_all_shipped_demonstrations_replay(task: str) -> None:
    assert all(demos.verify(demo).good for demo in demos.load(task))
