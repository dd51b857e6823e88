"""Trained policies: their class, which the evaluation plays, their files, and their export as ONNX files."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from msgspec.structs import replace
from numpy.typing import NDArray
from torch import Tensor, nn

from magical_mj.learners import checkpoint
from magical_mj.learners.networks import SHAPE, Actor, as_input
from magical_mj.learners.settings import LEARNABLE, STATE, NetworkSettings, TrainingSettings
from magical_mj.observations import STATE_NAMES
from magical_mj.policies.facts import UNKNOWN, Learnt, learnt_from
from magical_mj.policies.interface import HISTORY, Episode
from magical_mj.policies.loading import loader_in, policy_in
from magical_mj.policies.models import Model, torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, check_name, short_repr
from magical_mj.utils.extras import check_extra
from magical_mj.utils.settings import with_changes

POLICY: Final = "policy.safetensors"
"""The policy's file in a run's folder."""
OPSET: Final = 18
EXAMPLES: Final = 2
"""The batch size for tracing the network. A batch size of 1 would be recorded as a constant."""


class TrainedPolicy(Model):
    """A trained policy. It samples actions from the network's probabilities with the episode's generator.

    Attributes:
        actor: the network. It returns logits (n, 18) for observations and tasks, like `networks.Actor`.
        tasks: the tasks of the training, in the order of the network's heads.
        preset: the preset of the training's observations.
        learnt: what its training used.
    """

    def __init__(self, actor: nn.Module, tasks: Sequence[str], preset: str, learnt: Learnt = UNKNOWN) -> None:
        super().__init__(self._draw_actions, remembers=preset == STATE)
        self.actor, self.tasks, self.preset, self.learnt = actor, tuple(tasks), preset, learnt
        self._device = next(actor.parameters()).device

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        """Begins episodes that are played together."""
        unknown = sorted({episode.task for episode in episodes} - set(self.tasks))
        if unknown:
            raise SettingsError(f"this policy was trained on {', '.join(self.tasks)} and cannot play {unknown[0]}")
        super().reset_batch(episodes)
        self._heads = torch.tensor([self.tasks.index(episode.task) for episode in episodes], device=self._device)
        self._rngs = [episode.rng() for episode in episodes]

    def act_batch(self, observations: NDArray[Any]) -> NDArray[np.int64]:
        """An action for each episode, shape (n,), for stacks of shape (n, 96, 96, 12) or states of shape (n, names)."""
        shape = (len(STATE_NAMES),) if self.preset == STATE else SHAPE
        if observations.shape[1:] != shape:
            raise SettingsError(
                f"this policy needs observations of shape {shape} (preset {self.preset}), not {observations.shape[1:]}"
            )
        return super().act_batch(observations)

    def _draw_actions(self, observations: NDArray[Any]) -> NDArray[np.int64]:
        self.actor.eval()
        with torch_settings(1), torch.inference_mode():
            logits = self.actor(as_input(observations, self._device), self._heads[: len(observations)])
        if not logits.isfinite().all():
            raise ValueError("the network's output is not finite")
        shares = logits.double().softmax(dim=1).cumsum(dim=1).cpu().numpy()
        points = np.array([rng.random() for rng in self._rngs[: len(observations)]])
        return np.minimum((shares < points[:, None]).sum(axis=1), shares.shape[1] - 1)


def save_policy(folder: Path, actor: Actor, settings: TrainingSettings) -> None:
    """Writes the policy into a run's folder, with all data that loading it needs."""
    contents = {
        "weights": actor.state_dict(),
        "batch_norm": actor.batch_norm,
        "network": asdict(settings.network),
        "tasks": list(settings.tasks),
        "preset": settings.preset,
    }
    checkpoint.write(folder / POLICY, contents)


def load_policy(folder: Path | str) -> TrainedPolicy:
    """The policy in a run's folder, on the CPU. Warns if the training has stopped before its end.

    Raises:
        TrainingError: if the file is missing or damaged.
        SettingsError: if the training's settings are damaged.
    """
    policy = read_policy(folder)
    if stopped := policy.learnt.unfinished:
        warnings.warn(f"the training in {folder} has stopped at {stopped}", stacklevel=2)
    return policy


@torch_settings()
def read_policy(folder: Path | str) -> TrainedPolicy:
    """`load_policy` without the warning, for `magical_mj.evaluate`, which has its own."""
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        tasks, preset = contents["tasks"], contents["preset"]
        if not tasks or not all(isinstance(task, str) for task in tasks):
            raise TypeError(f"tasks must be names, not {short_repr(tasks)}")
        check_name("preset", preset, LEARNABLE)
        network = with_changes(NetworkSettings, contents["network"])
        actor = Actor(network, len(tasks), states=preset == STATE, batch_norm=contents["batch_norm"])
        actor.load_state_dict(contents["weights"])
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy: {error}") from error
    return TrainedPolicy(actor, tasks, preset, learnt_in(path.parent))


def learnt_in(folder: Path) -> Learnt:
    """The data of the training in a folder, and its last update if a checkpoint shows that it has not finished."""
    last = checkpoint.plain_values(folder / checkpoint.CHECKPOINT)
    update, updates = last.get("update", 0), last.get("updates", 0)
    return replace(learnt_from(folder), unfinished=f"update {update} of {updates}" if update < updates else "")


class _Logits(nn.Module):
    """Maps an environment's observations to the logits of a task's head."""

    def __init__(self, actor: nn.Module, head: int) -> None:
        super().__init__()
        self.actor, self.head = actor, head

    def forward(self, observations: Tensor) -> Tensor:
        tasks = torch.full((observations.shape[0],), self.head)
        return self.actor(as_input(observations, torch.device("cpu")), tasks)


@torch_settings()
def export_policy(folder: Path | str, out: Path | str, task: str = "", *, overwrite: bool = False) -> Path:
    """Writes the policy of a training as an ONNX file.

    Its metadata contain the task, the preset, the set of the package's demonstrations, the variants of its training,
    the other tasks of an encoder or a reward, and where the training stopped, if it is unfinished.

    The input `observations` contains stacks of pictures, (n, 96, 96, 12) uint8, or the last four states, (n, 4, names)
    float32, oldest first. At the start of an episode, its first state is repeated for the missing earlier ones. The
    output `logits` has a value for each action, (n, 18). A trained policy draws actions by their softmax, while
    `magical-mj evaluate --policy FILE` takes the largest.

    Args:
        folder: a folder written by `magical-mj train`.
        out: the file, with the ending .onnx.
        task: one of a multi-task policy's tasks; may be omitted if there is only one.
        overwrite: replace an existing file.

    Raises:
        SettingsError: if the folder contains no trained network, or the network was not trained on the task.
        TrainingError: if the policy is damaged.
        MissingExtraError: without the extra `onnx`.
    """
    folder, out = files.to_path(folder), files.to_path(out)
    check_extra("exported policies", "onnx")
    policy = None if loader_in(folder) is None else policy_in(folder)
    if not isinstance(policy, TrainedPolicy):
        raise SettingsError(f"{folder} contains no trained network: export a folder written by magical-mj train")
    if stopped := policy.learnt.unfinished:
        warnings.warn(f"the training in {folder} has stopped at {stopped}", stacklevel=2)
    if out.suffix != ".onnx":
        raise SettingsError(f"the file name must end in .onnx, not {out.name!r}")
    if not task:
        task, *others = policy.tasks
        if others:
            raise SettingsError(f"this policy is for several tasks: choose one of {', '.join(policy.tasks)} (--task)")
    check_name("task", task, policy.tasks)
    network = _Logits(policy.actor, policy.tasks.index(task)).eval()
    example = torch.zeros(EXAMPLES, *SHAPE, dtype=torch.uint8)
    if policy.preset == STATE:
        example = torch.zeros(EXAMPLES, HISTORY, len(STATE_NAMES))
    with files.new_file(out, overwrite=overwrite) as unfinished:
        program = _traced(network, example)
        for part in (program.model.graph, *program.model.graph.all_nodes()):
            part.metadata_props.clear()  # they are as large as the weights, and contain this machine's paths
        texts = {"demonstration_set": str(policy.learnt.demonstration_set), "played_in": policy.learnt.played_in}
        texts |= {"other_tasks": "\n".join(policy.learnt.other_tasks)} | ({"unfinished": stopped} if stopped else {})
        program.model.metadata_props.update(task=task, preset=policy.preset, **texts)
        program.save(unfinished, external_data=False)
    return out


def _traced(network: nn.Module, example: Tensor) -> Any:
    """The network as an ONNX program for batches of any size."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(action="ignore"):  # both warnings are about PyTorch's internals
            return torch.onnx.export(
                network,
                (example,),
                input_names=["observations"],
                output_names=["logits"],
                opset_version=OPSET,
                dynamic_shapes={"observations": {0: torch.export.Dim.DYNAMIC}},
                verbose=False,
            )
    finally:
        logger.setLevel(level)
