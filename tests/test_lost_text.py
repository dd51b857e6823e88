"""The site's parser of Markdown loses no text of the pages."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

pytest.importorskip("myst_parser")

from markdown_it import MarkdownIt
from markdown_it.renderer import RendererHTML
from myst_parser.config.main import MdParserConfig
from myst_parser.parsers.mdit import create_md_parser

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("docs/*.md"), *ROOT.glob("*.md")])


class Text(HTMLParser):
    """The text of an HTML page, with the alternative texts of pictures, without comments."""

    def __init__(self) -> None:
        super().__init__()
        self.parts: list[str] = []

    def handle_data(self, data: str) -> None:
        self.parts.append(data)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.parts.append(f" {dict(attrs).get('alt') or ''} ")


def settings() -> list[str]:
    """The syntax that site/conf.py disables."""
    found = re.search(r"^myst_disable_syntax = \[(.*)\]", (ROOT / "site/conf.py").read_text("utf-8"), re.MULTILINE)
    return re.findall(r'"(\w+)"', found[1]) if found else []


def words_of(html: str) -> list[str]:
    text = Text()
    text.feed(html)
    return re.findall(r"[\w%]+", "".join(text.parts))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_the_sites_parser_keeps_every_word_of_a_page_in_order(page: Path) -> None:
    source = page.read_text("utf-8")
    parser = create_md_parser(MdParserConfig(disable_syntax=settings()), RendererHTML)
    kept = iter(words_of(parser.render(source)))
    lost = [word for word in words_of(MarkdownIt().enable("table").render(source)) if word not in kept]
    assert not lost, f"from here on: {lost[:12]}"
