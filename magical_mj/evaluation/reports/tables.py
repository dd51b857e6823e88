"""The tables of a report and the notes below them, as Markdown and CSV."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from magical_mj.evaluation.base import UNOFFICIAL
from magical_mj.evaluation.reports.floors import floors, new_place_floors, refuting_seeds
from magical_mj.evaluation.reports.intervals import mean_over
from magical_mj.evaluation.reports.results import (
    PUBLISHED_EPISODES,
    PUBLISHED_RULES,
    PUBLISHED_RUNS,
    Results,
    counted_tasks,
    expected_environments,
)
from magical_mj.evaluation.reports.statistics import (
    LEAST_RUNS,
    area,
    by_run_and_scene,
    curve,
    half_lost,
)
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, EVERY_VARIANT, TASKS
from magical_mj.utils import escape
from magical_mj.utils.errors import counted, listing

if TYPE_CHECKING:
    import pandas as pd

NONE: Final = "–"  # noqa: RUF001 a dash is meant
PLUS_MINUS: Final = "±"
DAGGER: Final = "†"
APPROXIMATE: Final = "Approximate, no official results"
VERSIONS: Final = {"version": "versions of magical_mj", "mujoco": "versions of MuJoCo", "gl": "OpenGL backends"}

Rows = tuple[tuple[str, ...], ...]
Group = tuple[str, Rows]


@dataclass(frozen=True)
class Table:
    """A table of strings with a caption, and notes below it.

    Its groups are pairs of heading and rows. In a table without headings, the heading is "".
    """

    name: str
    caption: str
    header: tuple[str, ...]
    groups: tuple[Group, ...]
    notes: tuple[str, ...] = ()


def markdown(table: Table) -> str:
    """The table in Markdown; headings become rows in bold."""
    lines = [tuple(map(escape.markdown, table.header)), ("---", *["---:"] * (len(table.header) - 1))]
    for heading, rows in table.groups:
        if heading:
            lines.append((f"**{escape.markdown(heading)}**", *[""] * (len(table.header) - 1)))
        lines += [tuple(map(escape.markdown, cells)) for cells in rows]
    body = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    notes = "\n".join(f"- {escape.markdown(note)}" for note in table.notes)
    return "\n\n".join(filter(None, (f"{escape.markdown(table.caption)}.", body, notes))) + "\n"


def csv(frame: pd.DataFrame) -> str:
    """The frame as CSV with a header; numbers have four decimals."""
    texts = {name: column.map(escape.csv) for name, column in frame.select_dtypes(["object", "string"]).items()}
    return frame.assign(**texts).to_csv(index=False, float_format="%.4f", lineterminator="\n")


def result_tables(results: Results) -> list[Table]:
    """Scores in new places, the paper's Table 1, means with intervals, interquartile means, and all environments.

    The first table needs test scenes that refute a shortcut, and interquartile means enough runs.
    """
    tasks = counted_tasks(results.scores["task"].cat.categories)
    over = "all tasks" if len(tasks) > 1 and set(tasks) & set(TASKS) else " and ".join(tasks)
    over = over if len(tasks) <= len(TASKS) else counted(len(tasks), "task")
    header = ("Method", *results.shown_variants)
    spread = Table(
        "variants",
        f"Mean score over {over}, ± standard deviation of the run means over tasks and runs",
        header,
        _by_given(results, lambda rows: _rows(results, rows, _mean_and_std), results.variants),
        tuple(notes(results)),
    )
    own = results.variants[~results.variants["published"]]
    covered = Table(
        "intervals",
        f"Mean score over {over}, with its 95 % interval (over scenes and runs; with one run, over scenes only)",
        header,
        _by_given(results, lambda rows: _interval_rows(results, rows), own),
    )
    several = own[own["iqm"].notna()]
    robust = Table(
        "interquartile",
        f"Interquartile mean of the run means over {over}, of methods with at least {LEAST_RUNS} runs in each task",
        header,
        _by_given(
            results, lambda rows: _rows(results, rows, lambda row: f"{row.iqm:.2f} {share(row)}".rstrip()), several
        ),
    )
    by_task = results.environments.groupby("task")
    every = Table(
        "environments",
        "Mean score in each environment, ± standard deviation of the run means. Floor: the best mean score of doing "
        "nothing, random actions and replaying a demonstration, in the 100 test scenes",
        header,
        tuple(
            (task, (*_rows(results, by_task.get_group(task), _mean_and_std, task), *_floor_row(results, task)))
            for task in results.tasks
        ),
    )
    return [*_new_places(results), spread, covered, *([robust] if len(several) else []), every]


def _floor_row(results: Results, task: str) -> Rows:
    """The row of the floor in a task's environments. None if the task is not the benchmark's."""
    known = floors(results.scores["rules"].iloc[0])
    cells = tuple(f"{known[task, name]:.2f}" if (task, name) in known else NONE for name in results.shown_variants)
    return (("Floor", *cells),) if task in TASKS else ()


def _new_places(results: Results) -> Iterator[Table]:
    """The table of scores in the test scenes that refute a shortcut, if some were played."""
    seeds = refuting_seeds()
    played = results.scores[results.scores["shift"] == ""]
    refuted = [
        seed in seeds.get((task, variant), ())
        for task, variant, seed in played[["task", "variant", "seed"]].itertuples(index=False, name=None)
    ]
    rows, by_paper = [], not (played["rules"] != "paper").any()
    for policy, group in played[refuted].groupby("policy", sort=False, observed=True):
        environments = dict(list(group.groupby(["task", "variant"], observed=True)))
        found = mean_over((pair[0], pair, by_run_and_scene(rows)) for pair, rows in environments.items())
        lowest = sum(new_place_floors()[pair] for pair in environments) / len(environments)
        interval = NONE if math.isnan(found.low) else f"[{found.low:.2f}, {found.high:.2f}]"
        floor = f"{lowest:.2f}" if by_paper else NONE
        rows.append((str(policy), f"{found.value:.2f}", interval, floor, f"{len(environments)}/{len(seeds)}"))
    yield from _plain(
        "new_places",
        "Mean score in new places: the scenes where it is wrong to move what stands where the demonstrations moved "
        "something, or to end where they ended. With its 95 % interval, the floor there, and the number of "
        "environments. MoveToCorner and MakeLine have no such scene",
        ("Method", "score", "interval", "floor", "environments"),
        rows,
    )


def control_tables(results: Results) -> Iterator[Table]:
    """The table of controls: scores in the task, and in the other task that demonstrations or instructions describe."""
    scores = results.scores[results.scores["other"] != ""]
    rows = []
    for policy, group in scores.groupby("policy", sort=False, observed=True):
        known = group.dropna(subset=["other_score"])
        switched = (known["other_score"] == 1.0) & (known["score"] < 1.0)
        cells = (group["score"].mean(), known["other_score"].mean(), switched.mean())
        rows.append((str(policy), *(NONE if math.isnan(cell) else f"{cell:.2f}" for cell in cells), str(len(known))))
    yield from _plain(
        "controls",
        "Controls: policies received the demonstrations or the instruction of another task. The mean score, the "
        "mean score of the other task's intent, and the share of episodes that switched (reached the other intent, "
        "but not the task's). The last three columns are over the episodes where the other intent could be pursued",
        ("Method", "score", "other's score", "switched", "episodes"),
        rows,
    )


def _rows(results: Results, frame: pd.DataFrame, text: Callable[[Any], str], task: str | None = None) -> Rows:
    """A row for each method in the frame, with a cell for each variant. `text` formats a row of the frame as a cell."""
    cells: dict[str, dict[str, Any]] = defaultdict(dict)
    for row in frame.itertuples():
        cells[str(row.policy)][str(row.variant)] = row
    rows = []
    for policy in results.policies:
        if policy not in cells:
            continue
        by_variant = cells[policy]
        method = marked(policy, next(iter(by_variant.values())).published)
        gaps = {variant: "missing" if (task, variant) in ENVIRONMENTS else NONE for variant in results.shown_variants}
        rows.append((method, *(text(by_variant[name]) if name in by_variant else gap for name, gap in gaps.items())))
    return tuple(rows)


def _by_given(results: Results, rows: Callable[[pd.DataFrame], Rows], frame: pd.DataFrame) -> tuple[Group, ...]:
    """Groups of methods by the description of tasks that they received. `rows` formats the rows of a group."""
    given = results.given
    groups = [
        (f"Given {what or 'nothing'}" if any(given) else "", rows(frame[frame["policy"].isin(policies)]))
        for what, policies in given.items()
    ]
    return tuple((heading, cells) for heading, cells in groups if cells)


def _interval_rows(results: Results, own: pd.DataFrame) -> Rows:
    """Two rows for each method: the means, and below them their intervals."""
    means = _rows(results, own, lambda row: f"{row.mean:.2f} {share(row)}".rstrip())
    intervals = _rows(results, own, lambda row: f"[{row.low:.2f}, {row.high:.2f}]".replace("[nan, nan]", NONE))
    return tuple(row for mean, interval in zip(means, intervals, strict=True) for row in (mean, ("", *interval[1:])))


def marked(policy: str, published: bool) -> str:
    """The method's name, with a dagger if its results are published ones."""
    return policy + DAGGER if published else policy


def _mean_and_std(row: Any) -> str:
    spread = "" if math.isnan(row.std) else f" {PLUS_MINUS} {row.std:.2f}"
    return f"{row.mean:.2f}{spread} {share(row)}".rstrip()


def share(row: Any) -> str:
    """How many of the variant's tasks a mean covers, such as "(1/8)". Empty if it covers all of them."""
    if not getattr(row, "missing", ""):
        return ""
    return f"({row.tasks}/{row.tasks + row.missing.count(',') + 1})"


def notes(results: Results) -> Iterator[str]:
    """Notes that readers need to interpret the results, of one sentence or a few."""
    ours = results.variants[~results.variants["published"]]
    if "batched" in results.scores["worlds"].cat.categories:
        yield f"{APPROXIMATE}: {UNOFFICIAL}."
    if (ours["missing"] != "").any():
        yield "(m/n) after a number: the mean is over only m of the n tasks with the variant."
    played = results.environments.loc[~results.environments["published"], "task"]
    if own := [task for task in results.tasks if task not in counted_tasks(played)]:
        yield f"Tasks from outside the benchmark, which the means over tasks do not include: {listing(own)}."
    expected = {variant for _, variant in expected_environments(results.environments)}
    existing = [variant for variant in EVERY_VARIANT if variant in expected]
    for policy, variants in ours.groupby("policy", sort=False):
        yield from (f"{policy}: {gap}." for gap in _gaps(variants, existing))
    if results.provenance.gaps:
        first, *more = results.provenance.gaps
        others = f", and {len(more)} more are short" if more else ""
        yield f"Unfinished: {first}{others}."
    yield from _numbers_of_runs(results.environments)
    yield from _failures(results.scores)
    for column, name in VERSIONS.items():
        if len(different := results.scores[column].cat.categories) > 1:
            yield f"Played with different {name}: {', '.join(different)}."
    if results.variants["published"].any():
        rules = ours["rules"].iloc[0]
        others = "" if rules == PUBLISHED_RULES else f", and all others by the rules {rules!r}"
        yield (
            f"{DAGGER} Published results: in the original simulator, {PUBLISHED_RUNS} runs of {PUBLISHED_EPISODES} "
            f"episodes, scored by the rules {PUBLISHED_RULES!r}{others}."
        )
    if results.lacks_published:
        yield "The paper's results are not shown: it has none in these tasks."


def _gaps(variants: pd.DataFrame, existing: Collection[str]) -> Iterator[str]:
    """What a policy's results lack. `variants` are its rows of the table, `existing` all variants of the tasks."""
    incomplete: dict[str, list[str]] = defaultdict(list)
    for row in variants.itertuples():
        incomplete[str(row.missing)].append(str(row.variant))
    for tasks, names in incomplete.items():
        if tasks:
            yield f"incomplete in {', '.join(names)}: without {tasks}"
    if absent := [variant for variant in existing if variant not in set(variants["variant"])]:
        yield f"not evaluated in {', '.join(absent)}"


def _numbers_of_runs(environments: pd.DataFrame) -> Iterator[str]:
    """Which policies have fewer runs in some environments than in others, and what intervals of few runs cover."""
    ours = environments[~environments["published"]].groupby("policy", sort=False)["runs"].agg(["min", "max"])
    for row in ours[ours["min"] < ours["max"]].itertuples():
        lone = "; where there is only one, intervals cover scenes only" if row.min == 1 else ""
        yield f"{row.Index}: between {row.min} and {row.max} runs, depending on the environment{lone}."
    if single := [str(policy) for policy in ours.index[ours["max"] == 1]]:
        whose = "its" if len(single) == 1 else "their"
        yield f"One run of {', '.join(single)}: {whose} intervals cover scenes, not the randomness of training."
    if double := [str(policy) for policy in ours.index[ours["max"] == 2]]:
        yield f"Two runs of {', '.join(double)}: intervals assume a usual variance between trainings."


def _failures(scores: pd.DataFrame) -> Iterator[str]:
    failed = scores[scores["failure"].notna()]
    for policy, group in failed.groupby("policy", sort=False, observed=True):
        yield f"{policy}: failed episodes, which count as 0: {len(group)}; the first reason: {group['failure'].iloc[0]}"


def shift_tables(shifts: pd.DataFrame) -> Iterator[Table]:
    """The tables of a report from what `by_shift` returns."""
    strengths = tuple(map(str, range(STRENGTHS + 1)))
    single, combined = shifts[shifts["strength"].notna()], shifts[shifts["strength"].isna()]
    if len(single):
        yield Table(
            "shifts",
            "Mean score by the strength of each shift, the area under the curve (as a mean score), "
            "and the first strength with at most half of the score at strength 0",
            ("Method", *strengths, "area", "half lost at"),
            _by_axis(single, _means),
            () if single["same_scenes"].all() else ("No value at strength 0: the strengths have different scenes.",),
        )
        yield Table(
            "differences",
            "Difference of the mean score from that at strength 0 in the same scenes, with its 95 % interval",
            ("Method", *strengths[1:]),
            _by_axis(single, _losses),
        )
    yield from _plain(
        "combined",
        "Several shifts at once in the same scenes, and other bodies with the same seeds, compared with no shift",
        ("Method", "shifts", "without", "with", "difference"),
        [
            (str(row.policy), str(row.shift), f"{row.without:.2f}", f"{row.mean:.2f}", _difference(row))
            for row in combined.itertuples()
        ],
    )


def _plain(name: str, caption: str, header: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Iterator[Table]:
    """A table of these rows, without headings, if there are any."""
    if rows:
        yield Table(name, caption, header, (("", tuple(rows)),))


def _by_axis(shifts: pd.DataFrame, cells: Callable[[pd.DataFrame], tuple[str, ...]]) -> tuple[Group, ...]:
    """A group for each axis, with a row for each method."""
    return tuple(
        (str(axis), tuple((str(policy), *cells(rows)) for policy, rows in of_axis.groupby("policy", sort=False)))
        for axis, of_axis in shifts.groupby("axis", sort=False)
    )


def _means(rows: pd.DataFrame) -> tuple[str, ...]:
    points = curve(rows)
    means = (f"{points[strength]:.2f}" if strength in points else NONE for strength in range(STRENGTHS + 1))
    return *means, NONE if math.isnan(area(points)) else f"{area(points):.2f}", str(half_lost(points) or NONE)


def _losses(rows: pd.DataFrame) -> tuple[str, ...]:
    differences = {int(row.strength): _difference(row) for row in rows.itertuples()}
    return tuple(differences.get(strength, NONE) for strength in range(1, STRENGTHS + 1))


def _difference(row: Any) -> str:
    interval = "" if math.isnan(row.low) else f" [{row.low:+.2f}, {row.high:+.2f}]"
    return f"{row.difference:+.2f}{interval}"
