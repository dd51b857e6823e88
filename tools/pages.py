"""Pages with tables between markers, which commands write."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def filled(text: str, tables: Mapping[str, str], command: str = "make docs") -> str:
    """A page's text with up-to-date tables, which the command writes."""
    for name, body in tables.items():
        start, end = f"<!-- {name}: written by {command} -->", f"<!-- end of {name} -->"
        text, count = re.subn(f"{start}.*?{end}", f"{start}\n{body}\n{end}", text, flags=re.DOTALL)
        if count != 1:
            raise ValueError(f"the page needs exactly one pair of markers {start} and {end}")
    return text


def number(value: float) -> str:
    """A score with two decimals; empty if it is NaN."""
    return "" if value != value else f"{round(value, 2) + 0.0:.2f}"  # 0.00 instead of -0.00
