"""The commands of the learners, as `magical_mj.cli.app.COMMANDS` lists those of the core."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "train": ("magical_mj.learners.cli.train:train", "Train a policy."),
    "evaluate-reward": ("magical_mj.learners.cli.train:evaluate_reward", "Compare learnt rewards with the score."),
    "export-policy": ("magical_mj.learners.cli.train:export", "Write a trained policy as an ONNX file."),
    "experiment": ("magical_mj.learners.cli.train:experiment", "Train and evaluate methods x tasks x seeds."),
}
