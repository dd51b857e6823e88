"""The original's demonstrations: files of the same layout are replayed, and hostile pickles run nothing."""

from __future__ import annotations

import collections
import dataclasses
import gzip
import os
import pickle
import sys
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import pytest

import magical_mj
from magical_mj.demos import from_original
from magical_mj.utils.errors import DemonstrationError
from tests.helpers.commands import Shell

Trajectory = NamedTuple("MAGICALTrajectory", [("acts", Any), ("obs", Any), ("rews", Any), ("infos", Any)])  # noqa: UP014
MODULE = "magical.saved_trajectories"


def packed(path: Path, content: object, protocol: int = 4) -> Path:
    """A file like those of the original: gzipped, with records by the names of its own classes."""
    module = ModuleType(MODULE)
    Trajectory.__module__, Trajectory.__qualname__ = MODULE, Trajectory.__name__
    module.MAGICALTrajectory, module.Slots = Trajectory, Slots  # type: ignore[attr-defined]
    before = {name: sys.modules.get(name) for name in ("magical", MODULE)}
    sys.modules |= {"magical": ModuleType("magical"), MODULE: module}
    try:
        path.write_bytes(gzip.compress(pickle.dumps(content, protocol), 1))
    finally:
        for name, old in before.items():
            sys.modules.pop(name) if old is None else sys.modules.update({name: old})
    return path


def episode(task: str, actions: Any, **others: Any) -> dict[str, Any]:
    frames = np.zeros((len(actions) + 1, 8, 8, 3), np.uint8)
    obs = collections.OrderedDict(allo=frames, ego=frames)
    trajectory = Trajectory(actions, obs, np.zeros(len(actions)), [{"eval_score": np.float64(0.0)}] * len(actions))
    return {"env_name": f"{task}-Demo-v0", "trajectory": trajectory, **others}


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_actions_are_replayed_and_their_scores_compared(tmp_path: Path, protocol: int, shell: Shell) -> None:
    demo = magical_mj.demos.load("MoveToRegion")[3]
    good = packed(tmp_path / "demo-good.pkl.gz", episode("MoveToRegion", demo.actions.astype(np.int64)), protocol)
    again, score = from_original(good)
    assert (again.score, score, again.demonstrator) == (1.0, None, "human")
    np.testing.assert_array_equal(again.qpos, demo.qpos)
    idle = episode("MoveToRegion", [0] * 40, score=np.float64(1.0))
    bad = packed(tmp_path / "demo-bad.pkl.gz", idle, protocol)
    assert from_original(bad)[1] == 1.0
    code, out, _ = shell("demos", "import", good, bad, "--out", "in")
    assert code == 0
    assert "score 0.00, in the original's simulation 1.00" in out
    assert "1 of 2 episodes have score 1" in out
    (first, _) = magical_mj.demos.load("MoveToRegion", "in")
    assert magical_mj.demos.verify(first).exact
    assert "imported already" in shell("demos", "import", good, "--out", "in")[1]


def test_fields_in_another_order_and_in_dicts_are_found(tmp_path: Path) -> None:
    actions = magical_mj.demos.load("FindDupe")[0].actions
    whole = episode("FindDupe", actions)
    for number, trajectory in enumerate(
        (
            {"obs": whole["trajectory"].obs, "acts": actions.astype(">i4")},
            (whole["trajectory"].obs, actions.tolist(), np.zeros(len(actions))),
            Trajectory(whole["trajectory"].obs, np.full(len(actions), 300), actions, []),
        )
    ):
        path = packed(tmp_path / f"demo-{number}.pkl.gz", {**whole, "trajectory": trajectory})
        assert from_original(path).demonstration.score == 1.0


@dataclasses.dataclass(slots=True)
class Slots:
    """A record whose class has slots."""

    acts: Any
    obs: Any


@pytest.mark.parametrize("score", [1, 0.5, np.float16(0.5), np.float32(0.5), np.int64(1), None])
def test_records_with_slots_and_all_kinds_of_scores_are_read(tmp_path: Path, score: Any) -> None:
    Slots.__module__ = MODULE
    whole = episode("MoveToRegion", magical_mj.demos.load("MoveToRegion")[0].actions, score=score)
    whole["trajectory"] = Slots(whole["trajectory"].acts, whole["trajectory"].obs)
    assert from_original(packed(tmp_path / "demo.pkl.gz", whole)).score == score


class Runs:
    """Runs a command when it is unpickled by anything that imports names."""

    def __init__(self, function: Any, *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


class Sets:
    """Sets attributes of what a name stands for."""

    def __reduce__(self) -> Any:
        return np.dtype, ("u1",), (None, {"__setstate__": 3, "name": "O", "__class__": np.ndarray})


@pytest.mark.parametrize(
    ("hostile", "message"),
    [
        (Runs(os.system, "touch owned"), "refers to posix.system, and demonstrations are read without running code"),
        (Runs(eval, "open('owned', 'w')"), "refers to builtins.eval"),
        (Runs(getattr, "", "join"), "refers to builtins.getattr"),
        (Runs(np.load, "owned", None, True), r"refers to numpy\.\S*load"),
        (np.array([Runs(os.system, "touch owned")], object), "refers to posix.system"),
        ({Path("owned")}, "refers to pathlib"),
        (Sets(), "no demonstration|not a pickle"),
        (collections.Counter("ab"), "refers to collections.Counter"),
    ],
    ids=range(8),
)
def test_hostile_pickles_are_refused_and_run_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hostile: Any, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for number, content in enumerate((hostile, {"env_name": hostile}, {**episode("FindDupe", [0]), "score": hostile})):
        path = tmp_path / f"demo-{number}.pkl.gz"
        path.write_bytes(gzip.compress(pickle.dumps(content if number < 2 else {"score": hostile}, 4)))
        with pytest.raises(DemonstrationError, match=f"{message}|lacks env_name"):
            from_original(path)
        assert not (tmp_path / "owned").exists()


def stacked(*names: str) -> bytes:
    """A pickle of a name of the module `magical`, given in two parts."""
    return b"\x80\x04" + b"".join(b"\x8c" + bytes([len(name)]) + name.encode() for name in names) + b"\x93."


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"not a pickle", "not a pickle"),
        (pickle.dumps({"a": 1})[:-3], "not a pickle"),
        (b"\x80\x04N\x72\xff\xff\xff\x0f.", "memo is damaged"),  # would take gigabytes
        (b"\x80\x04K\x01Q.", "BINPERSID"),
        (b"(cos\nsystem\nS'touch owned'\no.", "OBJ|S'|refers to os.system"),
        (b"\x80\x02\x82\x01.", "EXT1"),
        (stacked("magical", "os.system"), "refers to magical.os.system"),
        (stacked("numpy.core.multiarray", "frombuffer"), r"refers to numpy.core.multiarray.frombuffer"),
        (stacked("collections", "OrderedDict.fromkeys"), "refers to collections.OrderedDict.fromkeys"),
        (b"(" * 30_000 + b".", "unexpected MARK"),
        (b"(" * 300_000 + b".", "more than 60,000 operations"),
        (b"".join(b"cmagical\na%d\n" % number for number in range(200)) + b".", "more than 100 names"),
    ],
    ids=range(12),
)
def test_damaged_and_forged_pickles_are_refused(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "demo-x.pkl.gz"
    path.write_bytes(gzip.compress(content))
    with pytest.raises(DemonstrationError, match=message):
        from_original(path)


def test_wrong_episodes_are_explained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = episode("MoveToRegion", np.zeros(40, np.int64))
    for change, message in (
        ({"env_name": "MoveToRegion-TestAll-v0"}, "only episodes in the demo scenes"),
        ({"env_name": "Walk-Demo-v0"}, "is of 'Walk-Demo-v0'"),
        ({"env_name": 3}, "is of 3"),
        ({"trajectory": None}, "has no actions"),
        ({"trajectory": Trajectory(np.full(40, 18), {}, [], [])}, "has no actions"),
        ({"trajectory": Trajectory(np.zeros(0, np.int64), {}, [], [])}, "has no actions"),
        ({"trajectory": Trajectory(np.zeros(41, np.int64), {}, [], [])}, "41 actions, and episodes .* have 40"),
        ({"trajectory": Trajectory(np.array(["a"], object), {}, [], [])}, "has no actions"),
    ):
        with pytest.raises(DemonstrationError, match=message):
            from_original(packed(tmp_path / "demo-x.pkl.gz", {**whole, **change}))
    (tmp_path / "demo-y.pkl.gz").write_bytes(b"no gzip")
    with pytest.raises(DemonstrationError, match="not compressed by gzip"):
        from_original(tmp_path / "demo-y.pkl.gz")
    monkeypatch.setattr("magical_mj.demos.original.MOST_UNPACKED", 1_000_000)
    (tmp_path / "demo-z.pkl.gz").write_bytes(gzip.compress(bytes(1_000_001), 1))
    with pytest.raises(DemonstrationError, match="unpacks to more than"):
        from_original(tmp_path / "demo-z.pkl.gz")


def test_files_cannot_change_how_later_ones_are_read(tmp_path: Path) -> None:
    """They cannot set attributes of the classes that take the place of others."""
    spoil = b"\x80\x04\x8c\x07magical\x8c\x01T\x93N}\x8c\x07__new__K\x03s\x86b."  # setattr(magical.T, "__new__", 3)
    path = tmp_path / "demo-x.pkl.gz"
    for content in (spoil, spoil.replace(b"\x07magical\x8c\x01T", b"\x05numpy\x8c\x07ndarray")):
        path.write_bytes(gzip.compress(content))
        with pytest.raises(DemonstrationError, match="not a pickle of a demonstration: TypeError"):
            from_original(path)
    good = packed(path, episode("MoveToRegion", magical_mj.demos.load("MoveToRegion")[0].actions))
    assert from_original(good).demonstration.score == 1.0
