"""The charts of the leaderboard: SVG whose colours come from the page's style sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from magical_mj.evaluation.reports.tables import DAGGER
from magical_mj.leaderboard.sections import label, share
from magical_mj.leaderboard.standings import OVERALL, THRESHOLDS, Standing
from magical_mj.utils.escape import html

WIDTH: Final = 910
NAMES: Final = 310
"""The width in pixels of the column with the methods' names."""
ROW: Final = 26
LEGEND: Final = 20
"""The height in pixels of a line of the profiles' legend."""
HEIGHT: Final = 320
"""Of the profiles."""
LETTER: Final = 6.3
"""The mean width of a letter in pixels."""
COLOURS: Final = 10
"""Different ones; see style.css."""


def intervals(found: Sequence[Standing]) -> str:
    """Each method's overall score as a dot, with its interval as a line."""
    height = ROW * (len(found) + 1)
    rows = _grid(height - ROW)
    for index, one in enumerate(found):
        score, y = one.scores[OVERALL], ROW * (index + 0.5)
        rows += _name(f"{label(one)} {share(one)}".strip(), NAMES - 10, y + 4)
        if not math.isnan(score.low):
            rows += f'<line class="{one.kind}" x1="{_x(score.low)}" x2="{_x(score.high)}" y1="{y}" y2="{y}"/>'
        rows += f'<circle class="{one.kind}" cx="{_x(score.value)}" cy="{y}" r="5"/>'
    return _svg(height, rows, "Interquartile means over all environments, with 95 % intervals")


def profiles(found: Sequence[Standing]) -> str:
    """The performance profile of each method with results in all environments; the published ones are dotted."""
    rows = _grid(HEIGHT - ROW)
    for tick in (0.0, 0.5, 1.0):
        y = (1 - tick) * (HEIGHT - ROW)
        rows += f'<text x="{WIDTH - 15}" y="{y + 4:.0f}">{tick:g}</text>'
    whole = [one for one in found if one.everywhere]
    names = [label(one) for one in whole if one.kind != "published"]
    for index, one in enumerate(whole):
        points = " ".join(
            f"{_x(x)},{(1 - y) * (HEIGHT - ROW):.1f}" for x, y in zip(THRESHOLDS, one.profile, strict=True)
        )
        line = _line(index) if one.kind != "published" else "published"
        rows += f'<polyline class="{line}" points="{points}"><title>{html(label(one))}</title></polyline>'
    lines = [*map(_line, range(len(names))), "published"]
    for index, (name, line) in enumerate(zip([*names, f"methods of the paper{DAGGER}"], lines, strict=True)):
        y = LEGEND * (index + 0.7)
        rows += _name(name, NAMES - 65, y)
        rows += f'<polyline class="{line}" points="{NAMES - 58},{y - 4:.0f} {NAMES - 28},{y - 4:.0f}"/>'
    height = max(HEIGHT, math.ceil(LEGEND * (len(lines) + 1)))
    return _svg(height, rows, "Share of environments and runs with a mean score of at least so much")


def _name(name: str, right: float, y: float) -> str:
    """A method's name, shortened if it is long, left of a place."""
    most = int(right / LETTER)
    short = name if len(name) <= most else f"{name[: most - 1]}…"
    whole = f"<title>{html(name)}</title>" if short != name else ""
    return f'<text x="{right}" y="{y:.0f}" text-anchor="end">{html(short)}{whole}</text>'


def _line(index: int) -> str:
    """The colour and the dashes of a method's line, as classes of the style sheet."""
    return f"c{index % COLOURS} d{index // COLOURS}"


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
    picture = f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{title}">{content}</svg>'
    return f'<div class="wide" tabindex="0" role="region" aria-label="Chart: {title}">{picture}</div>'
