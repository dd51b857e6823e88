"""The settings of `relational` and `redraw`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Final

from msgspec import Meta

from magical_mj.learners.settings import Positive, Share, TrainingSettings
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.settings import Count, Names, Settings

ASSUMPTIONS: Final = ("egocentric", "mirror", "rename", "hindsight", "grips", "displace", "delivery", "contrast")
"""The assumptions that `relational` tries, in this order: see `magical_relational.samples`."""
PREMISES: Final = {"mirror": "egocentric"}
"""Assumptions that are tried only if another one was kept."""


@dataclass(frozen=True)
class RelationalSettings(Settings, part="relational"):
    """Behavioural cloning under assumptions that the demo score tests. It is not in the paper."""

    assumptions: Annotated[Names, Meta(description="assumptions to try, together or in this order")] = ASSUMPTIONS
    hidden: Annotated[Count, Meta(description="size of the networks' layers")] = 64
    networks: Annotated[int, Meta(ge=1, le=100, description="number of networks whose probabilities are averaged")] = 2
    trial: Annotated[Count, Meta(description="updates of a trial, of 16 batches each")] = 200
    batch_size: Annotated[Count, Meta(description="samples in a batch")] = 64
    learning_rate: Annotated[Positive, Meta(description="of Adam")] = 1e-3
    rollouts: Annotated[Count, Meta(description="episodes of the demo scene that evaluate a trial")] = 80
    loss: Annotated[
        Share,
        Meta(description="loss of demo score at which assumptions are still kept (1: all are kept)"),
    ] = 0.15
    ways: Annotated[Count, Meta(description="samples of reaching a pose: the assumption `hindsight`")] = 30_000
    grips: Annotated[Count, Meta(description="samples of gripping a block: the assumption `grips`")] = 5_000
    plays: Annotated[Count, Meta(description="plays in each demo scene without a block, and with each moved block")] = 8
    sharpness: Annotated[Positive, Meta(description="exponent of the policy's probabilities")] = 2.0

    def __post_init__(self) -> None:
        """Checks the names of assumptions."""
        super().__post_init__()
        names = self.assumptions.split(",") if isinstance(self.assumptions, str) else self.assumptions
        names = tuple(name.strip() for name in names if name.strip())
        for name in names:
            check_name("assumption", name, ASSUMPTIONS)
        for number, name in enumerate(names):
            if name in PREMISES and PREMISES[name] not in names[:number]:
                raise SettingsError(f"{name} needs {PREMISES[name]}: list {PREMISES[name]} before it")
        object.__setattr__(self, "assumptions", names)


@dataclass(frozen=True)
class RelationalTrainingSettings(TrainingSettings):
    """One training of `relational` or `redraw`."""

    relational: RelationalSettings = field(default_factory=RelationalSettings)
