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
GROUPS: dict[Kind, str] = {
    "official": f"Official {STAR}: all {len(ENVIRONMENTS)} environments, {LEAST_RUNS} runs or more",
    "partial": "Partial",
    "published": f"Published {DAGGER}: the paper's, in the original simulator, by the rules 'released'",
}
SHOWN_THRESHOLDS = (0.1, 0.25, 0.5, 0.75, 0.9)


def tables(methods: Sequence[Standing]) -> list[Table]:
    """The tables: scores, drops by variant, probabilities of improvement, performance profiles, and costs."""
    return [_scores(methods), _drops(methods), _improvements(methods), _profiles(methods), _costs(methods)]


def label(method: Standing) -> str:
    """The method's name, with a mark of its kind."""
    return method.name + {"official": f" {STAR}", "partial": "", "published": DAGGER}[method.kind]


def _scores(methods: Sequence[Standing]) -> Table:
    columns = (OVERALL, *VARIANTS)
    return Table(
        "scores",
        "Interquartile mean of the mean scores of runs in environments, with its 95 % interval (stratified bootstrap), "
        "and the number of environments if some are missing; of published methods, and of those with different "
        "numbers of runs, it is taken of the mean scores over runs",
        ("Method", "rules", "looks at", *columns),
        _grouped(
            methods,
            lambda method: (rules_of(method), _looks_at(method), *(_score(method, name) for name in columns)),
        ),
        tuple(f"{method.name} is partial: {', '.join(method.gaps)}." for method in methods if method.gaps),
    )


def _score(method: Standing, variant: str) -> str:
    return " ".join(filter(None, (_text(method.scores.get(variant)), share(method, variant))))


def share(method: Standing, variant: str = OVERALL) -> str:
    """How many of the variant's environments were played, such as "(14/60)"; empty for all of them and for none."""
    every = [pair for pair in ENVIRONMENTS if variant in (OVERALL, pair[1])]
    count = sum(pair in method.means for pair in every)
    return f"({count}/{len(every)})" if 0 < count < len(every) else ""


def _looks_at(method: Standing) -> str:
    if method.entry is None:
        return "pictures"
    return "no observations" if method.entry.observations is None else method.entry.observations or "both views"


def _drops(methods: Sequence[Standing]) -> Table:
    return Table(
        "drops",
        "How far the mean score falls from Demo, on the tasks that have the variant; and the variant in which it falls "
        "most on the tasks that have all of them",
        ("Method", "Demo", *VARIANTS[1:], "falls most in"),
        _grouped(
            methods,
            lambda method: (
                f"{_text(_demo(method))} {share(method, 'Demo')}".strip(),
                *(_text(method.drops.get(name)) for name in VARIANTS[1:]),
                method.weakest or NONE,
            ),
        ),
    )


def _demo(method: Standing) -> Estimate | None:
    """The mean score in the demo variants."""
    means = [values.mean() for (_, variant), values in method.means.items() if variant == "Demo"]
    return Estimate(float(np.mean(means))) if means else None


def _improvements(methods: Sequence[Standing]) -> Table:
    mine = [method for method in methods if method.kind != "published"]
    count = len(mine)
    cells = {(a, b): improvement(mine[a], mine[b]) for a in range(count) for b in range(a + 1, count)}
    # who loses is who does not win
    cells |= {(b, a): Estimate(1 - cell.value, 1 - cell.high, 1 - cell.low) for (a, b), cell in cells.items()}
    rows = [(label(method), *(_text(cells.get((a, b))) for b in range(count))) for a, method in enumerate(mine)]
    return Table(
        "improvement",
        "How probable it is that a run of the method on the left beats one of the method above, over the environments "
        f"that both have played ({NONE} if there are none, or they were scored by different rules)",
        ("Method", *(method.name for method in mine)),
        (("", tuple(rows)),),
    )


def _profiles(methods: Sequence[Standing]) -> Table:
    places = [int(np.abs(THRESHOLDS - threshold).argmin()) for threshold in SHOWN_THRESHOLDS]
    return Table(
        "profiles",
        "Performance profiles: the share of environments and runs with a mean score of at least so much, of methods "
        "with results in all environments",
        ("Method", *(f"{threshold:g}" for threshold in SHOWN_THRESHOLDS)),
        _grouped(
            [method for method in methods if method.everywhere],
            lambda method: tuple(f"{method.profile[place]:.2f}" for place in places),
        ),
    )


def _costs(methods: Sequence[Standing]) -> Table:
    rows = []
    for method in methods:
        if method.entry is not None:
            card = method.entry.card
            training, shown = card.training, card.demonstrations
            facts = (shown.per_task, shown.set, training.hours, training.device, training.steps)
            rows.append((label(method), _score(method, OVERALL), *map(_said, facts), _said(card.hardware)))
    return Table(
        "costs",
        f"What a run cost ({NONE} where the entry does not say)",
        ("Method", OVERALL, "demonstrations per task", "of set", "hours", "device", "steps", "hardware"),
        (("", tuple(rows)),),
    )


def _said(value: object) -> str:
    return NONE if value is None else " ".join(str(value).split())


def _grouped(methods: Sequence[Standing], cells: Cells) -> tuple[Group, ...]:
    return tuple(_groups(methods, cells))


def _groups(methods: Sequence[Standing], cells: Cells) -> Iterator[Group]:
    for kind, heading in GROUPS.items():
        rows: Rows = tuple((label(method), *cells(method)) for method in methods if method.kind == kind)
        if rows:
            yield heading, rows


def _text(estimate: Estimate | None) -> str:
    if estimate is None or math.isnan(estimate.value):
        return NONE
    interval = "" if math.isnan(estimate.low) else f" [{estimate.low:.2f}, {estimate.high:.2f}]"
    return f"{estimate.value:.2f}{interval}".replace("-0.00", "0.00")
