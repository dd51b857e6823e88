"""The tables of a leaderboard."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from magical_mj.evaluation.reports.tables import DAGGER, NONE, Group, Rows, Table
from magical_mj.leaderboard.standings import (
    LEAST_RUNS,
    OVERALL,
    THRESHOLDS,
    Estimate,
    Kind,
    Standing,
    improvement,
    rules_of,
)
from magical_mj.tasks.registry import ENVIRONMENTS, VARIANTS

Cells = Callable[[Standing], tuple[str, ...]]

STAR = "★"
HEADINGS: dict[Kind, str] = {
    "official": f"Official {STAR}: all {len(ENVIRONMENTS)} environments, {LEAST_RUNS} runs or more",
    "partial": "Partial",
    "published": f"Published {DAGGER}: the paper's, in the original simulator, by the rules 'released'",
}
SHOWN_THRESHOLDS = (0.1, 0.25, 0.5, 0.75, 0.9)


def tables(found: Sequence[Standing]) -> list[Table]:
    """The tables: scores, drops by variant, probabilities of improvement, performance profiles, and costs."""
    return [_scores(found), _drops(found), _improvements(found), _profiles(found), _costs(found)]


def label(one: Standing) -> str:
    """The method's name, with a mark of its kind."""
    return one.name + {"official": f" {STAR}", "partial": "", "published": DAGGER}[one.kind]


def _scores(found: Sequence[Standing]) -> Table:
    columns = (OVERALL, *VARIANTS)
    return Table(
        "scores",
        "Interquartile mean of the mean scores of runs in environments, with its 95 % interval (stratified bootstrap), "
        "and the number of environments if some are missing; of published methods, and of those with different "
        "numbers of runs, it is taken of the mean scores over runs",
        ("Method", "rules", "looks at", *columns),
        _grouped(found, lambda one: (rules_of(one), _looks_at(one), *(_score(one, name) for name in columns))),
        tuple(f"{one.name} is partial: {', '.join(one.gaps)}." for one in found if one.gaps),
    )


def _score(one: Standing, variant: str) -> str:
    return " ".join(filter(None, (_text(one.scores.get(variant)), share(one, variant))))


def share(one: Standing, variant: str = OVERALL) -> str:
    """How many of the variant's environments were played, such as "(14/60)"; empty for all of them and for none."""
    every = [pair for pair in ENVIRONMENTS if variant in (OVERALL, pair[1])]
    count = sum(pair in one.means for pair in every)
    return f"({count}/{len(every)})" if 0 < count < len(every) else ""


def _looks_at(one: Standing) -> str:
    if one.entry is None:
        return "pictures"
    return "no observations" if one.entry.observations is None else one.entry.observations or "both views"


def _drops(found: Sequence[Standing]) -> Table:
    return Table(
        "drops",
        "How far the mean score falls from Demo, on the tasks that have the variant; and the variant in which it falls "
        "most on the tasks that have all of them",
        ("Method", "Demo", *VARIANTS[1:], "falls most in"),
        _grouped(
            found,
            lambda one: (
                f"{_text(_demo(one))} {share(one, 'Demo')}".strip(),
                *(_text(one.drops.get(name)) for name in VARIANTS[1:]),
                one.weakest or NONE,
            ),
        ),
    )


def _demo(one: Standing) -> Estimate | None:
    """The mean score in the demo variants."""
    means = [values.mean() for (_, variant), values in one.means.items() if variant == "Demo"]
    return Estimate(float(np.mean(means))) if means else None


def _improvements(found: Sequence[Standing]) -> Table:
    mine = [one for one in found if one.kind != "published"]
    count = len(mine)
    cells = {(a, b): improvement(mine[a], mine[b]) for a in range(count) for b in range(a + 1, count)}
    # who loses is who does not win
    cells |= {(b, a): Estimate(1 - cell.value, 1 - cell.high, 1 - cell.low) for (a, b), cell in cells.items()}
    rows = [(label(one), *(_text(cells.get((a, b))) for b in range(count))) for a, one in enumerate(mine)]
    return Table(
        "improvement",
        "How probable it is that a run of the method on the left beats one of the method above, over the environments "
        f"that both have played ({NONE} if there are none, or they were scored by different rules)",
        ("Method", *(one.name for one in mine)),
        (("", tuple(rows)),),
    )


def _profiles(found: Sequence[Standing]) -> Table:
    places = [int(np.abs(THRESHOLDS - threshold).argmin()) for threshold in SHOWN_THRESHOLDS]
    return Table(
        "profiles",
        "Performance profiles: the share of environments and runs with a mean score of at least so much, of methods "
        "with results in all environments",
        ("Method", *(f"{threshold:g}" for threshold in SHOWN_THRESHOLDS)),
        _grouped(
            [one for one in found if one.everywhere],
            lambda one: tuple(f"{one.profile[place]:.2f}" for place in places),
        ),
    )


def _costs(found: Sequence[Standing]) -> Table:
    rows = []
    for one in found:
        if one.entry is not None:
            card = one.entry.card
            training, shown = card["training"], card["demonstrations"]
            facts = (shown["per_task"], shown["set"], training["hours"], training["device"], training["steps"])
            rows.append((label(one), _score(one, OVERALL), *map(_said, facts), _said(card["hardware"])))
    return Table(
        "costs",
        f"What a run cost ({NONE} where the entry does not say)",
        ("Method", OVERALL, "demonstrations per task", "of set", "hours", "device", "steps", "hardware"),
        (("", tuple(rows)),),
    )


def _said(value: object) -> str:
    return NONE if value is None else " ".join(str(value).split())


def _grouped(found: Sequence[Standing], cells: Cells) -> tuple[Group, ...]:
    return tuple(_groups(found, cells))


def _groups(found: Sequence[Standing], cells: Cells) -> Iterator[Group]:
    for kind, heading in HEADINGS.items():
        rows: Rows = tuple((label(one), *cells(one)) for one in found if one.kind == kind)
        if rows:
            yield heading, rows


def _text(estimate: Estimate | None) -> str:
    if estimate is None or math.isnan(estimate.value):
        return NONE
    interval = "" if math.isnan(estimate.low) else f" [{estimate.low:.2f}, {estimate.high:.2f}]"
    return f"{estimate.value:.2f}{interval}".replace("-0.00", "0.00")
