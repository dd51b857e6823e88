"""Figures: a heat map of tasks and variants for each method, and bars of demo against test variants."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from magical_mj.evaluation.reports.results import Results
from magical_mj.evaluation.reports.tables import DAGGER, marked, share
from magical_mj.tasks.registry import ENVIRONMENTS, VARIANTS
from magical_mj.utils import escape

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PANELS_PER_ROW: Final = 3
PANEL: Final = (4.6, 3.5)  # inches
BARS_PER_ROW: Final = 7
DARK: Final = 0.55  # scores above this are written in white
DEMO_COLOUR: Final = "#1b2a41"
NO_ENVIRONMENT: Final = "#e4e4e4"


def heat_map(results: Results) -> Figure:
    """For each method, its mean score in every environment; grey where there is no such environment."""
    from matplotlib.figure import Figure

    policies = results.policies
    columns = min(PANELS_PER_ROW, len(policies))
    rows = math.ceil(len(policies) / columns)
    figure = Figure((PANEL[0] * columns, PANEL[1] * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    image: Any = None
    for axes, policy in zip(panels.flat, policies, strict=False):
        image = _panel(axes, results, policy)
    for axes in list(panels.flat)[len(policies) :]:
        axes.set_axis_off()
    figure.colorbar(image, ax=panels, label="mean score", shrink=0.8, aspect=30)
    return figure


def _panel(axes: Axes, results: Results, policy: str) -> Any:
    environments, tasks = results.environments[results.environments["policy"] == policy], results.tasks
    scores = np.full((len(tasks), len(VARIANTS)), np.nan)
    for row in environments.itertuples():
        scores[tasks.index(str(row.task)), VARIANTS.index(str(row.variant))] = row.mean
    image = axes.imshow(scores, vmin=0, vmax=1, cmap="Blues", aspect="auto")
    for (y, x), score in np.ndenumerate(scores):
        if not np.isnan(score):
            text, colour = f"{score:.2f}", "white" if score > DARK else "black"
        else:
            text, colour = "?" if (tasks[y], VARIANTS[x]) in ENVIRONMENTS else "", "black"
        axes.text(x, y, text, ha="center", va="center", fontsize=8, color=colour)
    axes.set_xticks(range(len(VARIANTS)), VARIANTS, rotation=45, ha="right", rotation_mode="anchor", fontsize=9)
    axes.set_yticks(range(len(tasks)), map(escape.mathtext, tasks), fontsize=9)
    axes.set_facecolor(NO_ENVIRONMENT)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(escape.mathtext(marked(policy, bool(environments["published"].any()))), fontsize=11)
    return image


def bars(results: Results) -> Figure:
    """For each method, its mean score over tasks in the demo and in each test variant, with 95 % intervals."""
    from matplotlib.figure import Figure

    rows = math.ceil(len(results.policies) / BARS_PER_ROW)
    columns = min(BARS_PER_ROW, len(results.policies))
    figure = Figure((max(7.0, 1.8 * columns), 0.5 + 2.9 * rows), layout="constrained")
    for index, axes in enumerate(figure.subplots(rows, squeeze=False).flat):
        _bar_row(axes, results, results.policies[index * BARS_PER_ROW :][:BARS_PER_ROW], columns)
        if index == 0:
            handles = axes.get_legend_handles_labels()
            figure.legend(*handles, loc="outside upper center", ncols=8, frameon=False, fontsize=9, handlelength=1)
    _explain(figure, results)
    return figure


def _explain(figure: Figure, results: Results) -> None:
    """Adds a legend of the marks below the bars, if there are any marks."""
    marks = {
        f"{DAGGER} published, in the original simulator": results.variants["published"].any(),
        "hatched: mean over only some of the tasks with the variant; their number is above the bar": (
            results.variants["missing"].ne("").any()
        ),
    }
    text = "; ".join(mark for mark, needed in marks.items() if needed)
    if text:
        figure.supxlabel(text, fontsize=8, color="#444")


def _bar_row(axes: Axes, results: Results, policies: list[str], columns: int) -> None:
    from matplotlib import colormaps

    colours = [DEMO_COLOUR, *colormaps["YlGnBu"](np.linspace(0.75, 0.25, len(VARIANTS) - 1))]
    width = 0.85 / len(VARIANTS)
    for index, (variant, colour) in enumerate(zip(VARIANTS, colours, strict=True)):
        rows = results.variants[results.variants["variant"] == variant].set_index("policy").reindex(policies)
        means, low, high = (rows[name].to_numpy(float) for name in ("mean", "low", "high"))
        ends = np.stack([means - low, high - means]).clip(min=0)
        places = np.arange(len(policies)) + (index - (len(VARIANTS) - 1) / 2) * width
        drawn = axes.bar(places, means, width * 0.92, color=colour, label=variant)
        for bar, end, row in zip(drawn, ends[1], rows.itertuples(), strict=True):
            if isinstance(row.missing, str) and row.missing:
                bar.set(hatch="////", edgecolor="white", linewidth=0)
                place = bar.get_x() + bar.get_width() / 2, bar.get_height() + np.nan_to_num(end) + 0.015
                text: dict[str, Any] = {"ha": "center", "va": "bottom", "rotation": 90, "fontsize": 6, "color": "#444"}
                axes.annotate(share(row), place, annotation_clip=False, **text)  # above bars of 1.0, too
        known = ~np.isnan(ends).any(axis=0)
        lines: dict[str, Any] = {"fmt": "none", "ecolor": "#444", "elinewidth": 0.8, "capsize": 1.5}
        axes.errorbar(places[known], means[known], ends[:, known], **lines)
    published = set(results.variants[results.variants["published"]]["policy"])
    names = [escape.mathtext(marked(name, name in published)).replace(", ", ",\n") for name in policies]
    axes.set_xticks(range(len(policies)), names)
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.55, columns - 0.45)
    axes.set_ylim(0, 1)
    axes.set_ylabel("mean score over tasks")
    axes.spines[["top", "right"]].set_visible(False)
