"""Charts of scores as HTML that fits any screen. A column that is pointed at, or focused, lists its scores."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import Final

from magical_mj.evaluation.reports.intervals import Estimate

COLOURS: Final = (
    "#3d8a4e",
    "#2f7fb5",
    "#9a5fb0",
    "#c8672f",
    "#b98a00",
    "#c2487a",
    "#2a9d9d",
    "#6a6fd0",
    "#8a6a4a",
    "#6b8e23",
    "#d05050",
)
GREY: Final = "#7d808b"
"""The colour of all further lines of a chart."""
LEVELS: Final = (0, 0.25, 0.5, 0.75, 1)


@dataclass(frozen=True)
class Chart:
    """Scores in [0, 1] of several methods in a row of columns, with a legend that switches methods on and off.

    Attributes:
        scores: name of a method -> its score in each column, and the interval of each if it is known.
        columns: names of the columns, from left to right.
        across: what the columns are.
        about: what the chart shows, for readers who do not see it.
        joined: whether lines join the scores, because the columns have an order.
        shown: the methods that are on at first; all if it is empty.
    """

    scores: Mapping[str, Sequence[Estimate]]
    columns: Sequence[str]
    across: str
    about: str
    joined: bool = False
    shown: Sequence[str] = ()

    @cached_property
    def colours(self) -> Mapping[str, str]:
        """The colour of each method: of those that are on at first, no two have the same; the others are grey."""
        return dict(zip(filter(self._is_on, self.scores), COLOURS, strict=False))

    def html(self) -> str:
        """The chart as a figure."""
        lines = "".join(map(self._line, self.scores)) if self.joined else ""
        levels = "".join(f'<span style="bottom: {100 * level:g}%">{level:g}</span>' for level in LEVELS)
        legend = "".join(
            f'<label style="--line: {self.colours.get(name, GREY)}">'
            f'<input type="checkbox"{" checked" if self._is_on(name) else ""} '
            f'value="{escape(name)}"><i></i> {escape(name)}</label>'
            for name in self.scores
        )
        columns = "".join(map(self._column, range(len(self.columns))))
        return (
            f'<figure class="chart" aria-label="{escape(self.about)}"><div class="plot">'
            f'<span class="axis up" aria-hidden="true">Mean score</span>'
            f'<div class="levels" aria-hidden="true">{levels}</div>'
            f'<svg viewBox="0 0 100 100" preserveAspectRatio="none" aria-hidden="true">{lines}</svg>{columns}'
            f'<span class="axis across" aria-hidden="true">{escape(self.across)}</span></div>'
            f"<figcaption>{legend}</figcaption></figure>"
        )

    def _is_on(self, name: str) -> bool:
        return not self.shown or name in self.shown

    def _marks(self, name: str) -> str:
        off = "" if self._is_on(name) else ' class="off"'
        return f'{off} data-line="{escape(name)}" style="--line: {self.colours.get(name, GREY)}'

    def _x(self, column: int) -> float:
        """Per cent of the width. Columns of dots have a margin for the dots on their sides."""
        count = len(self.columns)
        return 100 * column / (count - 1) if self.joined else 100 * (column + 0.5) / count

    def _line(self, name: str) -> str:
        points = " ".join(
            f"{self._x(i):.2f},{100 - 100 * score.value:.1f}" for i, score in enumerate(self.scores[name])
        )
        return f'<g{self._marks(name)}"><polyline points="{points}"/></g>'

    def _column(self, column: int) -> str:
        """A column: its name below, its dots and intervals, and the list of scores."""
        name = escape(self.columns[column])
        known = [line for line, scores in self.scores.items() if not math.isnan(scores[column].value)]
        alike = {is_on: [line for line in known if self._is_on(line) == is_on] for is_on in (True, False)}
        dots = "".join(self._dot(line, column, alike[self._is_on(line)]) for line in known)
        ordered = sorted(known, key=lambda line: -self.scores[line][column].value)
        listed = "".join(
            f'<span{self._marks(line)}">{escape(line)} <b>{text(self.scores[line][column])}</b></span>'
            for line in ordered
        )
        side = "left" if self._x(column) > 50 else "right"
        return (
            f'<button class="column {side}" style="left: {self._x(column):.2f}%">{dots}<small>{name}</small>'
            f'<span class="figures"><strong>{name}</strong>{listed}</span></button>'
        )

    def _dot(self, line: str, column: int, others: Sequence[str]) -> str:
        """A dot and its interval. Without lines, the dots of a column are next to each other."""
        score = self.scores[line][column]
        place = (others.index(line) + 0.5) / len(others) - 0.5
        shift = "" if self.joined else f"; --shift: {place:.3f}"
        marks = self._marks(line) + shift
        dot = f'<i{marks}; bottom: {100 * score.value:.1f}%"></i>'
        if math.isnan(score.low):
            return dot
        height = f"bottom: {100 * score.low:.1f}%; height: {100 * (score.high - score.low):.1f}%"
        return f'<u{marks}; {height}"></u>{dot}'


def text(score: Estimate) -> str:
    """A score with its interval."""
    interval = "" if math.isnan(score.low) else f" [{score.low:.2f}, {score.high:.2f}]"
    return f"{score.value:.2f}{interval}".replace("-0.00", "0.00")
