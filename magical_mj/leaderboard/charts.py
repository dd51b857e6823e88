"""The charts of the leaderboard: SVG whose colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape
from typing import Final

from magical_mj.leaderboard.sections import label, share
from magical_mj.leaderboard.standings import OVERALL, THRESHOLDS, Standing

WIDTH: Final = 860
NAMES: Final = 260
"""The width in pixels of the column with the methods' names."""
ROW: Final = 26
HEIGHT: Final = 320
"""Of the profiles."""
COLOURS: Final = 10
"""Different ones; see style.css."""


def intervals(found: Sequence[Standing]) -> str:
    """Each method's overall score as a dot, with its interval as a line."""
    height = ROW * (len(found) + 1)
    rows = _grid(height - ROW)
    for index, one in enumerate(found):
        score, y = one.scores[OVERALL], ROW * (index + 0.5)
        name = f"{label(one)} {share(one)}".strip()
        rows += f'<text x="{NAMES - 10}" y="{y + 4:.0f}" text-anchor="end">{escape(name)}</text>'
        if not math.isnan(score.low):
            rows += f'<line class="{one.kind}" x1="{_x(score.low)}" x2="{_x(score.high)}" y1="{y}" y2="{y}"/>'
        rows += f'<circle class="{one.kind}" cx="{_x(score.value)}" cy="{y}" r="5"/>'
    return _svg(height, rows, "Interquartile means over all environments, with 95 % intervals")


def profiles(found: Sequence[Standing]) -> str:
    """Each method's performance profile as a line; the published ones are grey and dotted."""
    rows = _grid(HEIGHT - ROW)
    for tick in (0.0, 0.5, 1.0):
        y = (1 - tick) * (HEIGHT - ROW)
        rows += f'<text x="{WIDTH - 15}" y="{y + 4:.0f}">{tick:g}</text>'
    for index, one in enumerate(found):
        points = " ".join(
            f"{_x(x)},{(1 - y) * (HEIGHT - ROW):.1f}" for x, y in zip(THRESHOLDS, one.profile, strict=True)
        )
        line = "published" if one.kind == "published" else f"c{index % COLOURS} d{index // COLOURS}"
        rows += f'<polyline class="{line}" points="{points}"><title>{escape(label(one))}</title></polyline>'
        y = ROW * 0.75 * (index + 0.7)
        rows += f'<text x="{NAMES - 65}" y="{y:.0f}" text-anchor="end">{escape(label(one))}</text>'
        rows += f'<polyline class="{line}" points="{NAMES - 58},{y - 4:.0f} {NAMES - 28},{y - 4:.0f}"/>'
    height = max(HEIGHT, math.ceil(ROW * 0.75 * (len(found) + 1)))
    return _svg(height, rows, "Share of environments and runs with a mean score of at least so much")


def _grid(height: float) -> str:
    lines = ""
    for tick in range(0, 11, 2):
        x = _x(tick / 10)
        lines += f'<line class="grid" x1="{x}" x2="{x}" y1="0" y2="{height}"/>'
        lines += f'<text x="{x}" y="{height + 16}" text-anchor="middle">{tick / 10:g}</text>'
    return lines


def _x(share: float) -> float:
    return round(NAMES + share * (WIDTH - NAMES - 20), 1)


def _svg(height: float, content: str, title: str) -> str:
    return f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{title}">{content}</svg>'
