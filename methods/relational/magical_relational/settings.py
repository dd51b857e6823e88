"""The settings of `relational` and `redraw`."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, ClassVar, Final

from msgspec import Meta

from magical_mj.learners.settings import Positive, Share, TrainingSettings
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.settings import Count, Names, Settings

ASSUMPTIONS: Final = ("egocentric", "mirror", "rename", "hindsight", "grips", "displace")
"""What `relational` tries to assume about a task, in this order: see `magical_relational.samples`."""
PREMISES: Final = {"mirror": "egocentric"}
"""Assumptions that are tried only where another one was kept."""


@dataclass(frozen=True)
class RelationalSettings(Settings):
    """Behavioural cloning with assumptions that the demo scene must bear out; not in the paper."""

    part: ClassVar[str] = "relational"

    assumptions: Annotated[Names, Meta(description="those that are tried, together or in this order")] = ASSUMPTIONS
    hidden: Count = 64
    networks: Annotated[int, Meta(ge=1, le=100, description="whose probabilities are averaged")] = 2
    trial: Annotated[Count, Meta(description="updates, of 16 batches each, after which the demo scene judges")] = 200
    batch_size: Count = 64
    learning_rate: Annotated[Positive, Meta(description="of Adam")] = 1e-3
    rollouts: Annotated[Count, Meta(description="episodes of the demo scene that judge")] = 80
    loss: Annotated[
        Share,
        Meta(description="of score in the demo scene that an assumption may cost (1: all are kept)"),
    ] = 0.15
    ways: Annotated[Count, Meta(description="samples by hindsight")] = 30_000
    grips: Annotated[Count, Meta(description="samples of taking a block from close by")] = 5_000
    plays: Annotated[Count, Meta(description="in each demonstration's scene, free and with each block it moves")] = 8
    sharpness: Annotated[Positive, Meta(description="power of the probabilities that the policy draws from")] = 2.0

    def __post_init__(self) -> None:
        """Checks the names."""
        super().__post_init__()
        names = self.assumptions.split(",") if isinstance(self.assumptions, str) else self.assumptions
        names = tuple(name.strip() for name in names if name.strip())
        for name in names:
            check_name("assumption", name, ASSUMPTIONS)
        for number, name in enumerate(names):
            if name in PREMISES and PREMISES[name] not in names[:number]:
                raise SettingsError(f"{name} is tried where {PREMISES[name]} was kept: name {PREMISES[name]} before it")
        object.__setattr__(self, "assumptions", names)


@dataclass(frozen=True)
class RelationalTrainingSettings(TrainingSettings):
    """One training of `relational` or `redraw`."""

    relational: RelationalSettings = field(default_factory=RelationalSettings)
