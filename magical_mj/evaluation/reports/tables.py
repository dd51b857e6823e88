"""Tables as text: Markdown, CSV, and LaTeX with booktabs."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from magical_mj.evaluation.reports.results import Results
from magical_mj.tasks.registry import ENVIRONMENTS, VARIANTS, in_order
from magical_mj.utils import escape

if TYPE_CHECKING:
    import pandas as pd

NONE = "–"  # noqa: RUF001 a dash is meant
PLUS_MINUS = "±"
DAGGER = "†"
PAGE_ROWS = 40

Rows = tuple[tuple[str, ...], ...]
Group = tuple[str, Rows]


@dataclass(frozen=True)
class Table:
    """A table of strings.

    Attributes:
        name: the name of its files, without suffix.
        caption: what it shows.
        header: the columns' names.
        groups: pairs of heading and rows; a heading of "" for a table without headings.
        notes: sentences below the table.
    """

    name: str
    caption: str
    header: tuple[str, ...]
    groups: tuple[Group, ...]
    notes: tuple[str, ...] = ()


def markdown(table: Table) -> str:
    """The table in Markdown; headings become rows in bold."""
    lines = [tuple(map(escape.markdown, table.header)), ("---", *["---:"] * (len(table.header) - 1))]
    for heading, rows in table.groups:
        if heading:
            lines.append((f"**{escape.markdown(heading)}**", *[""] * (len(table.header) - 1)))
        lines += [tuple(map(escape.markdown, cells)) for cells in rows]
    body = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    notes = "\n".join(f"- {escape.markdown(note)}" for note in table.notes)
    return "\n\n".join(filter(None, (f"{escape.markdown(table.caption)}.", body, notes))) + "\n"


def latex(table: Table) -> str:
    r"""The table in LaTeX: floats of at most a page each, which need only ``\usepackage{booktabs}``."""
    pages: list[list[Group]] = [[]]
    for group in table.groups:
        if pages[-1] and sum(len(rows) for _, rows in [*pages[-1], group]) > PAGE_ROWS:
            pages.append([])
        pages[-1].append(group)
    floats = [_float(table, page, number, number == len(pages)) for number, page in enumerate(pages, start=1)]
    return "\n".join(floats)


def _float(table: Table, groups: Sequence[Group], number: int, last: bool) -> str:
    columns = len(table.header)
    lines = [
        r"\begin{table}",
        r"  \centering",
        r"  \scriptsize",
        r"  \setlength{\tabcolsep}{3pt}",
        rf"  \caption{{{escape.latex(table.caption)}{'' if number == 1 else ' (continued)'}.}}",
        rf"  \label{{tab:{table.name}{'' if number == 1 else f'-{number}'}}}",
        r"  \smallskip",
        r"  \makebox[\linewidth][c]{%",  # a wide table stands out on both sides
        rf"  \begin{{tabular}}{{l{'c' * (columns - 1)}}}",
        r"    \toprule",
        f"    {_latex_row(table.header)}",
    ]
    for heading, rows in groups:
        lines.append(r"    \midrule")
        if heading:
            lines.append(rf"    \multicolumn{{{columns}}}{{l}}{{\textbf{{{escape.latex(heading)}}}}} \\")
        lines += [f"    {_latex_row(row)}" for row in rows]
    lines += [r"    \bottomrule", r"  \end{tabular}}"]
    if last:
        lines += [rf"  \par\smallskip\parbox{{\linewidth}}{{{escape.latex(note)}}}" for note in table.notes]
    return "\n".join([*lines, r"\end{table}"]) + "\n"


def csv(frame: pd.DataFrame) -> str:
    """The frame as CSV with a header; numbers have four decimals."""
    texts = {name: column.map(escape.csv) for name, column in frame.select_dtypes(["object", "string"]).items()}
    return frame.assign(**texts).to_csv(index=False, float_format="%.4f", lineterminator="\n")


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(escape.latex(cell.replace(f" {PLUS_MINUS} ", PLUS_MINUS)) for cell in cells) + r" \\"


def result_tables(results: Results) -> list[Table]:
    """The paper's Table 1, the interquartile means, and the table of all environments."""
    spread = Table(
        "variants",
        f"Mean score over {results.counted}, ± standard deviation of the run means over tasks and runs",
        ("Method", *VARIANTS),
        (("", _rows(results, results.variants, _mean_and_std)),),
        results.notes,
    )
    robust = Table(
        "interquartile",
        f"Interquartile mean of the run means over {results.counted}, with its 95 % interval (stratified bootstrap)",
        ("Method", *VARIANTS),
        (("", _iqm_rows(results)),),
    )
    groups = []
    for task in in_order(results.environments["task"]):
        found = results.environments[results.environments["task"] == task]
        groups.append((task, _rows(results, found, _mean_and_std, task)))
    every = Table(
        "environments",
        "Mean score in each environment, ± standard deviation of the run means",
        ("Method", *VARIANTS),
        tuple(groups),
    )
    return [spread, robust, every]


def _rows(results: Results, frame: pd.DataFrame, text: Callable[[Any], str], task: str | None = None) -> Rows:
    rows = []
    for policy in results.policies:
        mine = {row.variant: row for row in frame[frame["policy"] == policy].itertuples()}
        if mine:
            name = marked(policy, next(iter(mine.values())).published)
            rows.append(
                (name, *(text(mine[variant]) if variant in mine else _gap(task, variant) for variant in VARIANTS))
            )
    return tuple(rows)


def _iqm_rows(results: Results) -> Rows:
    """Two rows for each method: the interquartile means, and below them their intervals."""
    mine = results.variants[~results.variants["published"]]
    means = _rows(results, mine, lambda row: f"{row.iqm:.2f} {share(row)}".rstrip())
    intervals = _rows(results, mine, lambda row: f"[{row.iqm_low:.2f}, {row.iqm_high:.2f}]".replace("[nan, nan]", NONE))
    return tuple(row for mean, interval in zip(means, intervals, strict=True) for row in (mean, ("", *interval[1:])))


def marked(policy: str, published: bool) -> str:
    """The method's name, with a dagger if its results are published ones."""
    return policy + DAGGER if published else policy


def _gap(task: str | None, variant: str) -> str:
    return "missing" if (task, variant) in ENVIRONMENTS else NONE


def _mean_and_std(row: Any) -> str:
    spread = "" if math.isnan(row.std) else f" {PLUS_MINUS} {row.std:.2f}"
    return f"{row.mean:.2f}{spread} {share(row)}".rstrip()


def share(row: Any) -> str:
    """The number of the variant's tasks in a mean, such as "(1/8)"; empty if it covers all of them."""
    if not getattr(row, "missing", ""):
        return ""
    return f"({row.tasks}/{row.tasks + row.missing.count(',') + 1})"
