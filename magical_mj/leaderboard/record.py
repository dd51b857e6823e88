"""What an evaluation recorded of itself in ``run.json``, and whether its episodes agree with that."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from operator import index
from pathlib import Path
from typing import Any, Final, Self

from magical_mj.evaluation.scores import SETTINGS, EpisodeResult, read_settings
from magical_mj.leaderboard.claims import claim_of
from magical_mj.tasks.registry import ENVIRONMENTS, Pair
from magical_mj.utils.errors import EvaluationError, shown

FIELDS: Final = ("preset", "version", "mujoco")
"""What each episode says as well. The OpenGL backend is not among them: workers of a cluster choose their own."""


def recorded(folder: Path) -> dict[str, Any]:
    """The settings that an evaluation recorded; empty if there are none."""
    try:
        return read_settings(folder)
    except EvaluationError:
        return {}


def protocol_of(folder: Path) -> int | None:
    """The protocol's number that an evaluation recorded; None if there is none.

    Raises:
        EvaluationError: if something else is recorded there.
    """
    number = recorded(folder).get("protocol")
    if number is not None and (type(number) is not int or number < 1):
        raise EvaluationError(
            f"the protocol in {folder / SETTINGS} must be a number such as 1, and is {shown(number)}: evaluate again"
        )
    return number


def digests(folder: Path, method: str) -> list[tuple[int, str]]:
    """The runs of a method and the hashes of their policies' files, as an evaluation recorded them, if it did."""
    try:
        played = [policy for policy in recorded(folder)["policies"] if policy["name"] == method]
        return [(index(policy["run"]), str(policy["sha256"])) for policy in played if "sha256" in policy]
    except (KeyError, TypeError):
        return []


@dataclass(frozen=True)
class Plan:
    """What an evaluation was started to play.

    Attributes:
        environments: the benchmark's environments among them, as pairs of task and variant.
        runs: the numbers of the runs of each method.
    """

    environments: frozenset[Pair]
    runs: Mapping[str, frozenset[int]]

    @classmethod
    def read(cls, settings: Mapping[str, Any]) -> Self:
        """The plan in an evaluation's settings; an empty one if they hold none."""
        runs: dict[str, set[int]] = defaultdict(set)
        try:
            for policy in settings["policies"]:
                runs[policy["name"]].add(index(policy["run"]))
            named = [pair for pair in ENVIRONMENTS if "-".join(pair) in settings["environments"]]
        except (KeyError, TypeError):
            return cls(frozenset(), {})
        return cls(frozenset(named), {name: frozenset(numbers) for name, numbers in runs.items()})


def disagreements(settings: Mapping[str, Any], plan: Plan, scores: Sequence[EpisodeResult]) -> list[str]:
    """A sentence for each thing that episodes say otherwise than the settings, the plan, or their own actions."""
    found: dict[str, list[str]] = defaultdict(list)
    for score in scores:
        for what, problem in _disagreements(settings, plan, score):
            found[what].append(f"{what}: {score.policy}, {claim_of(score)}: {problem}")
    return [first + (f"; and {len(others)} more" if others else "") for first, *others in found.values()]


def _disagreements(settings: Mapping[str, Any], plan: Plan, score: EpisodeResult) -> Iterator[tuple[str, str]]:
    for what in FIELDS:
        said, here = getattr(score, what), settings.get(what)
        if said not in (here, None):  # policies that look at nothing have no preset
            yield what, f"it was played with {said!r}, and {SETTINGS} says {shown(here)}"
    if score.run not in plan.runs.get(score.policy, ()):
        yield "run", f"{SETTINGS} does not name it"
    pair = score.task, score.variant
    if pair in ENVIRONMENTS and pair not in plan.environments:
        yield "environment", f"{SETTINGS} does not name it"
    if score.steps != len(score.actions):
        yield "steps", f"it says {score.steps}, and holds {len(score.actions)} actions"
