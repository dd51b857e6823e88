"""The settings of a study, from its file."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta, Struct

from magical_mj.tasks.registry import ENVIRONMENTS, Pair
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError


class Study(Struct, forbid_unknown_fields=True):
    """The settings of a study, with its texts for participants. The content of a study file (TOML).

    Attributes:
        environments: an environment, such as "FindDupe-Demo" -> the required number of episodes; None: no limit.
        title: the page's title.
        instructions: shown above the arena.
        consent: the text that participants must agree to before they play; "" for none.
        completion_code: shown to participants at the end.
        episodes: the number of episodes of each participant; None: until the study has enough.
        practice: the number of practice episodes at the start, which are not stored.
        questions: the number of questions that participants may answer on the page choose.html.
        least_score: recordings with a lower score are rejected, and must be repeated. By default every complete episode
            counts.
        shows: the features that participants may use: the expert, other speeds, scenes other than the offered one.
        lease_minutes: how long a scene is reserved for a participant after the first action in it.
        per_address: the number of participants who may have a scene at the same time from one network address.
        opens: the time of the first offer, with a time zone; None: at once.
        closes: the time of the last offer, with a time zone; None: never.
    """

    environments: dict[str, Annotated[int, Meta(ge=1)] | None]
    title: str = ""
    instructions: str = ""
    consent: str = ""
    completion_code: str = ""
    episodes: Annotated[int, Meta(ge=1)] | None = None
    practice: Annotated[int, Meta(ge=0, le=20)] = 0
    questions: Annotated[int, Meta(ge=0, le=100)] = 0
    least_score: Annotated[float, Meta(ge=0, le=1)] = 0.0
    shows: list[Literal["expert", "speed", "scenes"]] = []
    lease_minutes: Annotated[float, Meta(gt=0)] = 30.0
    per_address: Annotated[int, Meta(ge=1)] = 20
    opens: Annotated[datetime, Meta(tz=True)] | None = None
    closes: Annotated[datetime, Meta(tz=True)] | None = None

    @property
    def pairs(self) -> dict[Pair, int | None]:
        """The environments and their quotas."""
        return {pair: self.environments[name] for pair in ENVIRONMENTS if (name := "-".join(pair)) in self.environments}


def read_study(path: Path) -> Study:
    """The content of a study file. Raises a `SettingsError` if it cannot be read, or is invalid."""
    try:
        study = msgspec.convert(files.read_toml(path), Study)
    except msgspec.ValidationError as error:
        raise SettingsError(f"{path} is not a valid study: {error}") from None
    unknown = study.environments.keys() - {"-".join(pair) for pair in ENVIRONMENTS}
    if unknown or not study.environments:
        raise SettingsError(f"{path}: environments must be from the benchmark, not {sorted(unknown)}")
    return study
