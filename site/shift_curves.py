"""Charts of scores over the strength of shifts, from the tables of docs/shifts.md."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from charts import chart

SHIFTS: Final = Path(__file__).parent.parent / "docs" / "shifts.md"
STRENGTHS: Final = tuple("012345")
TEMPLATE: Final = """# Curves over shifts

Scores of behavioural cloning, trained in the demo scene, under [shifts](shifts.md) of strength 0 to 5. Numbers of
episodes and findings: [What breaks behavioural cloning](shifts.md#what-breaks-behavioural-cloning).
`magical-mj evaluate AGENT --shifts all` makes such curves for your agent, with intervals.

{charts}
"""


def shift_curves() -> str:
    """The page in Markdown with HTML.

    Raises:
        SystemExit: if docs/shifts.md does not contain the tables.
    """
    tables: dict[str, dict[str, list[float]]] = {}
    for line in SHIFTS.read_text(encoding="utf-8").splitlines():
        name, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        if name.startswith("From ") and tuple(cells[: len(STRENGTHS)]) == STRENGTHS:
            tables[name] = {}
        elif tables and cells and cells[0][:1].isdigit() and len(cells) >= len(STRENGTHS):
            list(tables.values())[-1][name] = [float(cell) for cell in cells[: len(STRENGTHS)]]
    if not all(tables.values()) or not tables:
        raise SystemExit(f"{SHIFTS} contains no tables of scores over strengths, but the site makes charts from them")
    charts = [
        f"## {name}\n\n{chart(lines, STRENGTHS, f'{name}: scores by strength')}" for name, lines in tables.items()
    ]
    return TEMPLATE.format(charts="\n\n".join(charts))
