"""Frozen encoders: behavioural cloning on the convolutions of an earlier training, which are not trained further."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import torch
from torch import Tensor, nn

from magical_mj.learners import checkpoint
from magical_mj.learners.networks import Torso
from magical_mj.learners.policy import load_policy
from magical_mj.learners.settings import TrainingSettings
from magical_mj.policies.facts import CONFIG, check_tasks, check_variants
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, TrainingError, as_integer, short_repr

PREFIX: Final = "torso.convolutions."
"""The prefix of the encoder's weights among those of a policy."""


class Encoder(NamedTuple):
    """An encoder, and facts about its training."""

    weights: Mapping[str, Tensor]
    """The state of a `Torso`'s convolutions with batch norm."""
    tasks: Sequence[str]
    """The tasks of the episodes in its training."""
    played_in: str = "Demo"
    """The variants of the scenes in its training, separated by commas."""
    demonstration_set: int = 1
    """The set of the package's demonstrations that it was trained on; 0 for none of them."""


class Frozen(nn.Sequential):
    """Layers that are not trained: without gradients, and with constant averages of batch norm."""

    def __init__(self, layers: nn.Sequential) -> None:
        super().__init__(*layers)
        self.requires_grad_(requires_grad=False).eval()

    def train(self, mode: bool = True) -> Frozen:
        """Does nothing: the layers stay in evaluation mode."""
        del mode
        return super().train(mode=False)


def save_encoder(path: Path | str, encoder: Encoder, *, overwrite: bool = False) -> None:
    """Writes an encoder into a file for the setting `bc.encoder`.

    Raises:
        SettingsError: if `tasks` contains anything except names, or `played_in` anything except variants.
        TrainingError: if the file exists and `overwrite` is false, or it cannot be written.
    """
    _check(encoder, "")
    contents = {**encoder._asdict(), "weights": dict(encoder.weights)}
    checkpoint.write(files.to_path(path), {"encoder": contents}, overwrite=overwrite)


def load_encoder(settings: TrainingSettings) -> Encoder | None:
    """The encoder in the settings, if there is one.

    Raises:
        SettingsError: if it does not fit the settings, or its file does not describe its training.
        TrainingError: if its file is missing or damaged.
    """
    if not settings.bc.encoder:
        return None
    if settings.states:
        raise SettingsError(f"bc.encoder is for pictures and has no effect with the preset {settings.preset}")
    path = Path(settings.bc.encoder)
    encoder = _of_run(path) if path.is_dir() else _in_file(path)
    if encoder.demonstration_set not in (0, settings.demos.set):
        number = encoder.demonstration_set
        raise SettingsError(
            f"the encoder in {path} learnt with demos.set={number}, and this training would with "
            f"demos.set={settings.demos.set}: use one set for both, since evaluations and entries record one"
        )
    with torch.device("meta"):  # only for its shapes
        wanted = Torso(settings.network, batch_norm=True).convolutions.state_dict()
    if problem := _misfit(encoder.weights, wanted):
        raise SettingsError(
            f"the encoder in {path} {problem}: give the folder of a training of bc, or a file written by save_encoder, "
            "with the sizes of this network (--quick in both trainings or in none, and the same settings network.*)"
        )
    return encoder


def _of_run(folder: Path) -> Encoder:
    if not (folder / CONFIG).is_file():
        raise SettingsError(f"bc.encoder={folder} is not the folder of a training: it has no {CONFIG}")
    policy = load_policy(folder)
    weights = policy.actor.state_dict()
    kept = {name.removeprefix(PREFIX): values for name, values in weights.items() if name.startswith(PREFIX)}
    learnt = policy.learnt
    return Encoder(kept, (*policy.tasks, *learnt.other_tasks), learnt.played_in, learnt.demonstration_set)


def _in_file(path: Path) -> Encoder:
    try:
        known = checkpoint.read(path).get("encoder")
    except TrainingError as error:
        remedy = "give the folder of a training, or a file written by save_encoder"
        raise type(error)(f"bc.encoder: {error}; {remedy}") from error
    if not isinstance(known, dict) or known.keys() != set(Encoder._fields) or not isinstance(known["weights"], dict):
        raise SettingsError(
            f"{path} was not written by save_encoder of this version, so the tasks and variants of its training are "
            "unknown: give such a file, or the folder of a training"
        )
    encoder = Encoder(**known)
    _check(encoder, f" in {path}")
    return encoder


def _check(encoder: Encoder, where: str) -> None:
    check_tasks(encoder.tasks, f"tasks{where}")
    check_variants(encoder.played_in, f"played_in{where}")
    if as_integer(encoder.demonstration_set) is None:
        raise SettingsError(f"demonstration_set{where} must be a number of a set, or 0 for none")


def _misfit(given: Mapping[str, Any], wanted: Mapping[str, Tensor]) -> str:
    """The reason why weights do not fit a network; empty if they fit."""
    if not given:
        return "has no convolutions: it is not for pictures"
    if missing := sorted(wanted.keys() - given.keys()):
        return f"lacks {missing[0]}"
    if unknown := sorted(given.keys() - wanted.keys()):
        return f"has {unknown[0]}, which this network does not have"
    for name, values in wanted.items():
        if not isinstance(found := given[name], Tensor) or found.shape != values.shape:
            shape = tuple(found.shape) if isinstance(found, Tensor) else short_repr(found)
            return f"has {name} of shape {shape}, not {tuple(values.shape)}"
        if found.is_complex() or not torch.isfinite(found).all():
            return f"has numbers in {name} that are not real and finite"
    return ""
