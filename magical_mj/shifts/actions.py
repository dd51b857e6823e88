"""Shifts of actions: they come late, or are not those that were commanded."""

from __future__ import annotations

from collections.abc import Sequence

from magical_mj.scene.actions import NOOP
from magical_mj.shifts.shift import Factor, Shift


class Latency(Shift):
    """Actions take effect some steps late; until the first one does, nothing is done."""

    name = "latency"
    summary = "actions take effect late"
    factors = (
        Factor("steps", "steps of delay", (1, 2, 3, 4, 4), "exact"),
        Factor("spread", "steps by which the delay of each step varies at most, up and down", (0, 0, 0, 0, 2), "exact"),
    )

    def action(self, commands: Sequence[int], step: int) -> int:
        """The action of some steps before."""
        delay, spread = int(self.values["steps"]), int(self.values["spread"])
        if spread:
            delay += int(self.rng(step).integers(2 * spread + 1)) - spread
        return commands[-1 - delay] if delay < len(commands) else NOOP
