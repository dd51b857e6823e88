"""Trained policies: that they draw by the episode, do not depend on settings of torch, and act alike as ONNX files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj import demos
from magical_mj.learners import TrainingSettings, load_policy, train
from magical_mj.learners.policy import POLICY, export_policy
from magical_mj.policies.interface import Episode, histories
from magical_mj.policies.models import load_onnx
from magical_mj.utils.errors import SettingsError, UnknownNameError
from tests.helpers.commands import Shell
from tests.helpers.learners import EXPORTS, compare_exported, playing, tiny


def test_a_policy_draws_by_the_episode(tmp_path: Path) -> None:
    policy = train(tiny(), tmp_path / "run")
    loaded = load_policy(tmp_path / "run")
    picture = np.random.default_rng(0).integers(0, 256, (96, 96, 12)).astype(np.uint8)

    def actions(agent: object, seed: int) -> list[int]:
        agent.reset(Episode("MoveToRegion", "Demo", seed))
        return [agent(picture) for _ in range(30)]

    assert actions(policy, 0) == actions(loaded, 0) != actions(loaded, 1)
    assert len(set(actions(loaded, 0))) > 5  # two seconds of training leave it undecided
    with pytest.raises(SettingsError, match=r"observations of shape \(96, 96, 12\)"):
        loaded(picture[:, :, :3])
    with pytest.raises(SettingsError, match="trained on MoveToRegion and cannot play FindDupe"):
        loaded.reset(Episode("FindDupe", "Demo", 0))
    for weights in loaded.actor.parameters():
        weights.data.fill_(float("nan"))
    with pytest.raises(ValueError, match="not finite"):
        loaded(picture)


@contextmanager
def changed(setting: Callable[[Any], object], value: object, usual: object) -> Iterator[None]:
    setting(value)
    try:
        yield
    finally:
        setting(usual)


def drawn(folder: Path) -> tuple[bytes, list[int]]:
    """The file of a newly trained policy, and some of its actions."""
    picture = np.random.default_rng(0).integers(0, 256, (96, 96, 12)).astype(np.uint8)
    train(tiny(**{"bc.batches": 4, "checkpoints": 1}), folder)
    policy = load_policy(folder)
    policy.reset(Episode("MoveToRegion", "Demo", 0))
    return (folder / POLICY).read_bytes(), [int(policy(picture)) for _ in range(20)]


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, list[int]]:
    return drawn(tmp_path_factory.mktemp("usual") / "run")


@pytest.mark.parametrize(
    "setting",
    [
        changed(torch.set_default_dtype, torch.float64, torch.float32),
        changed(torch.set_float32_matmul_precision, "medium", "highest"),
        *(torch.no_grad(), torch.inference_mode(), torch.autocast("cpu"), torch.device("meta")),
    ],
    ids=["doubles", "rough-products", "no-grad", "inference", "autocast", "device"],
)
def test_no_result_depends_on_the_callers_settings_of_torch(
    tmp_path: Path, setting: Any, usual: tuple[bytes, list[int]]
) -> None:
    """They are the caller's again afterwards."""
    with setting:
        before = torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_float32_matmul_precision()
        assert drawn(tmp_path / "run") == usual
        assert (torch.get_default_dtype(), torch.is_grad_enabled(), torch.get_float32_matmul_precision()) == before


SEEN = 40
TASKS = "MoveToRegion,MakeLine"


@pytest.fixture(scope="module")
def states() -> np.ndarray:
    """The last four states at 40 moments of demonstrations with few and with many blocks. Shape (40, 4, names)."""
    parts = [
        histories(np.asarray(demos.observations(demos.load(task)[0], "State"))) for task in ("FindDupe", "MakeLine")
    ]
    every = np.concatenate(parts)
    return every[np.linspace(0, len(every) - 1, SEEN).astype(int)]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a policy for two tasks, from states."""
    folder = tmp_path_factory.mktemp("runs") / "both"
    train(tiny(tasks=TASKS, preset="State", **{"network.entity": 16}), folder)
    return folder


@pytest.mark.slow
@EXPORTS
def test_states_of_one_of_several_tasks(both: Path, states: np.ndarray, tmp_path: Path) -> None:
    file = export_policy(both, tmp_path / "line.onnx", "MakeLine")
    compare_exported(load_policy(both).actor, file, states, head=1)
    assert b"/home" not in file.read_bytes()
    assert str(Path(magical_mj.__file__).parent).encode() not in file.read_bytes()
    actor, loaded = load_policy(both).actor.eval(), load_onnx(file)
    env, kept = magical_mj.Engine("MakeLine", "Layout", seed=0), []
    loaded.reset_batch([Episode("MakeLine", "Layout", 0)])
    for _ in range(20):
        kept.append(env.state_vector())
        with torch.inference_mode():
            ours = actor(torch.as_tensor(histories(np.array(kept))[-1:]), torch.tensor([1])).argmax()
        assert loaded(kept[-1]) == ours
        env.step(int(ours))
    assert magical_mj.evaluate(file, tasks="MakeLine", variants="Layout", episodes=1, jobs=1)["failure"].isna().all()
    with pytest.raises(SettingsError, match="give --preset State"):
        magical_mj.evaluate(str(file), tasks="MakeLine", preset="LoRes4E", episodes=1)
    with pytest.raises(SettingsError, match="cannot act in MoveToRegion"):
        magical_mj.evaluate(str(file), tasks="MoveToRegion", preset="State", episodes=1)


@pytest.mark.slow
@EXPORTS
@pytest.mark.parametrize("settings", [tiny(**{"demos.set": 2}), playing()], ids=["bc", "gail"])
def test_pictures(settings: TrainingSettings, tmp_path: Path) -> None:
    """With and without batch norm. The file records the set of the demonstrations."""
    train(settings, tmp_path / "run")
    file = export_policy(tmp_path / "run", tmp_path / "policy.onnx")
    seen = np.random.default_rng(0).integers(0, 256, (SEEN, 96, 96, 12)).astype(np.uint8)
    compare_exported(load_policy(tmp_path / "run").actor, file, seen)
    assert load_onnx(file).learnt.demonstration_set == settings.demos.set


def test_policies_that_cannot_be_exported_say_why(both: Path, tmp_path: Path, shell: Shell) -> None:
    assert "contains no trained network" in shell.fails(2, "export-policy", tmp_path, "--out", tmp_path / "a.onnx")
    assert "choose one of MoveToRegion, MakeLine (--task)" in shell.fails(
        2, "export-policy", both, "--out", tmp_path / "a.onnx"
    )
    with pytest.raises(SettingsError, match=r"must end in \.onnx"):
        export_policy(both, tmp_path / "policy.pt", "MakeLine")
    with pytest.raises(UnknownNameError, match="MakeLine"):
        export_policy(both, tmp_path / "a.onnx", "MakeLin")
    (tmp_path / "a.onnx").touch()
    assert "--force replaces it" in shell.fails(1, "export-policy", both, "--out", tmp_path / "a.onnx")
