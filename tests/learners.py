"""What the tests of the learners share: trainings that take a second."""

from __future__ import annotations

from typing import Any

from magical_mj.baselines import Settings, load_settings

TINY = {
    "network.first_stride": 4,
    "network.first_channels": 4,
    "network.channels": 4,
    "network.hidden": 8,
    "evaluations": 0,
    "checkpoints": 4,
    "demonstrations": 2,
    "device": "cpu",
}


def tiny(method: str = "bc", tasks: str = "MoveToRegion", **changes: Any) -> Settings:
    """Settings with a network of a few weights."""
    return load_settings(method, tasks, quick=True, **{**TINY, "bc.batches": 12, "bc.batch_size": 4, **changes})
