"""The table of docs/methods.md: which settings of learners differ from the paper's with `--quick` and from states."""

from __future__ import annotations

from typing import Any, Final

from magical_mj.learners.config import QUICK, STATE_TRACK
from magical_mj.learners.settings import TrainingSettings
from magical_mj.utils.settings import described
from tools.pages import table

REASONS: Final = {
    "network": "fewer operations",
    "bc": "fewer batches, so Adam and larger steps",
    "ppo": "fewer updates, so larger steps and more exploration",
    "discriminator": "fewer updates, so larger steps and batches",
    "features": "fewer batches, so larger steps",
}
"""The tables of settings, and why theirs differ."""
OWN: Final = {
    "bc.heads": "PyTorch's default",
    "ppo.averaging": "smoother policies",
    "ppo.total_steps": "time",
    "discriminator.rollouts": "as in the authors' learners",
}
"""Settings with a reason of their own."""


def settings() -> str:
    """The table: setting, paper, quick, State, reason. An empty cell is the paper's value."""
    rows = []
    for name, setting in described(TrainingSettings).items():
        part = name.partition(".")[0]
        if part in REASONS and name in {*QUICK, *STATE_TRACK}:
            values = (setting.default, QUICK.get(name), STATE_TRACK.get(name))
            rows.append((f"`{name}`", *map(_shown, values), OWN.get(name, REASONS[part])))
    return table(("Setting", "Paper", "Quick", "State", "Reason"), rows)


def _shown(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value).lower()
