"""The leaderboard as a page: self-contained HTML without external resources, and Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from importlib.resources import files as resources
from pathlib import Path
from typing import Final

from magical_mj.evaluation.reports.tables import Table, markdown
from magical_mj.leaderboard.charts import intervals, profiles
from magical_mj.leaderboard.sections import tables
from magical_mj.leaderboard.standings import Standing
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.escape import html

TITLE: Final = "MAGICAL on MuJoCo: leaderboard"
INTRODUCTION: Final = (
    "Each entry holds every episode of every run with its actions, and was checked by playing episodes again. "
    "Scores lie between 0 and 1. An agent learns from demonstrations of one scene (Demo) and is tested where poses, "
    "colours, shapes, numbers or dynamics are others."
)
HEADINGS: Final = {
    "scores": "Scores",
    "drops": "What breaks first",
    "improvement": "Who beats whom",
    "profiles": "How the scores are spread",
    "costs": "What it cost",
}
SHADED: Final = ("scores", "drops", "improvement", "profiles")
HTML: Final = "leaderboard.html"
MARKDOWN: Final = "leaderboard.md"
BEGINNINGS: Final = {
    HTML: f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>\n',
    MARKDOWN: f"# {TITLE}\n",
}
"""By which an earlier page is recognised, and may be replaced."""


def check_free(out: Path) -> None:
    """Raises an `EvaluationError` if somebody else's file in this folder has the name of a page."""
    for name, beginning in BEGINNINGS.items():
        path = out / name
        if path.exists() and not (path.is_file() and path.read_bytes().startswith(beginning.encode())):
            raise EvaluationError(f"{path} is not a page of an earlier leaderboard: move it, or choose another folder")


def write_pages(found: Sequence[Standing], out: Path) -> list[Path]:
    """Writes both pages into a folder, replacing earlier ones, and returns their paths.

    Raises:
        EvaluationError: if somebody else's file has the name of a page.
    """
    check_free(out)
    made = tables(found)
    pages = {HTML: _html(found, made), MARKDOWN: _markdown(made)}
    for name, text in pages.items():
        files.write(out / name, text, overwrite=True)
    return [out / name for name in pages]


def _markdown(made: Sequence[Table]) -> str:
    parts = [BEGINNINGS[MARKDOWN].strip(), INTRODUCTION]
    for table in made:
        parts += [f"## {HEADINGS[table.name]}", markdown(table).strip()]
    return "\n\n".join(parts) + "\n"


def _html(found: Sequence[Standing], made: Sequence[Table]) -> str:
    drawn = {"scores": intervals(found), "profiles": profiles(found)}
    sections = "\n".join(
        _section(table.name, HEADINGS[table.name], drawn.get(table.name, "") + _table(table)) for table in made
    )
    headings = {**HEADINGS, "entries": "Entries"}
    links = " ".join(f'<a href="#{name}">{heading}</a>' for name, heading in headings.items())
    style = (resources("magical_mj.leaderboard") / "style.css").read_text(encoding="utf-8")
    return (
        f"{BEGINNINGS[HTML]}"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>\n{style}</style></head>\n<body><header><h1>{TITLE}</h1><p>{INTRODUCTION}</p>\n"
        f"<nav>{links}</nav></header>\n<main>\n{sections}\n"
        f"{_section('entries', headings['entries'], ''.join(_cards(found)))}</main></body></html>\n"
    )


def _section(name: str, heading: str, content: str) -> str:
    return f'<section id="{name}"><h2>{heading}</h2>{content}</section>'


def _table(table: Table) -> str:
    head = "".join(f"<th>{html(name)}</th>" for name in table.header)
    body = ""
    for heading, rows in table.groups:
        if heading:
            body += f'<tr><th class="group" colspan="{len(table.header)}">{html(heading)}</th></tr>'
        for first, *cells in rows:
            shown = "".join(_cell(cell, table.name in SHADED) for cell in cells)
            body += f"<tr><th>{html(first)}</th>{shown}</tr>"
    notes = "".join(f"<li>{html(note)}</li>" for note in table.notes)
    caption = html(table.caption)
    return (
        f'<p class="caption">{caption}.</p><div class="wide" tabindex="0" role="region" aria-label="{caption}">'
        f"<table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div><ul>{notes}</ul>"
    )


def _cell(text: str, shaded: bool) -> str:
    """A table cell. Below a number stand its interval and its share of the environments; its shade shows its size."""
    figure = re.fullmatch(r"(-?\d\.\d\d)( \[[\d., -]+\])?( \(\d+/\d+\))?", text)
    if figure is None:
        return f"<td>{html(text)}</td>"
    share = round(60 * min(1.0, abs(float(figure[1])))) if shaded else 0
    below = "".join(f"<small>{part}</small>" for part in figure.groups()[1:] if part)
    return f'<td class="figure" style="--share: {share}%">{figure[1]}{below}</td>'


def _cards(found: Sequence[Standing]) -> Iterator[str]:
    for one in found:
        if one.entry is not None:
            entry, card = one.entry, one.entry.card
            links = " ".join(f'<a href="{html(link)}">{html(link)}</a>' for link in card["links"] or ())
            facts = {
                "by": card["authors"],
                "other data": card["demonstrations"]["other"],
                "runs": ", ".join(map(str, entry.runs)),
                "episodes": len(entry.episodes),
                "protocol": entry.protocol,
                "magical_mj": ", ".join(entry.versions["version"]),
                "MuJoCo": ", ".join(entry.versions["mujoco"]),
            }
            said = "".join(f"<dt>{name}</dt><dd>{html(fact)}</dd>" for name, fact in facts.items() if fact)
            text = html(card["description"] or "")
            yield f"<article><h3>{html(one.name)}</h3><p>{text} {links}</p><dl>{said}</dl></article>"
