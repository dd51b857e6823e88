"""The policy of `relational` in a run's folder."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from magical_mj.learners import checkpoint
from magical_mj.learners.policy import TrainedPolicy, learnt_in
from magical_mj.learners.settings import STATE
from magical_mj.policies.models import torch_settings
from magical_mj.utils import files
from magical_mj.utils.errors import TrainingError
from magical_mj.utils.settings import with_changes
from magical_relational.network import Ensemble
from magical_relational.settings import RelationalSettings, RelationalTrainingSettings

POLICY: Final = "relational.safetensors"
PLAYED: Final = ("hidden", "networks", "sharpness")
"""The settings that the policy needs. Files of earlier versions contain additional ones."""


def save_policy(folder: Path, actor: Ensemble, settings: RelationalTrainingSettings) -> None:
    """Writes the policy into a run's folder, with the required settings and the task."""
    chosen = {name: getattr(settings.relational, name) for name in PLAYED}
    contents = {"weights": actor.state_dict(), "relational": chosen, "tasks": list(settings.tasks)}
    checkpoint.write(folder / POLICY, contents)


@torch_settings()
def load_policy(folder: Path | str) -> TrainedPolicy:
    """The policy in a run's folder, on the CPU.

    Raises:
        TrainingError: if the file is missing or damaged.
    """
    path = files.to_path(folder) / POLICY
    contents = checkpoint.read(path)
    try:
        chosen = {name: contents["relational"][name] for name in PLAYED}
        actor = Ensemble(with_changes(RelationalSettings, chosen))
        actor.load_state_dict(contents["weights"])
        return TrainedPolicy(actor, contents["tasks"], STATE, learnt_in(path.parent))
    except Exception as error:
        raise TrainingError(f"{path} does not contain a policy of relational: {error}") from error
