"""Line charts as HTML that fits any screen. Columns show their figures when they are pointed at or have the focus."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Final

COLOURS: Final = (
    "#3d8a4e",
    "#2f7fb5",
    "#9a5fb0",
    "#c8672f",
    "#7d808b",
    "#b98a00",
    "#c2487a",
    "#2a9d9d",
    "#6a6fd0",
    "#8a6a4a",
)
LEVELS: Final = (0, 0.25, 0.5, 0.75, 1)


def chart(lines: Mapping[str, Sequence[float]], names: Sequence[str], about: str) -> str:
    """A chart of figures in [0, 1] over named columns. The entries of its legend show or hide lines.

    Args:
        lines: name of a line -> a figure for each column.
        names: the names of the columns, from left to right.
        about: a description of the chart for screen readers.
    """
    last = len(names) - 1
    colours = dict(zip(lines, COLOURS, strict=False))
    paths = "".join(
        f'<g data-line="{escape(name)}" style="--line: {colours[name]}"><polyline points="'
        + " ".join(f"{100 * column / last:.2f},{100 - 100 * value:.1f}" for column, value in enumerate(values))
        + '"/></g>'
        for name, values in lines.items()
    )
    levels = "".join(f'<span style="bottom: {100 * level:g}%">{level:g}</span>' for level in LEVELS)
    columns = "".join(_column(name, column, last, lines, colours) for column, name in enumerate(names))
    legend = "".join(
        f'<label style="--line: {colours[name]}"><input type="checkbox" checked value="{escape(name)}"><i></i> '
        f"{escape(name)}</label>"
        for name in lines
    )
    return (
        f'<figure class="chart" aria-label="{escape(about)}"><div class="plot"><div class="levels" aria-hidden="true">'
        f'{levels}</div><svg viewBox="0 0 100 100" preserveAspectRatio="none" aria-hidden="true">{paths}</svg>'
        f"{columns}</div><figcaption>{legend}</figcaption></figure>"
    )


def _column(name: str, column: int, last: int, lines: Mapping[str, Sequence[float]], colours: Mapping[str, str]) -> str:
    """A column of the chart: its name, its points, and its figures, which are hidden at first."""
    points = "".join(
        f'<i data-line="{escape(line)}" style="--line: {colours[line]}; bottom: {100 * values[column]:.1f}%"></i>'
        for line, values in lines.items()
    )
    ordered = sorted(lines, key=lambda line: -lines[line][column])
    figures = "".join(
        f'<span data-line="{escape(line)}" style="--line: {colours[line]}">{escape(line)} '
        f"<b>{lines[line][column]:.2f}</b></span>"
        for line in ordered
    )
    side = "left" if column > last / 2 else "right"
    return (
        f'<button class="column {side}" style="left: {100 * column / last:.2f}%">{points}<small>{escape(name)}</small>'
        f'<span class="figures"><strong>{escape(name)}</strong>{figures}</span></button>'
    )
