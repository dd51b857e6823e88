"""What a training takes for its own in a folder, and what it refuses: files that are damaged, lost, or of others."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from magical_mj.learners import checkpoint, load_policy, train
from magical_mj.learners.bc import BehaviouralCloning
from magical_mj.learners.policy import POLICY
from magical_mj.learners.run_folder import CHECKPOINT, CONFIG, METRICS
from magical_mj.utils.errors import MagicalError, TrainingError
from magical_mj.utils.files import read_toml
from tests.helpers.learners import from_states, is_done, stopped, tiny


@pytest.fixture(scope="module")
def stopped_one(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stopped")
    stopped(folder, from_states())
    return folder


@pytest.fixture
def begun(stopped_one: Path, tmp_path: Path) -> Path:
    """A training from states that was stopped after its third update."""
    return shutil.copytree(stopped_one, tmp_path / "begun")


def with_tree(path: Path, tree: str) -> None:
    """Replaces everything but the tensors."""
    with safe_open(path, "pt") as file:
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    save_file(tensors, path, {"tree": tree})


def test_what_a_killed_training_left_unfinished_is_no_obstacle(tmp_path: Path) -> None:
    """It was killed while it wrote its first file; a file of somebody else with a like name is one."""
    left = tmp_path / "run" / ".config.0123abcd-4567cdef.part.toml"
    left.parent.mkdir()
    left.touch()
    train(from_states(), left.parent, resume=True)
    assert is_done(left.parent)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / ".notes.part.toml").touch()
    with pytest.raises(TrainingError, match="something else"):
        train(from_states(), tmp_path / "mine")


def test_trees_of_other_shapes_are_refused(begun: Path) -> None:
    pairs = ['{"pairs": [1]}', '{"pairs": [[{"pairs": []}, 1]]}', '{"pairs": 3}']
    for tree in ("[]", "null", '"text"', *pairs, "[" * 10**5, "{}"):
        for name in (CHECKPOINT, POLICY):
            with_tree(begun / name, tree)
        with pytest.raises(TrainingError, match=CHECKPOINT):
            train(from_states(), begun, resume=True)
        with pytest.raises(TrainingError, match=POLICY):
            load_policy(begun)


def test_checkpoints_that_make_no_sense_are_refused(begun: Path) -> None:
    saved = checkpoint.read(begun / CHECKPOINT)
    for change in (
        *({"update": wrong} for wrong in ("7", 5.5, 13, -1, True, None)),
        {"updates": "12"},
        *({"seconds": wrong} for wrong in ("1", None)),
        *({"settings": wrong} for wrong in (3, "[", "[]")),
        *({"learner": wrong} for wrong in (None, [], {}, {**saved["learner"], "optimizer": None})),
        {"update": 40, "updates": 99},
    ):
        checkpoint.write(begun / CHECKPOINT, {**saved, **change})
        before = (begun / CHECKPOINT).read_bytes()
        with pytest.raises(TrainingError, match="damaged, or does not fit"):
            train(from_states(), begun, resume=True)
        assert (begun / CHECKPOINT).read_bytes() == before


def test_policies_that_make_no_sense_are_refused(begun: Path) -> None:
    saved = checkpoint.read(begun / POLICY)
    for change in (
        *({"network": {name: 0}} for name in ("hidden", "attention", "entity")),
        *({"network": wrong} for wrong in (None, {"hidden": 10**5}, {"first_stride": 1.5}, {"hiden": 3})),
        *({"tasks": wrong} for wrong in (None, [], [3], 7)),
        *({"preset": wrong} for wrong in (None, "LoRes5E", [])),
        {"weights": None},
    ):
        checkpoint.write(begun / POLICY, {**saved, **change})
        with pytest.raises(TrainingError, match="something else than a policy"):
            load_policy(begun)
    for damaged in (b"not a safetensors file at all", (begun / POLICY).read_bytes()[:-1000], None):
        (begun / POLICY).unlink() if damaged is None else (begun / POLICY).write_bytes(damaged)
        with pytest.raises(TrainingError, match=r"policy\.safetensors"):
            load_policy(begun)


def test_another_trainings_files_are_not_taken_for_ones_own(tmp_path: Path) -> None:
    """Neither its checkpoint nor its policy; nothing is overwritten."""
    run, other = tmp_path / "run", tmp_path / "other"
    train(from_states(), run)
    train(from_states(seed=3), tmp_path / "seed")
    train(from_states(tasks="FixColour"), other)
    for name, says in ((CHECKPOINT, "tasks: .*FixColour"), (POLICY, "tasks: .*FixColour.*and here .*MoveToRegion")):
        before = (run / name).read_bytes()
        shutil.copy(other / name, run / name)
        with pytest.raises(TrainingError, match=f"of another training .{says}"):
            train(from_states(), run, resume=True)
        assert (run / name).read_bytes() == (other / name).read_bytes()
        (run / name).write_bytes(before)
    shutil.copy(tmp_path / "seed" / CHECKPOINT, run / CHECKPOINT)
    with pytest.raises(TrainingError, match=r"of another training \(seed: 3"):
        train(from_states(), run, resume=True)


def test_without_its_checkpoint_a_training_begins_anew_only_when_told(tmp_path: Path) -> None:
    run = tmp_path / "run"
    train(from_states(), run)
    (run / CHECKPOINT).unlink()
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(TrainingError, match=rf"{CHECKPOINT} is missing.* delete {POLICY} and metrics\.csv"):
        train(from_states(), run, resume=True)
    assert before == {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    (run / POLICY).unlink()
    (run / METRICS).unlink()
    train(from_states(), run, resume=True)
    assert is_done(run)


@pytest.mark.parametrize(("checkpoints", "written"), [(1, 0), (1, 1), (4, 7)])
def test_a_training_that_ends_before_or_between_its_files_goes_on(
    checkpoints: int, written: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There are rows of metrics, and perhaps a checkpoint, but no policy yet; or not the last of both."""
    original, paths = checkpoint.write, list[Path]()

    def write(path: Path, kept: dict[str, Any]) -> None:
        if len(paths) == written:
            raise KeyboardInterrupt
        paths.append(path)
        original(path, kept)

    monkeypatch.setattr(checkpoint, "write", write)
    with pytest.raises(KeyboardInterrupt):
        train(from_states(checkpoints=checkpoints), tmp_path / "run")
    monkeypatch.undo()
    assert (tmp_path / "run" / METRICS).exists()
    assert (tmp_path / "run" / POLICY).exists() == (checkpoints > 1)
    train(from_states(checkpoints=checkpoints), tmp_path / "run", resume=True)
    assert is_done(tmp_path / "run")


def test_a_training_goes_on_with_as_many_threads_as_it_began(tmp_path: Path) -> None:
    """On pictures: with another number, sums are rounded differently."""
    before, numbers = torch.get_num_threads(), set[int]()
    try:
        torch.set_num_threads(1)
        train(tiny(), tmp_path / "whole")
        stopped(tmp_path / "cut")
        torch.set_num_threads(2)
        train(tiny(), tmp_path / "cut", resume=True, watch=lambda _: numbers.add(torch.get_num_threads()))
        assert (numbers, torch.get_num_threads()) == ({1}, 2)
    finally:
        torch.set_num_threads(before)
    assert read_toml(tmp_path / "cut" / CONFIG)["made"]["threads"] == 1
    whole, cut = (checkpoint.read(tmp_path / name / POLICY)["weights"] for name in ("whole", "cut"))
    assert all(torch.equal(whole[name], cut[name]) for name in whole)


class Greedy(BehaviouralCloning):
    """Wants more memory than there is, of PyTorch or of numpy."""

    def update(self) -> Mapping[str, float]:
        torch.empty(2**50) if self.settings.seed else np.empty(2**50)
        return super().update()


@pytest.mark.parametrize("seed", [0, 1])
def test_a_lack_of_memory_is_told(seed: int, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"not enough memory .*smaller sizes"):
        train(from_states(seed=seed), tmp_path / "run", learner=Greedy)


def test_other_errors_of_a_learner_are_its_own(tmp_path: Path) -> None:
    class Wrong(BehaviouralCloning):
        def update(self) -> Mapping[str, float]:
            return {"loss": float(torch.ones(2) @ torch.ones(3))}

    with pytest.raises(RuntimeError, match="size") as error:
        train(from_states(), tmp_path / "run", learner=Wrong)
    assert not isinstance(error.value, MagicalError)


def test_a_training_goes_on_whatever_stood_in_its_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["magical-mj", "train", "--out", "runs/\U0001f389", "\udcff"])
    stopped(tmp_path / "run", from_states())
    train(from_states(), tmp_path / "run", resume=True)
    assert is_done(tmp_path / "run")
    assert "\U0001f389" in read_toml(tmp_path / "run" / CONFIG)["made"]["command"]
