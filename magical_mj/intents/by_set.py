"""Reports of intents by set: solved episodes, those without side effects, scores, and what shortcuts reach.

Demo, the scenes of the demonstrations, has rows of its own. Means never mix it with Layout and All.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Annotated, Final, NamedTuple

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from magical_mj.evaluation.replay import engine_for, replay_problem
from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.evaluation.reports.section import Inputs, Prepared, ReportSection, write_page
from magical_mj.evaluation.reports.tables import NONE, Table, markdown
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.draws import in_sets
from magical_mj.intents.names import OFFICIAL_VARIANTS
from magical_mj.intents.tasks import PREFIX, task_of
from magical_mj.utils.errors import SettingsError

FLOORS: Final = Path(__file__).with_name("floors.json")
PAGE: Final = "intents.md"
OUTSIDE: Final = "in no set"
MEASURES: Final = ("success", "clean success", "score")
HEADER: Final = ("Set", "Variants", "intents", "runs", *MEASURES, "best shortcut")


class Row(NamedTuple):
    """The results of a method in a set.

    Attributes:
        method: the policy and what it received.
        set: the name of the set, with the settings of its demo scenes if there are several.
        variants: "Demo", or the other variants that were played.
        intents, runs, episodes: their numbers.
        values: measure -> the mean with its interval, which covers intents, their scenes, and runs.
        floor: the name of the best shortcut in this set, and its share of solved episodes; None if it is not known.
    """

    method: str
    set: str
    variants: str
    intents: int
    runs: int
    episodes: int
    values: Mapping[str, Estimate]
    floor: tuple[str, float] | None


def set_of(task: str) -> str:
    """The set that an intent is in, without regard to the number of demo scenes."""
    own = task_of(task.removeprefix(PREFIX))
    return _sets().get(str(replace(own, demos=1, contrasting=False)), OUTSIDE)


@cache
def _sets() -> Mapping[str, str]:
    return {draws.task: draws.set for draws in in_sets()}


@cache
def floors() -> Mapping[str, Mapping[str, float]]:
    """Set -> shortcut -> the share of scenes of Layout and All that it solves, planned without simulation."""
    return msgspec.json.decode(FLOORS.read_bytes(), type=dict[str, dict[str, float]])


def rows(episodes: Iterable[EpisodeResult]) -> list[Row]:
    """The rows of all methods and sets. Episodes without recorded side effects are replayed."""
    groups = defaultdict[tuple[str, str, bool], list[EpisodeResult]](list)
    for episode in episodes:
        if episode.task.startswith(PREFIX) and not episode.shift and not episode.other:
            name = set_of(episode.task) + _several(episode.task)
            groups[episode.method, name, episode.variant == "Demo"].append(with_side_effects(episode))
    return [_row(method, name, group) for (method, name, _), group in sorted(groups.items())]


def _several(task: str) -> str:
    """The settings of an intent with several demo scenes, since policies may receive demonstrations in all of them."""
    own = task_of(task.removeprefix(PREFIX))
    return str(replace(own, seed=0)).removeprefix(str(own.intent))


def _row(method: str, name: str, group: Sequence[EpisodeResult]) -> Row:
    tasks, runs = sorted({one.task for one in group}), sorted({one.run for one in group})
    values = {measure: _estimate(group, measure, tasks, runs) for measure in MEASURES}
    variants = {one.variant for one in group}
    known = floors().get(name.partition(" [")[0], {}) if variants <= {*OFFICIAL_VARIANTS} else {}
    best = max(known.items(), key=lambda pair: pair[1], default=None)
    shown = " and ".join(sorted(variants, reverse=True))
    return Row(method, name, shown, len(tasks), len(runs), len(group), values, best)


def _estimate(group: Sequence[EpisodeResult], measure: str, tasks: Sequence[str], runs: Sequence[int]) -> Estimate:
    """The mean over intents and runs, with its interval."""
    return estimate([Cell(by_intent(group, measure, tasks, runs), 1.0, "policies", "intents")])


def by_intent(
    group: Iterable[EpisodeResult], measure: str, tasks: Sequence[str], runs: Sequence[int]
) -> NDArray[np.float64]:
    """The means over episodes of each intent, shape (runs, intents); NaN for what was not played."""
    found = defaultdict[tuple[int, str], list[float]](list)
    for one in group:
        solved = one.score == 1.0
        value = {"success": solved, "clean success": solved and not one.others_moved, "score": one.score}[measure]
        found[one.run, one.task].append(float(value))
    return np.array([[np.mean(found.get((run, task), [np.nan])) for task in tasks] for run in runs], np.float64)


def with_side_effects(episode: EpisodeResult) -> EpisodeResult:
    """The episode with its side effects, from a replay if they were not recorded."""
    if episode.others_moved is not None or episode.failure is not None or episode.score < 1.0:
        return episode
    with closing(engine_for(episode)) as engine:
        if problem := replay_problem(episode, engine):
            raise SettingsError(f"{episode.title}: {problem}")
        return replace(episode, others_moved=engine.side_effects())


def table(every: Sequence[Row]) -> Table:
    """The rows as a table with a group for each method."""
    groups = defaultdict[str, list[tuple[str, ...]]](list)
    for row in every:
        groups[row.method].append(cells(row))
    return Table("intents", "Intents by set", HEADER, tuple((name, tuple(rows)) for name, rows in groups.items()))


def cells(row: Row) -> tuple[str, ...]:
    """A row of a table with this `HEADER`."""
    floor = f"{row.floor[1]:.2f} ({row.floor[0]})" if row.floor else NONE
    measured = (_text(row.values[measure]) for measure in MEASURES)
    return row.set, row.variants, str(row.intents), str(row.runs), *measured, floor


def _text(value: Estimate) -> str:
    return f"{value.value:.2f}" if np.isnan(value.low) else f"{value.value:.2f} ({value.low:.2f} to {value.high:.2f})"


def write_rows(every: Sequence[Row], out: Path, _: Mapping[EpisodeResult, str]) -> Path:
    """Writes the page and intents.csv into a folder. Returns the path of the page."""
    import pandas as pd

    notes = (
        "Success: the share of solved episodes. Clean success: no block moved that the intent does not name. Intervals "
        "(95 %) cover intents, their scenes and runs. The best shortcut is the one that solves most scenes of Layout "
        "and All; see docs/intents-evaluation.md of magical_mj."
    )
    frame = pd.DataFrame(
        {
            **{name: getattr(row, name) for name in ("method", "set", "variants", "intents", "runs", "episodes")},
            **{f"{name}{end}": value for name, each in row.values.items() for end, value in _ends(each)},
            "floor": row.floor[1] if row.floor else np.nan,
        }
        for row in every
    )
    return write_page(out / PAGE, ["# Intents by set", notes, markdown(table(every))], {"intents.csv": frame})


def _ends(value: Estimate) -> list[tuple[str, float]]:
    return [("", value.value), (" low", value.low), (" high", value.high)]


@dataclass(frozen=True, kw_only=True)
class IntentsSection(ReportSection):
    """The option `--intents` of `magical-mj report`."""

    title = "Intents by set"
    folder = "intents"
    option = "intents"

    intents: Annotated[
        bool,
        Meta(description="Rows by set of intents: success, clean success and score; see docs/intents-evaluation.md."),
    ] = False

    def prepare(self, inputs: Inputs) -> Prepared:
        """Computes the rows of all episodes of intents."""
        if not (found := rows(episode for _, episode in inputs.episodes())):
            raise SettingsError("--intents: no episode is of an intent")
        return Prepared(partial(write_rows, found), [table(found)])
