"""Trained policies as ONNX files: for programs without PyTorch, and for the page on which one plays."""

from __future__ import annotations

import logging
import warnings
from pathlib import Path
from typing import Any, Final

import torch
from torch import Tensor, nn

from magical_mj.learners.networks import SHAPE, as_input
from magical_mj.learners.policy import POLICY, load_policy
from magical_mj.learners.settings import STATE
from magical_mj.policies.history import HISTORY
from magical_mj.policies.models import torch_settings
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.extras import check_extra

OPSET: Final = 18
EXAMPLES: Final = 2
"""The batch by which the network is traced; one of 1 would be taken for a constant."""


class _Logits(nn.Module):
    """From observations as environments give them to the logits of a task's head."""

    def __init__(self, actor: nn.Module, head: int) -> None:
        super().__init__()
        self.actor, self.head = actor, head

    def forward(self, observations: Tensor) -> Tensor:
        tasks = torch.full((observations.shape[0],), self.head)
        return self.actor(as_input(observations, torch.device("cpu")), tasks)


@torch_settings()
def export_policy(folder: Path | str, out: Path | str, task: str = "", *, overwrite: bool = False) -> Path:
    """Writes the policy of a training as an ONNX file, whose metadata name the task and the preset.

    Its input `observations` are stacks of pictures, (n, 96, 96, 12) uint8, or the last four states, (n, 4, names)
    float32, oldest first, where the first state of an episode stands for those before it. Its output `logits` has a
    value for each action, (n, 18): a trained policy draws by their softmax, `magical-mj evaluate --policy FILE` takes
    the largest.

    Args:
        folder: of `magical-mj train`.
        out: the file, which ends in .onnx.
        task: which of a multi-task policy's tasks; may be left out if there is one.
        overwrite: replace an existing file.

    Raises:
        SettingsError: if the folder has no policy of ours, or the task is not one of its.
        TrainingError: if the policy is damaged.
        MissingExtraError: without the extra `onnx`.
    """
    folder, out = files.to_path(folder), files.to_path(out)
    check_extra("exported policies", "onnx")
    if not (folder / POLICY).is_file():
        raise SettingsError(
            f"{folder} has no {POLICY}: only what magical-mj train left, of its own methods, can be exported"
        )
    if out.suffix != ".onnx":
        raise SettingsError(f"the file must end in .onnx, not {out.name!r}")
    policy = load_policy(folder)
    if not task:
        task, *others = policy.tasks
        if others:
            raise SettingsError(f"this policy is for several tasks: choose one of {', '.join(policy.tasks)} (--task)")
    check_name("task", task, policy.tasks)
    network = _Logits(policy.actor, policy.tasks.index(task)).eval()
    if policy.preset == STATE:
        example = torch.zeros(EXAMPLES, HISTORY, len(STATE_NAMES))
    else:
        example = torch.zeros(EXAMPLES, *SHAPE, dtype=torch.uint8)
    with files.new_file(out, overwrite=overwrite) as unfinished:
        program = _traced(network, example)
        for part in (program.model.graph, *program.model.graph.all_nodes()):
            part.metadata_props.clear()  # as large as the weights, and full of this machine's paths
        program.model.metadata_props.update(task=task, preset=policy.preset)
        program.save(unfinished, external_data=False)
    return out


def _traced(network: nn.Module, example: Tensor) -> Any:
    """The network as an ONNX program that takes any number of such observations."""
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(action="ignore"):  # both are about PyTorch's own internals
        return torch.onnx.export(
            network,
            (example,),
            input_names=["observations"],
            output_names=["logits"],
            opset_version=OPSET,
            dynamic_shapes={"observations": {0: torch.export.Dim.DYNAMIC}},
            verbose=False,
        )
