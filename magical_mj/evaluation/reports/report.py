"""Reports: a page with tables and figures. Everything in it is computed from the files of evaluations."""

from __future__ import annotations

import math
import os
import textwrap
import warnings
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import numpy as np

from magical_mj.evaluation.folder import folders_of
from magical_mj.evaluation.reports.provenance import played_shifts
from magical_mj.evaluation.reports.results import Results, results
from magical_mj.evaluation.reports.statistics import by_shift, curve
from magical_mj.evaluation.reports.tables import (
    APPROXIMATE,
    DAGGER,
    Table,
    control_tables,
    csv,
    markdown,
    marked,
    result_tables,
    share,
    shift_tables,
)
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS
from magical_mj.tasks.spec import Rules
from magical_mj.utils import escape, files
from magical_mj.utils.errors import EvaluationError, counted
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAGE: Final = "report.md"
TITLE: Final = "# Evaluation"
DPI: Final = 150
FIGURES: Final = ("bars.png", "heat_map.png", "shifts.png")
FILES: Final = {
    "variants.csv": "Means over tasks as CSV",
    "environments.csv": "All environments as CSV",
    "bars.pdf": "Bars as PDF",
    "heat_map.pdf": "Heat map as PDF",
    "shifts.csv": "Shifts as CSV",
    "shifts.pdf": "Curves of shifts as PDF",
}
PANELS_PER_ROW: Final = 3
PANEL: Final = (4.6, 3.5)  # inches
ONE_TASK: Final = 1.5  # inches
LONGEST: Final = 30  # letters of a task's name in figures
CURVES_PER_ROW: Final = 4
CURVES: Final = (2.6, 2.2)  # inches
BARS_PER_ROW: Final = 7
MOST_DRAWN: Final = 42
"""The largest number of methods in the figures: with more, nobody can read them, and drawing takes minutes."""
MOST_TASKS: Final = 60
"""The largest number of tasks in the table of environments. Sets of intents have more."""
IN_FILE: Final = "The mean score in each environment is in environments.csv."
LETTER: Final = 0.065  # inches; the width of a small letter
DARK: Final = 0.55  # scores above this are written in white
DEMO_COLOUR: Final = "#1b2a41"
NO_ENVIRONMENT: Final = "#e4e4e4"


def check_free(out: Path, others: Sequence[str] = ()) -> bool:
    """Whether a folder, which may be missing, holds an earlier report.

    If it does not, but contains a file that the report (or one of the `others`) would replace, an `EvaluationError` is
    raised.
    """
    page = out / PAGE
    if page.is_file() and page.read_bytes().startswith(f"{TITLE}\n\n".encode()):
        return True
    for name in (PAGE, *FIGURES, *FILES, *others):
        if (out / name).exists():
            raise EvaluationError(
                f"{out / name} does not belong to an earlier report: move it, or choose another folder"
            )
    return False


def begin(out: Path, others: Sequence[str] = ()) -> bool:
    """`check_free`, then writes the page's first lines. They mark the folder as a report even if the rest fails."""
    replaced = check_free(out, others)
    if not replaced:
        files.write(out / PAGE, f"{TITLE}\n\nThis report is not finished yet.\n")
    return replaced


def report(
    folders: Iterable[Path | str],
    out: Path | str,
    *,
    with_published: bool = False,
    mixed_presets: bool = False,
    rules: Rules | None = None,
    links: Mapping[str, str] = MappingProxyType({}),
    trusted: Collection[str] = (),
) -> Path:
    """Writes the tables (Markdown, CSV) and figures of one or several evaluations.

    Args:
        folders: the folders of the evaluations, or entries of the leaderboard.
        out: the folder for the report; files of an earlier report are replaced.
        with_published: show the paper's results as well.
        mixed_presets: allow policies with different observations in one report.
        rules: score all episodes by these rules. Episodes that were scored by others are replayed.
        links: description -> file in `out`, for links on the page.
        trusted: references such as "mine:SPEC" that replayed episodes may name; see docs/trust.md.

    Returns:
        The path of the page, in Markdown.

    Raises:
        SettingsError: if `folders` is a single path instead of a list.
        EvaluationError: if a folder is not an evaluation, if two of them cannot be combined, or if `out` holds files
            with the same names that do not belong to an earlier report.
        MissingExtraError: if an extra is missing.
    """
    check_extra("reports", "eval")
    return write_report(results(folders_of(folders), with_published, mixed_presets, rules, trusted), out, links)


def write_report(
    data: Results, out: Path | str, links: Mapping[str, str] = MappingProxyType({}), first: Sequence[Table] = ()
) -> Path:
    """Writes the files of `report` from data that were read already. Returns the path of the page.

    `first` are the page's first tables.
    """
    out = files.to_path(out)
    _load_matplotlib()
    shifts = by_shift(data.scores)
    shifts = shifts.assign(split=data.scores["split"].iloc[0])
    tables = [*first, *result_tables(data), *(shift_tables(shifts) if len(shifts) else [])]
    controls = [*control_tables(data)]
    texts = {"variants.csv": csv(data.variants), "environments.csv": csv(data.environments)}
    texts |= {"shifts.csv": csv(shifts)} if len(shifts) else {}
    draw: dict[str, Callable[[], Figure]] = {"bars": lambda: bars(data)}
    if few := len(data.tasks) <= MOST_TASKS:
        draw["heat_map"] = lambda: heat_map(data)
    if len(shifts) and shifts["strength"].notna().any():
        draw["shifts"] = lambda: shift_curves(shifts, data.mark)
    out.mkdir(parents=True, exist_ok=True)
    begin(out)
    made = (*texts, *(f"{name}.pdf" for name in draw))
    listed = {**links, **{text: name for name, text in FILES.items() if name in made}}
    shown = list(map(markdown, tables))
    of_environments = [table.name for table in tables].index("environments")
    parts = [
        TITLE,
        *(f"**{note}**" for table in tables for note in table.notes if note.startswith(APPROXIMATE)),
        *([f"**{escape.markdown(data.mark)}.**"] if data.mark else []),
        _settings(data),
        "## Variants",
        *shown[:of_environments],
        "![Mean scores](bars.png)",
        "## Environments",
        *(["![Mean scores in each environment](heat_map.png)", shown[of_environments]] if few else [IN_FILE]),
        *(["## Controls", *map(markdown, controls)] if controls else []),
        *(["## Shifts"] if len(shifts) else []),
        *(["![Scores over the strength of each shift](shifts.png)"] if "shifts" in draw else []),
        *shown[of_environments + 1 :],
        "## Files",
        "\n".join(f"- {escape.markdown_link(text, quote(name))}" for text, name in listed.items()),
    ]
    page = out / PAGE
    files.write(page, "\n\n".join(part.strip() for part in parts) + "\n", overwrite=True)
    for name, text in texts.items():
        files.write(out / name, text, overwrite=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # method names may be in any script
        for name, figure in draw.items():
            drawing = figure()
            for suffix in ("png", "pdf"):
                with files.new_file(out / f"{name}.{suffix}", overwrite=True) as path:
                    drawing.savefig(path, dpi=DPI, metadata=None if suffix == "png" else {"CreationDate": None})
                drawing.set_layout_engine(None)  # the next file has the same layout
    return page


def _load_matplotlib() -> None:
    """Imports matplotlib without MPLBACKEND, then selects the backend that it names if that backend exists.

    A notebook sets MPLBACKEND for its child processes. If a child's Python lacks that backend, importing matplotlib
    fails, although these figures need no backend.
    """
    backend = os.environ.pop("MPLBACKEND", None)
    try:
        import matplotlib as mpl
    finally:
        if backend is not None:
            os.environ["MPLBACKEND"] = backend
    if backend is not None:
        with suppress(ValueError):
            mpl.rcParams["backend"] = backend


def _settings(data: Results) -> str:
    """A paragraph about the episodes: their number, environments, seeds, shifts, rules, observations and versions."""
    scores = data.scores
    presets = ", ".join(map(escape.markdown_code, scores["preset"].dropna().unique()))
    count = scores["policy"].nunique()
    methods = "one method" if count == 1 else f"{count} methods"
    environments = len(scores[["task", "variant"]].drop_duplicates())
    shifts = played_shifts(scores)
    versions = {"magical_mj": "version", "MuJoCo": "mujoco", "renderer": "gl"}
    facts = [f"{name} {', '.join(scores[column].unique())}" for name, column in versions.items()]
    return (
        f"{counted(len(scores), 'episode')} of {methods} in {counted(environments, 'environment')}; "
        f"split {escape.markdown_code(scores['split'].iloc[0])}, seeds {scores['seed'].min()} to "
        f"{scores['seed'].max()}; "
        f"{f'shifts: {escape.markdown(shifts)}; ' if shifts else ''}"
        f"scores by the rules {escape.markdown_code(scores['rules'].iloc[0])}; "
        f"observations: {presets or 'none needed'}; "
        + escape.markdown(f"{', '.join((*facts, *data.provenance.facts))}.")
    )


def extremes(scores: Iterable[EpisodeResult]) -> list[tuple[str, EpisodeResult]]:
    """The episodes for videos: the first best one of each method and task, and the first worst one if it is worse."""
    best: dict[tuple[str, str], EpisodeResult] = {}
    worst: dict[tuple[str, str], EpisodeResult] = {}
    for score in scores:
        key = score.method, score.task
        if score.actions and not score.shift:
            best[key] = max(best.get(key, score), score, key=attrgetter("score"))
            worst[key] = min(worst.get(key, score), score, key=attrgetter("score"))
    chosen: list[tuple[str, EpisodeResult]] = []
    for key, top in best.items():
        chosen.append(("best", top))
        if worst[key].score < top.score:
            chosen.append(("worst", worst[key]))
    return chosen


def heat_map(results: Results) -> Figure:
    """A panel for each drawn method with its mean score in every environment. Pairs without an environment are grey."""
    policies, rows = results.policies[:MOST_DRAWN], len(results.tasks)
    height = PANEL[1] * max(1.0, rows / len(TASKS)) if rows > 1 else ONE_TASK
    figure, panels = panels_of(len(policies), PANELS_PER_ROW, (PANEL[0], height))
    image: Any = None
    for axes, policy in zip(panels.flat, policies, strict=False):
        image = _panel(axes, results, policy)
    figure.colorbar(image, ax=panels, label="mean score", shrink=0.8, aspect=30)
    _write_below(figure, _undrawn(results), results.mark)
    return figure


def _undrawn(results: Results) -> str:
    others = len(results.policies) - MOST_DRAWN
    return f"{counted(others, 'other method')} only in the tables" if others > 0 else ""


def _panel(axes: Axes, results: Results, policy: str) -> Any:
    environments, tasks = results.environments[results.environments["policy"] == policy], results.tasks
    variants = results.shown_variants
    scores = np.full((len(tasks), len(variants)), np.nan)
    for row in environments.itertuples():
        scores[tasks.index(str(row.task)), variants.index(str(row.variant))] = row.mean
    image = axes.imshow(scores, vmin=0, vmax=1, cmap="Blues", aspect="auto")
    for (y, x), score in np.ndenumerate(scores):
        if not np.isnan(score):
            text, colour = f"{score:.2f}", "white" if score > DARK else "black"
        else:
            text, colour = "?" if (tasks[y], variants[x]) in ENVIRONMENTS else "", "black"
        axes.text(x, y, text, ha="center", va="center", fontsize=8, color=colour, in_layout=False)
    axes.set_xticks(range(len(variants)), variants, rotation=45, ha="right", rotation_mode="anchor", fontsize=9)
    names = (task if len(task) <= LONGEST else f"{task[:LONGEST]}..." for task in tasks)
    axes.set_yticks(range(len(tasks)), map(escape.mathtext, names), fontsize=9)
    axes.set_facecolor(NO_ENVIRONMENT)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(escape.mathtext(marked(policy, bool(environments["published"].any()))), fontsize=11)
    return image


def bars(results: Results) -> Figure:
    """Bars for each drawn method: the mean over tasks in the demo and in each test variant, with 95 % intervals.

    A cross at 0 marks a variant that was not played.
    """
    from matplotlib.figure import Figure

    policies = results.policies[:MOST_DRAWN]
    rows = math.ceil(len(policies) / BARS_PER_ROW)
    columns = min(BARS_PER_ROW, len(policies))
    figure = Figure((max(7.0, 1.8 * columns), 0.5 + 2.9 * rows), layout="constrained")
    for index, axes in enumerate(figure.subplots(rows, squeeze=False).flat):
        _bar_row(axes, results, policies[index * BARS_PER_ROW :][:BARS_PER_ROW], columns)
        if index == 0:
            handles = axes.get_legend_handles_labels()
            figure.legend(*handles, loc="outside upper center", ncols=8, frameon=False, fontsize=9, handlelength=1)
    rules = dict(results.variants.groupby("published")["rules"].first())
    others = (
        "" if len(set(rules.values())) < 2 else f", by the rules {rules[True]!r}, and all others by {rules[False]!r}"
    )
    marks = {
        f"{DAGGER} published, in the original simulator{others}": results.variants["published"].any(),
        "x: not played": len(results.variants) < len(policies) * len(results.shown_variants),
        "hatched: mean over only some of the tasks with the variant; their number is above the bar": (
            results.variants["missing"].ne("").any()
        ),
    }
    notes = "; ".join(mark for mark, needed in marks.items() if needed)
    _write_below(figure, notes, _undrawn(results), results.mark)
    return figure


def _write_below(figure: Figure, *lines: str) -> None:
    """Writes small text below all panels, wrapped to the width of the figure."""
    width = int(figure.get_figwidth() / LETTER)
    text = "\n".join(textwrap.fill(line, width) for line in lines if line)
    if text:
        figure.supxlabel(escape.mathtext(text), fontsize=8, color="#444")


def _bar_row(axes: Axes, results: Results, policies: list[str], columns: int) -> None:
    from matplotlib import colormaps

    variants = results.shown_variants
    colours = [DEMO_COLOUR, *colormaps["YlGnBu"](np.linspace(0.75, 0.25, len(variants) - 1))]
    width = 0.85 / len(variants)
    for index, (variant, colour) in enumerate(zip(variants, colours, strict=True)):
        rows = results.variants[results.variants["variant"] == variant].set_index("policy").reindex(policies)
        means, low, high = (rows[name].to_numpy(float) for name in ("mean", "low", "high"))
        ends = np.stack([means - low, high - means]).clip(min=0)
        centres = np.arange(len(policies)) + (index - (len(variants) - 1) / 2) * width
        axes.plot(centres[np.isnan(means)], np.full(np.isnan(means).sum(), 0.015), "x", color="#999", ms=3)
        drawn = axes.bar(centres, means, width * 0.92, color=colour, label=variant)
        for bar, end, row in zip(drawn, ends[1], rows.itertuples(), strict=True):
            if isinstance(row.missing, str) and row.missing:
                bar.set(hatch="////", edgecolor="white", linewidth=0)
                point = bar.get_x() + bar.get_width() / 2, bar.get_height() + np.nan_to_num(end) + 0.015
                text: dict[str, Any] = {"ha": "center", "va": "bottom", "rotation": 90, "fontsize": 6, "color": "#444"}
                axes.annotate(share(row), point, annotation_clip=False, **text)  # unclipped: bars of 1.0 reach the top
        known = ~np.isnan(ends).any(axis=0)
        lines: dict[str, Any] = {"fmt": "none", "ecolor": "#444", "elinewidth": 0.8, "capsize": 1.5}
        axes.errorbar(centres[known], means[known], ends[:, known], **lines)
    published = set(results.variants[results.variants["published"]]["policy"])
    names = [escape.mathtext(marked(name, name in published)).replace(", ", ",\n") for name in policies]
    axes.set_xticks(range(len(policies)), names)
    axes.tick_params(axis="x", length=0)
    axes.set_xlim(-0.55, columns - 0.45)
    axes.set_ylim(0, 1.2 if results.variants["missing"].ne("").any() else 1.02)  # room for labels above bars of 1.0
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.set_ylabel("mean score over tasks" if len(results.tasks) > 1 else f"mean score in {results.tasks[0]}")
    axes.spines[["top", "right"]].set_visible(False)


def panels_of(count: int, per_row: int, size: tuple[float, float], legend: float = 0.0) -> Any:
    """A figure and the array of its axes. The first `count` axes are visible. `size` and `legend` are in inches."""
    from matplotlib.figure import Figure

    columns = min(per_row, count)
    rows = math.ceil(count / columns)
    figure = Figure((max(4.0, size[0] * columns), legend + size[1] * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes in panels.flat[count:]:
        axes.set_axis_off()
    return figure, panels


def shift_curves(shifts: pd.DataFrame, mark: str) -> Figure:
    """The score of each method over the strength of each shift, with the interval of its difference from strength 0."""
    single = shifts[shifts["strength"].notna()]
    axes_of_shifts = list(dict.fromkeys(single["axis"]))
    figure, panels = panels_of(len(axes_of_shifts), CURVES_PER_ROW, CURVES, legend=0.5)
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
    _write_below(figure, "strength of the shift", mark)
    figure.supylabel("mean score", fontsize=9)
    return figure
