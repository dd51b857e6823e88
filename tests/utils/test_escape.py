"""Untrusted text: who reads a format gets the text back, and nothing that a terminal, page or spreadsheet obeys."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

from magical_mj.cli import main
from magical_mj.utils import escape
from tests.helpers.evaluations import example, write

HOSTILE = (
    "<img src=x onerror=alert(1)>",
    "[x](javascript:alert(1))",
    "[x]: javascript:alert(1)",
    "![x][y]",
    "# Official",
    "1. first",
    "- item",
    "**bold** _and_ `code` ~~gone~~",
    "a | b \\| c \\",
    "&lt;script&gt; &#60;",
    "=1+2",
    "@SUM(A1)",
    "-2+3",
)
MARKDOWN = MarkdownIt("commonmark").enable(["table", "strikethrough"])


def elements(text: str) -> dict[str, list[str]]:
    """The contents of Markdown by the kind of element."""
    contents: dict[str, list[str]] = {}
    for block in MARKDOWN.parse(text):
        for token in (block, *(block.children or ())):
            contents.setdefault(token.type, []).append(token.content)
    return contents


def test_markdown_is_read_as_the_text() -> None:
    for text in HOSTILE:
        read = elements(escape.markdown(text))
        assert read.keys() == {"paragraph_open", "inline", "text", "paragraph_close"}
        assert "".join(read["text"]) == text
        link = elements(escape.markdown_link(text, "file.mp4"))
        assert ("".join(link["text"]), link["link_open"]) == (text, [""])


def test_control_characters_are_shown() -> None:
    assert escape.terminal("a\x1b[2Jb\u202ec\nd") == "a\\x1b[2Jb\\u202ec\nd"
    assert escape.markdown("a\nb\x00") == "a b\\x00"
    assert escape.html("<b>\x07\ud800") == "&lt;b&gt;\\x07\\ud800"


def test_a_spreadsheet_gets_texts_and_numbers() -> None:
    given = ["=1+2", "+1", "-2.5", "@SUM", " =1", "-", "BC", "\t=1"]
    assert list(map(escape.csv, given)) == ["'=1+2", "+1", "-2.5", "'@SUM", "' =1", "'-", "BC", "'\t=1"]


def test_reports_hold_hostile_names_as_text(tmp_path: Path) -> None:
    """Of policies, presets and versions, which are printable, and in a failure, which may be anything."""
    rows = [
        replace(
            score, policy=name, preset="`[x](y)`", version="<b>", failure="\x1b[31m\n# No\n" if score.seed else None
        )
        for name in HOSTILE
        for score in example()[:4]
    ]
    write(tmp_path, rows)
    assert main(["report", str(tmp_path)]) == 0
    read = elements((tmp_path / "report" / "report.md").read_text())
    assert [read[name] for name in ("html_inline", "html_block", "s", "em") if name in read] == []
    assert len(read["heading_open"]) == 4
    assert len(read["link_open"]) == 4
    assert len(read["image"]) == 2
    assert all(any(name in text for text in read["text"]) for name in HOSTILE)
    with (tmp_path / "report" / "variants.csv").open() as file:
        assert {row[0] for row in csv.reader(file)} >= {"'=1+2", "'@SUM(A1)", "'-2+3", HOSTILE[0]}


def test_the_console_obeys_no_text(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Names of folders may hold anything."""
    folder = write(tmp_path / "a\x1b[2J", example())
    assert main(["report", str(folder)]) == 0
    assert main(["report", str(tmp_path / "none\x1b[2J")]) == 2
    out, error = capsys.readouterr()
    assert "\x1b" not in out + error
    assert "a\\x1b[2J/report/report.md" in out
    assert "none\\x1b[2J does not exist" in error
