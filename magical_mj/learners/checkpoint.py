"""Checkpoint files: safetensors, with everything except tensors as JSON in the header. No pickles."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save

from magical_mj.utils import files
from magical_mj.utils.errors import MissingFileError, TrainingError

CHECKPOINT: Final = "checkpoint.safetensors"
"""The name of the checkpoint in the folder of a training."""
TENSOR: Final = "tensor:"
"""The prefix of a string in the JSON that refers to a tensor by name."""
ARRAY: Final = "array:"
"""The prefix of a string that refers to a numpy array."""


def write(path: Path, state: dict[str, Any], *, overwrite: bool = True) -> None:
    """Writes nested dicts and lists of tensors, arrays and plain values. Raises a `TrainingError` if that fails."""
    tensors: dict[str, torch.Tensor] = {}
    tree = json.dumps(_packed(state, "", tensors))
    try:
        files.write(path, save(tensors, {"tree": tree}), overwrite=overwrite)
    except OSError as error:
        raise TrainingError(f"cannot write {path}: {error.strerror}; the previous file is kept") from error


def read(path: Path) -> dict[str, Any]:
    """Reads a file, with tensors on the CPU. Raises a `TrainingError` if the file is missing or damaged."""
    try:
        with safe_open(path, "pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118  (not a dict)
            state = _unpacked(json.loads((file.metadata() or {})["tree"]), tensors)
        if not isinstance(state, dict):
            raise TypeError(f"it contains a {type(state).__name__} instead of values by name")
    except FileNotFoundError as error:
        raise MissingFileError(f"cannot read {path}: {error}") from error
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise TrainingError(f"cannot read {path}: {error}") from error
    return state


def plain_values(path: Path) -> dict[str, Any]:
    """The plain values at the top of a file, by name, read from its header. Empty if it is missing or damaged."""
    try:
        with safe_open(path, "pt") as file:
            pairs = json.loads((file.metadata() or {})["tree"])["pairs"]
        return {name: value for name, value in pairs if isinstance(value, int | float | str)}
    except (OSError, SafetensorError, KeyError, TypeError, ValueError, RecursionError):
        return {}


def _packed(value: Any, name: str, tensors: dict[str, torch.Tensor]) -> Any:
    if isinstance(value, dict):  # stored as pairs, since keys may be numbers, as in optimizers' states
        return {"pairs": [[key, _packed(item, f"{name}/{key}", tensors)] for key, item in value.items()]}
    if isinstance(value, list | tuple):
        return [_packed(item, f"{name}/{number}", tensors) for number, item in enumerate(value)]
    if isinstance(value, torch.Tensor):
        # cloned, since tensors in a file may not share memory
        tensors[name] = value.detach().cpu().clone(memory_format=torch.contiguous_format)
        return TENSOR + name
    if isinstance(value, np.ndarray):
        tensors[name] = torch.as_tensor(value).clone(memory_format=torch.contiguous_format)
        return ARRAY + name
    if isinstance(value, str) and value.startswith((TENSOR, ARRAY)):
        raise ValueError(f"a string must not begin with {TENSOR} or {ARRAY}")
    return value


def _unpacked(value: Any, tensors: dict[str, torch.Tensor]) -> Any:
    if isinstance(value, dict):
        return {key: _unpacked(item, tensors) for key, item in value["pairs"]}
    if isinstance(value, list):
        return [_unpacked(item, tensors) for item in value]
    if isinstance(value, str) and value.startswith(TENSOR):
        return tensors[value.removeprefix(TENSOR)]
    if isinstance(value, str) and value.startswith(ARRAY):
        return tensors[value.removeprefix(ARRAY)].numpy()
    return value
