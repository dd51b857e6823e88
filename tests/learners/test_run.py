"""A run's folder: what it holds, that it goes on exactly where it was, what is its own, and what is refused."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

import magical_mj
from magical_mj import demos
from magical_mj.demos.recording import demonstrate
from magical_mj.evaluation.reports.report import report
from magical_mj.leaderboard import submit
from magical_mj.learners import METHODS, checkpoint, load_policy, train
from magical_mj.learners.bc import CALIBRATION, BehaviouralCloning
from magical_mj.learners.config import from_toml, recorded
from magical_mj.learners.policy import POLICY, TrainedPolicy, export_policy
from magical_mj.learners.run_folder import CHECKPOINT, CONFIG, METRICS, read_metrics
from magical_mj.learners.training import Progress
from magical_mj.policies.models import load_onnx
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import (
    DemonstrationError,
    EvaluationError,
    MagicalError,
    SettingsError,
    TrainingError,
    UnknownNameError,
)
from magical_mj.utils.files import read_toml
from tests.helpers.commands import Shell
from tests.helpers.learners import EXPORTS, from_states, is_done, playing, stopped, tiny

ROOT = str(Path(__file__).parents[2])


START = (
    f"import sys; sys.path.insert(0, {ROOT!r}); "
    "from tests.helpers.learners import tiny; from magical_mj.learners import train; "
)


def test_a_folder_holds_everything(tmp_path: Path) -> None:
    settings = from_states(evaluations=2, episodes=2)
    reports = []
    train(settings, tmp_path / "run", watch=reports.append)
    names = {path.name for path in (tmp_path / "run").iterdir()}
    assert names == {CONFIG, "metrics.csv", CHECKPOINT, POLICY, "tensorboard"}
    assert recorded(from_toml(tmp_path / "run" / CONFIG)) == recorded(settings)
    made = read_toml(tmp_path / "run" / CONFIG)["made"]
    assert {"date", "command", "torch", "mujoco"} <= set(made)
    assert (made["magical_mj"], made["protocol"]) == (magical_mj.__version__, PROTOCOL)
    rows = read_metrics(tmp_path / "run")
    assert [int(row["update"]) for row in rows] == list(range(1, 13))
    assert all(float(row["loss"]) > 0 and 0 <= float(row["accuracy"]) <= 1 for row in rows)
    assert [bool(row["score MoveToRegion"]) for row in rows] == [update in (6, 12) for update in range(1, 13)]
    assert [progress.update for progress in reports] == list(range(1, 13))
    assert [bool(progress.scores) for progress in reports] == [update in (6, 12) for update in range(1, 13)]
    assert any((tmp_path / "run" / "tensorboard").iterdir())
    assert is_done(tmp_path / "run")


def test_a_folder_belongs_to_one_training_at_a_time(tmp_path: Path) -> None:
    """A second one is refused while the first goes on, and leaves everything as it is."""
    run = tmp_path / "run"

    def second(progress: Progress) -> None:
        if progress.update > 1:
            return
        before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
        with pytest.raises(TrainingError, match="another process is training"):
            train(from_states(), run, resume=True)
        assert before == {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}

    train(from_states(), run, watch=second)
    assert is_done(run)


def test_a_killed_run_continues_with_the_same_result(tmp_path: Path) -> None:
    """Kill -9 in the middle; then the same weights, to the bit, and the same figures as without a break."""
    settings = "tiny(preset='State', **{'bc.batches': 60, 'checkpoints': 10})"
    train(eval(settings), tmp_path / "whole")
    process = subprocess.Popen([sys.executable, "-c", f"{START}train({settings}, {str(tmp_path / 'cut')!r})"])
    deadline = time.monotonic() + 120
    while not (tmp_path / "cut" / CHECKPOINT).exists():
        assert process.poll() is None, "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert not is_done(tmp_path / "cut")
    updates: list[int] = []
    train(eval(settings), tmp_path / "cut", resume=True, watch=lambda progress: updates.append(progress.update))
    assert 1 < updates[0] <= updates[-1] == 60
    whole, cut = (checkpoint.read(tmp_path / name / POLICY)["weights"] for name in ("whole", "cut"))
    assert all(torch.equal(whole[name], cut[name]) for name in whole)
    rows = [[row | {"seconds": ""} for row in read_metrics(tmp_path / name)] for name in ("whole", "cut")]
    assert rows[0] == rows[1]


@pytest.mark.parametrize("method", ["bc", "gail"])
def test_ctrl_c_saves_a_checkpoint_after_the_present_update(method: str, tmp_path: Path) -> None:
    """Pressed in the middle of an update, whose end is waited for; then all goes on as if it had not been."""
    settings = playing(method, preset="State", checkpoints=1, **{"ppo.total_steps": 128})

    class Interrupted(METHODS[method]):  # type: ignore[misc]
        done = 0

        def update(self) -> Mapping[str, float]:
            self.done += 1
            if self.done == 3:
                os.kill(os.getpid(), signal.SIGINT)
            return super().update()

    train(settings, tmp_path / "whole")
    with pytest.raises(KeyboardInterrupt):
        train(settings, tmp_path / "cut", learner=Interrupted)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert checkpoint.read(tmp_path / "cut" / CHECKPOINT)["update"] == 3
    with pytest.warns(UserWarning, match="has stopped at update 3 of"):
        load_policy(tmp_path / "cut")
    train(settings, tmp_path / "cut", resume=True)
    whole, cut = (checkpoint.read(tmp_path / name / CHECKPOINT) for name in ("whole", "cut"))
    assert repr({**whole, "seconds": 0}) == repr({**cut, "seconds": 0})
    assert (tmp_path / "whole" / POLICY).read_bytes() == (tmp_path / "cut" / POLICY).read_bytes()


def test_a_finished_run_resumes_to_itself(tmp_path: Path) -> None:
    train(from_states(), tmp_path / "run")
    before = {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()}
    train(
        from_states(), tmp_path / "run", resume=True, watch=lambda progress: pytest.fail("there is nothing left to do")
    )
    assert {path: path.read_bytes() for path in (tmp_path / "run").rglob("*") if path.is_file()} == before
    for damaged in (b"", before[tmp_path / "run" / POLICY][:100]):
        (tmp_path / "run" / POLICY).write_bytes(damaged)
        train(from_states(), tmp_path / "run", resume=True)
        assert (tmp_path / "run" / POLICY).read_bytes() == before[tmp_path / "run" / POLICY]
    (tmp_path / "run" / POLICY).unlink()
    train(from_states(), tmp_path / "run", resume=True)
    assert (tmp_path / "run" / POLICY).read_bytes() == before[tmp_path / "run" / POLICY]


def test_a_run_does_not_continue_on_another_kind_of_device(tmp_path: Path) -> None:
    """It would end otherwise than without the interruption. Its policy is at hand everywhere, once it is finished."""
    stopped(tmp_path / "begun", from_states())
    train(from_states(), tmp_path / "finished")
    for name in ("begun", "finished"):
        kept = checkpoint.read(tmp_path / name / CHECKPOINT)
        checkpoint.write(tmp_path / name / CHECKPOINT, {**kept, "device": "cuda"})
    with pytest.raises(TrainingError, match="was trained on cuda, not on cpu: continue on a machine with cuda"):
        train(from_states(), tmp_path / "begun", resume=True)
    assert isinstance(train(from_states(), tmp_path / "finished", resume=True), TrainedPolicy)


def test_a_policy_that_is_saved_on_the_way_is_as_it_would_be_evaluated(tmp_path: Path) -> None:
    """Its batch norm has averages over enough batches, and not those that lag behind the weights."""
    stopped(tmp_path / "run")
    weights = checkpoint.read(tmp_path / "run" / POLICY)["weights"]
    batches = [int(value) for name, value in weights.items() if name.endswith("num_batches_tracked")]
    assert batches == [CALIBRATION] * 5


def test_damaged_figures_are_refused_and_kept(tmp_path: Path) -> None:
    stopped(tmp_path / "run", from_states())
    path = tmp_path / "run" / METRICS
    for text in (
        "",
        "seconds,update\n1,2\n",
        "update,loss\n,1",
        "update,seconds\n1,2,3",
        "update,seconds,loss\n1,2",
        "update\n\xff",
        "update\n\0",
    ):
        path.write_text(text, "latin-1")
        with pytest.raises(TrainingError, match=r"metrics\.csv is damaged"):
            train(from_states(), tmp_path / "run", resume=True)
        assert path.read_text("latin-1") == text


def test_a_training_with_other_demonstrations_or_worlds_is_not_continued(tmp_path: Path) -> None:
    train(from_states(), tmp_path / "run")
    config = tmp_path / "run" / CONFIG
    text = config.read_text()
    for what in ("protocol", "demonstrations"):
        settings, start = text.split("[made]")
        config.write_text(f"{settings}[made]{re.sub(f'{what} = .*', f'{what} = 99', start)}")
        with pytest.raises(TrainingError, match=f"{what} number 99"):
            train(from_states(), tmp_path / "run", resume=True)


def test_an_existing_training_is_never_overwritten(tmp_path: Path) -> None:
    train(from_states(), tmp_path / "run")
    with pytest.raises(TrainingError, match="already contains a training; --resume"):
        train(from_states(), tmp_path / "run")
    with pytest.raises(SettingsError, match="seed was 0 and is 1"):
        train(from_states(seed=1), tmp_path / "run", resume=True)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").touch()
    with pytest.raises(TrainingError, match="not from a training"):
        train(from_states(), tmp_path / "mine")
    with pytest.raises(TrainingError, match="not from a training"):
        train(from_states(), tmp_path / "mine" / "thesis.tex")
    with pytest.raises(TrainingError, match="cannot write into"):
        train(from_states(), tmp_path / "mine" / "thesis.tex" / "run")


def test_a_training_that_cannot_start_leaves_no_folder(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="has no device 'abacus'"):
        train(tiny(device="abacus"), tmp_path / "run")
    with pytest.raises(UnknownNameError, match="Did you mean 'bc'"):
        train(tiny("bd"), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_loss_of_nan_stops_the_training_and_keeps_the_checkpoint(tmp_path: Path) -> None:
    wild = {"bc.optimizer": "sgd", "bc.learning_rate": 1e6, "bc.final_learning_rate": 1e6}
    with pytest.raises(TrainingError, match=r"at update 2; the checkpoint of update 1 is kept .*lower learning rate"):
        train(from_states(**wild, checkpoints=12), tmp_path / "run")
    assert checkpoint.read(tmp_path / "run" / CHECKPOINT)["update"] == 1
    kept = checkpoint.read(tmp_path / "run" / POLICY)
    assert all(tensor.isfinite().all() for tensor in kept["weights"].values())


def test_checkpoints_keep_everything(tmp_path: Path) -> None:
    state = {
        "a": [1, 2.5, None, True, "text", [torch.arange(3), {"x": np.arange(4.0)}]],
        "numbers as keys": {0: {"step": torch.tensor(7.0)}, "0": 3},
        "large": 2**100,
        "same": (tensor := torch.ones(2)),
        "again": tensor,
        "part": torch.arange(10)[::3],
    }
    checkpoint.write(tmp_path / "x.safetensors", state)
    back = checkpoint.read(tmp_path / "x.safetensors")
    assert repr(back) == repr(state)
    assert b"pickle" not in (tmp_path / "x.safetensors").read_bytes()
    with pytest.raises(ValueError, match="a string must not begin with tensor:"):
        checkpoint.write(tmp_path / "x.safetensors", {"a": "tensor:b"})
    assert repr(checkpoint.read(tmp_path / "x.safetensors")) == repr(state)


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


def test_unfinished_files_of_a_killed_training_are_no_obstacle(tmp_path: Path) -> None:
    """It was killed while it wrote its first file; a file of somebody else with a like name is one."""
    left = tmp_path / "run" / ".config.0123abcd-4567cdef.part.toml"
    left.parent.mkdir()
    left.touch()
    train(from_states(), left.parent, resume=True)
    assert is_done(left.parent)
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / ".notes.part.toml").touch()
    with pytest.raises(TrainingError, match="not from a training"):
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
        with pytest.raises(TrainingError, match="does not contain a policy"):
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
    for name, says in ((CHECKPOINT, "tasks: .*FixColour"), (POLICY, "tasks: .*FixColour.*instead of .*MoveToRegion")):
        before = (run / name).read_bytes()
        shutil.copy(other / name, run / name)
        with pytest.raises(TrainingError, match=f"from another training .{says}"):
            train(from_states(), run, resume=True)
        assert (run / name).read_bytes() == (other / name).read_bytes()
        (run / name).write_bytes(before)
    shutil.copy(tmp_path / "seed" / CHECKPOINT, run / CHECKPOINT)
    with pytest.raises(TrainingError, match=r"from another training \(seed: 3"):
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
def test_a_training_killed_between_its_files_continues(
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


def test_a_training_continues_with_the_same_number_of_threads(tmp_path: Path) -> None:
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
def test_a_lack_of_memory_is_explained(seed: int, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match=r"not enough memory .*smaller sizes"):
        train(from_states(seed=seed), tmp_path / "run", learner=Greedy)


def test_other_errors_of_a_learner_are_its_own(tmp_path: Path) -> None:
    class Wrong(BehaviouralCloning):
        def update(self) -> Mapping[str, float]:
            return {"loss": float(torch.ones(2) @ torch.ones(3))}

    with pytest.raises(RuntimeError, match="size") as error:
        train(from_states(), tmp_path / "run", learner=Wrong)
    assert not isinstance(error.value, MagicalError)


def test_a_training_continues_whatever_its_command_contained(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["magical-mj", "train", "--out", "runs/\U0001f389", "\udcff"])
    stopped(tmp_path / "run", from_states())
    train(from_states(), tmp_path / "run", resume=True)
    assert is_done(tmp_path / "run")
    assert "\U0001f389" in read_toml(tmp_path / "run" / CONFIG)["made"]["command"]


def test_a_training_does_not_continue_in_a_task_whose_code_has_changed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trainings by earlier versions, which did not record the code, continue."""
    monkeypatch.syspath_prepend(tmp_path)
    module = tmp_path / "trained_task.py"
    module.write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.move_to_region import SPEC as OLD\n"
        'SPEC = replace(OLD, name="Trained", demonstrations="none")\n'
    )
    task = "trained_task:SPEC"
    demos.keep(demonstrate(task, "Demo", 0), tmp_path / "shown")
    settings = from_states(tasks=task, recordings=tmp_path / "shown", demonstrations=1)
    stopped(tmp_path / "run", settings)
    module.write_text(f"{module.read_text()}# changed\n")
    with pytest.raises(TrainingError, match=rf"the code of {task} has changed since .*run was begun"):
        train(settings, tmp_path / "run", resume=True)
    config = tmp_path / "run" / CONFIG
    config.write_text(re.sub(r"\ncode = .*", "", config.read_text()))
    train(settings, tmp_path / "run", resume=True)


def test_demonstrations_of_a_demo_scene_that_has_changed_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, shell: Shell
) -> None:
    """By trainings, and by the command that would add new ones."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "moved_task.py").write_text(
        "from dataclasses import replace\nfrom magical_mj.tasks.move_to_region import SPEC as OLD\n"
        'SPEC = replace(OLD, name="Moved", demo=OLD.demo.moved(robot=(0.6, 0.6, 0.0)), demonstrations="none")\n'
    )
    current = demonstrate("moved_task:SPEC", "Demo", 0)
    made = tmp_path / "made" / "Moved-Demo-000.npz"
    made.parent.mkdir()
    demos.write(replace(current, scene=magical_mj.sample_scene("MoveToRegion", "Demo", 0)), made)
    assert current.is_current
    assert not demos.read(made, "moved_task:SPEC").is_current
    settings = from_states(tasks="moved_task:SPEC", recordings=made.parent, demonstrations=1)
    with pytest.raises(DemonstrationError, match=r"the demo scene has changed since demonstrations .*made were made"):
        train(settings, tmp_path / "run")
    command = ("demos", "generate", "--tasks", "moved_task:SPEC", "--count", 2, "--jobs", 1, "--out", made.parent)
    assert "Moved-Demo-000.npz does not start in the scene of its variant and seed any more" in shell.fails(2, *command)


@EXPORTS
def test_an_interrupted_training_is_not_evaluated_as_if_it_were_finished(tmp_path: Path) -> None:
    run, out = tmp_path / "run", tmp_path / "out"
    stopped(run)
    with pytest.warns(UserWarning, match=r"the training of run in .* has stopped at update \d+ of \d+"):
        magical_mj.evaluate(run, tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1, out=out)
    (policy,) = json.loads((out / "run.json").read_text())["policies"]
    assert re.fullmatch(r"update \d+ of \d+", policy["unfinished"])
    page = report([out], tmp_path / "report")
    assert f"the training of run, run 0, has stopped at {policy['unfinished']}" in " ".join(page.read_text().split())
    with pytest.raises(EvaluationError, match=r"has stopped at update .*: finish it with magical-mj train --resume"):
        submit([out], tmp_path / "entry.json.xz")
    with pytest.warns(UserWarning, match=r"the training in .* has stopped at update \d+ of \d+"):
        load_policy(run)
    with pytest.warns(UserWarning, match=r"the training in .* has stopped"):
        file = export_policy(run, tmp_path / "early.onnx")
    assert load_onnx(file).learnt.unfinished == policy["unfinished"]
    with pytest.warns(UserWarning, match=r"the training of early in .*early\.onnx has stopped at update \d+ of \d+"):
        magical_mj.evaluate(file, tasks="MoveToRegion", variants="Demo", episodes=1, jobs=1)
