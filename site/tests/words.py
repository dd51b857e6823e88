"""Finds the text of every source page in the built page, in order: words.py. Markdown's own rules drop no sentence."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import Final

from markdown_it import MarkdownIt
from markdown_it.token import Token

ROOT: Final = Path(__file__).parents[2]
SOURCES: Final = ROOT / "out" / "site-sources"
BUILT: Final = ROOT / "out" / "site"
WORD: Final = re.compile(r"\w+")
SETTINGS: Final = re.compile(r"\A---\n.*?\n---\n", re.DOTALL)
"""What precedes the text of some pages: their settings for Sphinx."""
INLINE: Final = {"a", "abbr", "b", "code", "em", "i", "img", "small", "span", "strong", "sub", "sup", "u"}
"""The elements that do not separate words."""
SILENT: Final = {"script", "style", "template"}


class Words(HTMLParser):
    """Collects the words of HTML, with alternative texts, and one space between them."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self._parts: list[str] = []
        self._silent = 0
        self.feed(html)
        self.text = f" {' '.join(WORD.findall(''.join(self._parts)))} "

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Adds a space unless the element is within a line, and an alternative text."""
        self._silent += tag in SILENT
        self._parts += [] if tag in INLINE else [" "]
        self._parts += [f" {value or ''} " for name, value in attrs if name == "alt"]

    def handle_endtag(self, tag: str) -> None:
        """Adds a space unless the element is within a line."""
        self._silent -= tag in SILENT
        self._parts += [] if tag in INLINE else [" "]

    def handle_data(self, data: str) -> None:
        """Adds text that is shown."""
        self._parts += [] if self._silent else [data]


def blocks(text: str) -> Iterator[str]:
    """The words of each paragraph, heading, table cell, code block and piece of HTML of a page in Markdown."""
    for token in MarkdownIt("commonmark").enable("table").parse(SETTINGS.sub("", text)):
        is_directive = token.type == "fence" and token.info.startswith("{")
        if token.type == "inline":
            yield Words("".join(map(_html, token.children or []))).text
        elif token.content and not is_directive:
            yield Words(token.content if token.type == "html_block" else _escaped(token.content)).text


def _html(token: Token) -> str:
    if token.type == "html_inline":
        return token.content
    return " " if token.type in ("softbreak", "hardbreak") else _escaped(token.content)


def _escaped(text: str) -> str:
    return text.replace("&", "&amp;").replace("<", "&lt;")


def lost(page: Path) -> str | None:
    """The first block of a source page that its built page does not contain after the blocks before it."""
    own = ROOT / "docs" / page.name
    built = Words((BUILT / f"{page.stem}.html").read_text(encoding="utf-8")).text
    place = 0
    for block in blocks((own if own.exists() else page).read_text(encoding="utf-8")):
        found = built.find(block, place)
        if block.strip() and found < 0:
            return block.strip()
        place = max(place, found)
    return None


if __name__ == "__main__":
    pages = sorted(SOURCES.glob("*.md"))
    missing = {page.name: block for page in pages if (block := lost(page))}
    for name, block in missing.items():
        print(f"{name}: the built page lacks, or has elsewhere: {block[:300]}")
    print(f"{len(pages)} pages, {len(missing)} of them without all their text")
    sys.exit(bool(missing) or not pages)
