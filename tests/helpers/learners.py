"""Helpers for tests of learners: trainings that take a second."""

from __future__ import annotations

import math
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from magical_mj import demos
from magical_mj.evaluation import evaluate
from magical_mj.learners import METHODS, Progress, TrainingSettings, checkpoint, load_settings, train
from magical_mj.learners.networks import as_input
from magical_mj.learners.policy import POLICY
from magical_mj.learners.rewards import learner_of_reward, rewards
from magical_mj.learners.run_folder import CHECKPOINT
from magical_mj.policies.loading import policy_in
from magical_mj.policies.models import onnx_runtime
from magical_mj.utils.errors import DemonstrationError

EXPORTS = pytest.mark.xdist_group("exports")
"""Of ONNX files: the first in a process takes seconds more than the others."""

TINY = {
    "network.first_stride": 4,
    "network.first_channels": 4,
    "network.channels": 4,
    "network.hidden": 8,
    "network.entity": 8,
    "evaluations": 0,
    "checkpoints": 4,
    "demonstrations": 2,
    "device": "cpu",
}


def tiny(method: str = "bc", tasks: str = "MoveToRegion", **changes: Any) -> TrainingSettings:
    """Settings with a network of a few weights."""
    quick = changes.get("preset") != "State"
    return load_settings(method, tasks, quick=quick, **{**TINY, "bc.batches": 12, "bc.batch_size": 4, **changes})


def from_states(**changes: Any) -> TrainingSettings:
    """Settings of a tiny training from states."""
    return tiny(preset="State", **changes)


PLAYING = {
    "ppo.environments": 4,
    "ppo.steps": 4,
    "ppo.minibatch": 8,
    "ppo.epochs": 2,
    "ppo.total_steps": 64,
    "discriminator.steps": 2,
    "discriminator.batch_size": 8,
    "features.batches": 2,
    "features.batch_size": 4,
    "features.samples": 24,
}


def playing(method: str = "gail", tasks: str = "MoveToRegion", **changes: Any) -> TrainingSettings:
    """Settings of a method that plays episodes: four updates of 4 x 4 steps."""
    return tiny(method, tasks, **{**PLAYING, **changes})


def is_done(folder: Path) -> bool:
    """Whether the training in this folder is finished."""
    if not (folder / POLICY).is_file() or not (folder / CHECKPOINT).is_file():
        return False
    kept = checkpoint.read(folder / CHECKPOINT)
    return kept["update"] == kept["updates"]


def stopped(folder: Path, settings: TrainingSettings | None = None) -> None:
    """Makes the folder of a training (by default a tiny one) that was stopped after its third update."""

    def stop(progress: Progress) -> None:
        if progress.update == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(settings or tiny(), folder, watch=stop)


def brief(method: str, changes: dict[str, Any], seed: int = 0) -> TrainingSettings:
    """Settings of a training of a second, even if weights and optimizer states differ in memory layout."""
    changes = {"tasks": "MoveToRegion", **TINY, **PLAYING, "bc.batches": 4, "bc.batch_size": 4, **changes}
    quick = changes.get("preset") != "State"
    return load_settings(method, seed=seed, quick=quick, **changes)


def made(method: str, changes: dict[str, Any], seed: int = 0) -> Any:
    """A learner of such a training."""
    return METHODS[method](brief(method, changes, seed))


def weights(learner: Any) -> torch.Tensor:
    return torch.cat([values.detach().flatten() for values in learner.actor.parameters()])


def check_own_demonstrations(method: str, changes: dict[str, Any], tmp_path: Path) -> None:
    """Checks that a method learns from all demonstrations in a folder, and refuses a folder without any."""
    changes = {**changes, "recordings": str(tmp_path), "demonstrations": None}
    with pytest.raises(DemonstrationError, match="there are no demonstrations of MoveToRegion in "):
        made(method, changes).update()
    for number, demonstration in enumerate(demos.load("MoveToRegion")[:6]):
        demos.write(demonstration, tmp_path / f"MoveToRegion-Demo-{number}.npz")
    learner = made(method, changes)
    learner.update()
    learner.close()


def check_resumes(method: str, changes: dict[str, Any], tmp_path: Path) -> None:
    """Checks that a training resumes exactly from a file written three updates before its end, in mid-episode.

    It must not use global random generators. Metrics must always have the same names and be finite numbers.
    """
    whole, resumed = made(method, changes), made(method, changes)
    before = torch.get_rng_state(), np.random.get_state()[1]  # noqa: NPY002
    metrics: list[dict[str, float]] = []
    while len(metrics) < whole.updates:
        checkpoint.write(tmp_path / f"{len(metrics)}.safetensors", whole.get_state())
        metrics.append(whole.update())
    resumed.set_state(checkpoint.read(tmp_path / f"{len(metrics) - 3}.safetensors"))
    assert [resumed.update() for _ in range(3)] == metrics[-3:]
    for learner in (whole, resumed):
        checkpoint.write(tmp_path / f"{learner is whole}.safetensors", learner.get_state())
        learner.close()
    assert (tmp_path / "True.safetensors").read_bytes() == (tmp_path / "False.safetensors").read_bytes()
    assert torch.equal(torch.get_rng_state(), before[0])
    np.testing.assert_array_equal(np.random.get_state()[1], before[1])  # noqa: NPY002
    assert len({tuple(row) for row in metrics}) == 1
    assert all(isinstance(value, float) and math.isfinite(value) for row in metrics for value in row.values())


def check_readers(method: str, changes: dict[str, Any], folder: Path) -> None:
    """Checks that readers of a finished training's folder get what its learner had: actions, rewards, facts.

    Rewards must differ from step to step: a reward of which a part is not restored may be constant.
    """
    settings, learners = brief(method, changes), list[Any]()
    policy = train(settings, folder, learner=lambda chosen: learners.append(METHODS[method](chosen)) or learners[-1])
    where = {"tasks": settings.tasks, "variants": "Demo", "preset": settings.preset, "jobs": 1, "episodes": 1}
    played, again = (evaluate(one, **where)["actions"].tolist() for one in (policy, folder))
    assert played == again
    for fact in ("tasks", "preset", "learnt"):
        assert getattr(policy_in(folder), fact) == getattr(policy, fact)
    if METHODS[method].learns_reward:
        with closing(learner_of_reward(folder, settings)) as loaded:
            for task in settings.tasks:
                demonstration = demos.load(task)[0]
                values = rewards(learners[0], demonstration)
                assert torch.equal(rewards(loaded, demonstration), values)
                assert values.std() > 0


def check_seeds(method: str, changes: dict[str, Any]) -> None:
    """Checks that equal seeds give equal weights, and different seeds different ones."""

    def trained(seed: int) -> torch.Tensor:
        learner = made(method, changes, seed)
        for _ in range(2):
            learner.update()
        learner.close()
        return weights(learner)

    first = trained(0)
    assert torch.equal(first, trained(0))
    assert not torch.equal(first, trained(1))


def compare_exported(actor: torch.nn.Module, file: Path, seen: np.ndarray, head: int = 0) -> None:
    """Checks that an ONNX file has the network's outputs. The network gets single observations, as in an episode."""
    actor.eval()
    with torch.inference_mode():
        ours = [actor(as_input(one[None], torch.device("cpu")), torch.tensor([head]))[0].numpy() for one in seen]
    (logits,) = onnx_runtime().InferenceSession(file).run(None, {"observations": seen})
    np.testing.assert_allclose(logits, ours, rtol=1e-3, atol=1e-3)
    np.testing.assert_array_equal(np.argmax(logits, 1), np.argmax(ours, 1))
