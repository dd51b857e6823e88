"""Which episodes evaluations planned, and how their settings differ from the official protocol.

Both are read from ``run.json``. If that file is missing, every environment is expected to have all seeds from the
lowest to the highest in ``scores.jsonl``. A leaderboard entry is expected to have the seeds of the protocol.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from magical_mj.evaluation.folder import other_format, recorded_method, recorded_policies, recorded_settings
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.protocol import SEEDS, SHIFT_SEEDS
from magical_mj.scene.bodies import BODIES, GRIPPER
from magical_mj.shifts.registry import BODY, SHIFTS, axis_and_strength, names_in, parse_shifts
from magical_mj.tasks import KNOWN
from magical_mj.tasks.languages import in_language
from magical_mj.tasks.registry import SPLITS, TASKS
from magical_mj.utils.errors import SettingsError, counted, listing

if TYPE_CHECKING:
    import pandas as pd

COLUMNS: Final = ["policy", "run", "task", "variant", "shift"]
"""The columns that identify the episodes of a run in an environment under a shift."""
RECORDED: Final = {"protocol": "protocol", "shift_protocol": "shift protocol", "demonstrations": "demonstrations"}
"""Setting in ``run.json`` -> what a report calls it."""
NAMED: Final = 20
"""The largest number of shifts that a report names; it counts the others."""

Group = tuple[str, int, str, str, str]
Settings = Mapping[str, Any]


@dataclass(frozen=True)
class Provenance:
    """How the episodes of a report were produced.

    Attributes:
        gaps: runs and environments with missing episodes, such as "BC, run 0, FindDupe Demo has 3 of 100 episodes".
        deviations: differences from the official protocol, in a few words each. Shifts and variants do not count as
            differences, since the tables show them.
        facts: the recorded protocol numbers, such as "protocol 1".
    """

    gaps: tuple[str, ...]
    deviations: tuple[str, ...]
    facts: tuple[str, ...]


def provenance(folders: Sequence[Path], scores: pd.DataFrame) -> Provenance:
    """How the episodes in these folders were produced. `scores` has a row for each episode."""
    settings = {folder: recorded_settings(folder) for folder in folders}
    plan: dict[Group, set[range]] = defaultdict(set)
    for folder in folders:
        for group, seeds in _planned(folder, settings[folder], scores[scores["folder"] == str(folder)]):
            plan[group].add(seeds)
    merged = {group: _merged(seeds) for group, seeds in plan.items()}
    known = [values for values in settings.values() if values]
    return Provenance(tuple(_gaps(merged, scores)), tuple(_deviations(known, scores, merged)), tuple(_facts(known)))


def _planned(folder: Path, settings: Settings, scores: pd.DataFrame) -> Iterator[tuple[Group, range]]:
    """The planned seeds of each run in each environment: from the settings, or without settings from the scores."""
    if settings:
        first = SPLITS.get(settings["split"], 0) + settings["first_seed"]
        seeds = range(first, first + settings["episodes"])
        played = set(zip(scores["task"], scores["shift"], strict=True))
        yield from ((group, seeds) for group in _groups(settings, played))
    elif len(scores):
        seen = range(int(scores["seed"].min()), int(scores["seed"].max()) + 1)
        for group in scores[COLUMNS].drop_duplicates().itertuples(index=False, name=None):
            yield group, range(SHIFT_SEEDS if group[-1] else SEEDS) if other_format(folder) else seen


def _groups(settings: Settings, played: Set[tuple[str, str]]) -> Iterator[Group]:
    """The runs and environments that the settings plan. `played` holds the (task, shift) pairs that have episodes."""
    policies = [(recorded_method(policy, settings), policy.run) for policy in recorded_policies(settings)]
    for environment, shift in product(settings["environments"], settings["shifts"]):
        task, _, variant = environment.rpartition("-")
        if shift != f"{BODY}:{settings['body']}" and ((task, shift) in played or _can_have(task, shift)):
            yield from ((policy, run, task, variant, shift) for policy, run in policies)


def _can_have(task: str, shift: str) -> bool:
    """Whether a task supports a shift. False for tasks and shifts of users, since their code is not run here."""
    if not shift:
        return True
    if task not in KNOWN or not all(name in (*SHIFTS, *BODIES) for name in names_in(shift)):
        return False
    try:
        parse_shifts(shift, task)
    except SettingsError:
        return False
    return True


def _merged(seeds: Set[range]) -> list[range]:
    """Ranges of seeds without overlaps. They overlap if several folders hold parts of a run."""
    merged: list[range] = []
    for part in sorted(seeds, key=lambda part: part.start):
        if merged and part.start <= merged[-1].stop:
            merged[-1] = range(merged[-1].start, max(part.stop, merged[-1].stop))
        else:
            merged.append(part)
    return merged


def _count(seeds: Sequence[range]) -> int:
    return sum(part.stop - part.start for part in seeds)


def _gaps(plan: Mapping[Group, Sequence[range]], scores: pd.DataFrame) -> Iterator[str]:
    played: Any = dict(list(scores.groupby(COLUMNS, observed=True)["seed"]))
    for (policy, run, *environment), seeds in plan.items():
        numbers = played.get((policy, run, *environment), ())
        count = sum(number in part for number in numbers for part in seeds)
        if count < _count(seeds):
            planned = counted(_count(seeds), "episode")
            yield f"{policy}, run {run}, {' '.join(filter(None, environment))} has {count} of {planned}"


def _deviations(
    known: Sequence[Settings], scores: pd.DataFrame, plan: Mapping[Group, Sequence[range]]
) -> Iterator[str]:
    split = str(scores["split"].iloc[0])
    if split != "test":
        yield f"the split {split}"
    if first := min(seeds[0].start for seeds in plan.values()) - SPLITS.get(split, 0):
        yield f"first seed {first} of the split"
    counts = sorted({_count(seeds) for (*_, shift), seeds in plan.items() if not shift})
    others = [str(task) for task in scores["task"].unique() if not in_language(str(task))]
    if others and counts != [SEEDS]:  # sets of a language have other numbers
        number = " to ".join(map(str, sorted({counts[0], counts[-1]})))
        yield f"{number} episode{'' if number == '1' else 's'} in each environment instead of {SEEDS}"
    if set(scores["worlds"]) != {"single"}:
        yield "batched environments of MuJoCo Warp"
    usual = {"body": GRIPPER, "wrap": "", "like": "", "time_limit": EvaluationSettings.time_limit}
    words = {"body": "the body {}", "wrap": "the wrapper {}", "like": "policies receive the task name {}"}
    for name, text in {**words, "time_limit": "a time limit of {} s"}.items():
        if unusual := sorted({settings.get(name, usual[name]) for settings in known} - {usual[name]}):
            yield text.format(", ".join(map(str, unusual)))
    for settings in known:
        for policy in filter(lambda policy: policy.unfinished, recorded_policies(settings)):
            method = recorded_method(policy, settings)
            yield f"the training of {method}, run {policy.run}, has stopped at {policy.unfinished}"
    yield from _equal_runs(known, scores)
    if own := [task for task in others if task not in TASKS]:
        yield f"tasks from outside the benchmark: {listing(own)}"


def _equal_runs(known: Sequence[Settings], scores: pd.DataFrame) -> Iterator[str]:
    """Runs of own code that act alike in all common episodes. Equal model files are refused before."""
    code = {
        (recorded_method(policy, settings), policy.run)
        for settings in known
        for policy in recorded_policies(settings)
        if not policy.sha256
    }
    for (policy, first), (other, second) in combinations(sorted(code), 2):
        if policy != other:
            continue
        rows = scores[scores["policy"] == policy].set_index([*COLUMNS[2:], "seed"])
        ours, theirs = (rows.loc[rows["run"] == run, "actions"] for run in (first, second))
        common = ours.index.intersection(theirs.index)
        if len(common) and ours.loc[common].equals(theirs.loc[common]):
            alike = counted(len(common), "common episode")
            yield f"the runs {first} and {second} of {policy} act alike in {alike}, so that they are one run"


def _facts(known: Sequence[Settings]) -> Iterator[str]:
    for name, text in RECORDED.items():
        if numbers := sorted({settings[name] for settings in known if name in settings}):
            yield f"{text} {', '.join(map(str, numbers))}"


def played_shifts(scores: pd.DataFrame) -> str:
    """The shifts that were played, such as "camera:1-5, light:2". Empty without shifts."""
    strengths: dict[str, list[int]] = defaultdict(list)
    names: list[str] = []
    for label in filter(None, map(str, scores["shift"].cat.categories)):
        if one := axis_and_strength(label):
            strengths[one[0]].append(one[1])
        else:
            names.append(label)
    for axis, levels in strengths.items():
        if len(levels) > 1 and levels == list(range(levels[0], levels[-1] + 1)):
            names.append(f"{axis}:{levels[0]}-{levels[-1]}")
        else:
            names += [f"{axis}:{level}" for level in levels]
    others = len(names) - NAMED
    return ", ".join([*names[:NAMED], *([f"and {counted(others, 'other')}"] if others > 0 else [])])
