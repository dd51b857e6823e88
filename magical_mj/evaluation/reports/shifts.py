"""Shifts in reports: scores by strength, their differences from strength 0 in the same scenes, and what they say.

Strength 0 is the distractor-free control: the same policies in the same scenes without the shift.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from magical_mj.evaluation.reports.statistics import paired_means
from magical_mj.evaluation.reports.tables import NONE, Table
from magical_mj.evaluation.scores import SCORE_TOLERANCE
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.utils import escape

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

EPISODE: Final = ["policy", "run", "task", "variant", "seed"]
PANELS_PER_ROW: Final = 4
PANEL: Final = (2.6, 2.2)  # inches


def by_shift(scores: pd.DataFrame) -> pd.DataFrame:
    """How each policy does under each shift, and without it in the same scenes.

    Args:
        scores: a row for each episode; see `magical_mj.evaluation.reports.results.gather`.

    Returns:
        A row for each policy and shift: the `axis` and its `strength` (NaN of several, and of bodies), the mean score
        with the shift (`mean`) and without it (`without`), the `difference` and its 95 % interval (`low`, `high`), and
        the numbers of `scenes` and `environments`. The interval resamples the scenes of each environment. Scores of
        several runs in one scene are averaged first; all environments have equal weight.
    """
    import pandas as pd

    played = scores.astype(dict.fromkeys(["policy", "task", "variant", "shift"], str)).set_index(EPISODE)
    without = played[played["shift"] == ""]["score"]
    rows: list[dict[str, Any]] = []
    for (policy, shift), group in played[played["shift"] != ""].groupby(["policy", "shift"]):
        both = pd.concat([without, group["score"]], axis=1, join="inner", keys=["without", "mean"])
        both = both.groupby(["task", "variant", "seed"]).mean()
        if both.empty:
            continue
        axis, _, strength = str(shift).rpartition(":")
        graded = "+" not in str(shift) and strength.isdigit()
        rows.append(
            {
                "policy": policy,
                "shift": shift,
                "axis": axis if graded else shift,
                "strength": int(strength) if graded else math.nan,
                **paired_means(both, "mean", "without"),
            }
        )
    order = list(SHIFTS)
    rows.sort(key=lambda row: order.index(row["axis"]) if row["axis"] in order else len(order))
    return pd.DataFrame(rows)


def curve(rows: pd.DataFrame) -> dict[int, float]:
    """The mean score at each strength that was played, from the rows of one policy and axis; 0 is without the shift."""
    points = {int(row.strength): float(row.mean) for row in rows.itertuples()}
    return {0: float(rows["without"].iloc[0]), **dict(sorted(points.items()))}


def area(points: dict[int, float]) -> float:
    """The area under a curve over strengths 0 to 5, divided by 5: a mean score. NaN if a strength is missing."""
    if set(points) != set(range(STRENGTHS + 1)):
        return math.nan
    return (sum(points.values()) - (points[0] + points[STRENGTHS]) / 2) / STRENGTHS


def half_lost(points: dict[int, float]) -> int | None:
    """The first strength at which at most half of the score at strength 0 is left; None if there is none."""
    lost = [strength for strength, score in points.items() if strength and score <= points[0] / 2 + SCORE_TOLERANCE]
    return min(lost) if lost and points[0] > SCORE_TOLERANCE else None


def shift_tables(shifts: pd.DataFrame) -> Iterator[Table]:
    """The tables of a report from what `by_shift` returns."""
    strengths = tuple(map(str, range(STRENGTHS + 1)))
    single, combined = shifts[shifts["strength"].notna()], shifts[shifts["strength"].isna()]
    scores, differences = [], []
    for axis, of_axis in single.groupby("axis", sort=False):
        means, losses = [], []
        for policy, rows in of_axis.groupby("policy", sort=False):
            points, half = curve(rows), half_lost(curve(rows))
            cells = [f"{points[strength]:.2f}" if strength in points else NONE for strength in range(STRENGTHS + 1)]
            under = area(points)
            means.append((str(policy), *cells, NONE if math.isnan(under) else f"{under:.2f}", str(half or NONE)))
            of_strength = {int(row.strength): _difference(row) for row in rows.itertuples()}
            losses.append((str(policy), *(of_strength.get(strength, NONE) for strength in range(1, STRENGTHS + 1))))
        scores.append((str(axis), tuple(means)))
        differences.append((str(axis), tuple(losses)))
    if scores:
        yield Table(
            "shifts",
            "Mean score by the strength of each shift, the area under the curve (as a mean score), "
            "and the first strength at which at most half of the score at strength 0 is left",
            ("Method", *strengths, "area", "half lost at"),
            tuple(scores),
        )
        yield Table(
            "differences",
            "Difference of the mean score from that at strength 0 in the same scenes, with its 95 % interval "
            "(bootstrap of the scenes within each environment)",
            ("Method", *strengths[1:]),
            tuple(differences),
        )
    if len(combined):
        rows = tuple(
            (str(row.policy), str(row.shift), f"{row.without:.2f}", f"{row.mean:.2f}", _difference(row))
            for row in combined.itertuples()
        )
        header = ("Method", "shifts", "without", "with", "difference")
        yield Table(
            "combined",
            "Several shifts at once in the same scenes, and other bodies with the same seeds, beside none",
            header,
            (("", rows),),
        )


def _difference(row: Any) -> str:
    interval = "" if math.isnan(row.low) else f" [{row.low:+.2f}, {row.high:+.2f}]"
    return f"{row.difference:+.2f}{interval}"


def panels_of(count: int, per_row: int, size: tuple[float, float], legend: float = 0.0) -> Any:
    """A figure, and the array of its axes, of which the first `count` are shown. `size` and `legend` are in inches."""
    from matplotlib.figure import Figure

    columns = min(per_row, count)
    rows = math.ceil(count / columns)
    figure = Figure((max(4.0, size[0] * columns), legend + size[1] * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in panels.flat[count:]:
        axes.set_axis_off()
    return figure, panels


def shift_curves(shifts: pd.DataFrame) -> Figure:
    """The score of each method over the strength of each shift, with the interval of its difference from strength 0."""
    single = shifts[shifts["strength"].notna()]
    axes_of_shifts = list(dict.fromkeys(single["axis"]))
    figure, panels = panels_of(len(axes_of_shifts), PANELS_PER_ROW, PANEL, legend=0.5)
    for axes, axis in zip(panels.flat, axes_of_shifts, strict=False):
        for number, policy in enumerate(dict.fromkeys(single["policy"])):
            group = single[(single["axis"] == axis) & (single["policy"] == policy)].sort_values("strength")
            if len(group):
                points, colour = curve(group), f"C{number % 10}"
                axes.plot(list(points), list(points.values()), "o-", ms=3, lw=1.2, color=colour, label=policy)
                low, high = (group["without"] + group[end] for end in ("low", "high"))
                axes.fill_between(group["strength"], low.clip(0, 1), high.clip(0, 1), color=colour, alpha=0.15, lw=0)
        axes.set_title(escape.mathtext(str(axis)), fontsize=10)
        axes.set_ylim(-0.02, 1.05)
        axes.set_xticks(range(STRENGTHS + 1))
        axes.spines[["top", "right"]].set_visible(False)
    lines = {line.get_label(): line for axes in panels.flat for line in axes.get_lines()}
    names = [escape.mathtext(str(name)) for name in lines]
    figure.legend(list(lines.values()), names, loc="outside upper center", ncols=4, frameon=False, fontsize=9)
    figure.supxlabel("strength of the shift", fontsize=9)
    figure.supylabel("mean score", fontsize=9)
    return figure
