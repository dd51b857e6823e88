"""Scores over the strength of shifts, as charts made from the tables of docs/shifts.md."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from charts import Chart

from magical_mj.evaluation.reports.intervals import Estimate

SHIFTS: Final = Path(__file__).parent.parent / "docs" / "shifts.md"
STRENGTHS: Final = tuple("012345")
TEMPLATE: Final = """# Curves over shifts

What is left of the scores of behavioural cloning, trained in the demo scene, as [shifts](shifts.md) grow from strength
0 to 5. From how many episodes, and what follows:
[What breaks behavioural cloning](shifts.md#what-breaks-behavioural-cloning). `magical-mj evaluate AGENT --shifts all`
makes such curves of your agent, with intervals.

{charts}
"""


def shift_curves() -> str:
    """The page in Markdown with HTML in it.

    Raises:
        SystemExit: if docs/shifts.md has no such tables any more.
    """
    tables: dict[str, dict[str, list[float]]] = {}
    for line in SHIFTS.read_text(encoding="utf-8").splitlines():
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if name.startswith("From ") and tuple(cells[: len(STRENGTHS)]) == STRENGTHS:
            tables[name] = {}
        elif tables and cells and cells[0][:1].isdigit() and len(cells) >= len(STRENGTHS):
            list(tables.values())[-1][name] = [float(cell) for cell in cells[: len(STRENGTHS)]]
    if not all(tables.values()) or not tables:
        raise SystemExit(f"{SHIFTS} has no tables of scores over strengths any more, of which the site makes curves")
    charts = []
    for name, lines in tables.items():
        scores = {line: [Estimate(value) for value in values] for line, values in lines.items()}
        about = f"{name}: scores by strength"
        charts.append(f"## {name}\n\n{Chart(scores, STRENGTHS, 'Strength of the shift', about, joined=True).html()}")
    return TEMPLATE.format(charts="\n\n".join(charts))
