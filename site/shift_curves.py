"""Scores over the strength of shifts, as charts made from the tables of docs/shift-curves.md."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from charts import Chart

from magical_mj.evaluation.reports.intervals import Estimate

PAGE: Final = Path(__file__).parent.parent / "docs" / "shift-curves.md"
STRENGTHS: Final = tuple("012345")


def shift_curves() -> str:
    """The end of the page in Markdown with HTML in it.

    Raises:
        SystemExit: if docs/shift-curves.md has no such tables any more.
    """
    tables: dict[str, dict[str, list[float]]] = {}
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if name.startswith("From ") and tuple(cells[: len(STRENGTHS)]) == STRENGTHS:
            tables[name] = {}
        elif tables and cells and cells[0][:1].isdigit() and len(cells) >= len(STRENGTHS):
            list(tables.values())[-1][name] = [float(cell) for cell in cells[: len(STRENGTHS)]]
    if not all(tables.values()) or not tables:
        raise SystemExit(f"{PAGE} no longer has tables of scores over strengths for the site's curves")
    charts = []
    for name, lines in tables.items():
        scores = {line: [Estimate(value) for value in values] for line, values in lines.items()}
        about = f"{name}: scores by strength"
        charts.append(f"## {name}\n\n{Chart(scores, STRENGTHS, 'Strength of the shift', about, joined=True).html()}")
    return "\n\n".join(["", *charts, ""])
