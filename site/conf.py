"""Sphinx's configuration. `site/docs.py` collects the sources of the documentation."""

import os
import re
from pathlib import Path
from typing import Any

from docutils import nodes

from magical_mj import __version__

PAPER = "https://arxiv.org/abs/2011.00401"
REPOSITORY = os.environ.get("SITE_REPOSITORY", "").rstrip("/").removesuffix(".git")
"""The address of the repository. Empty: unknown, so no page links to it."""

project = "magical_mj"
author = "The magical_mj developers"
project_copyright = "The magical_mj developers"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
copybutton_prompt_text = "$ "
copybutton_exclude = ".linenos, .gp, .go"
exclude_patterns = ["extra"]
myst_disable_syntax = ["myst_line_comment"]  # a sentence may have a line that begins with %
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # the heading levels of README's sections depend on the page that includes them
autodoc_typehints = "description"
autodoc_member_order = "bysource"
default_role = "code"  # docstrings mark `names` as in Markdown
html_theme = "furo"
html_title = f"magical_mj {version}"
html_theme_options = {
    "footer_icons": [
        {"name": name, "url": url, "html": name, "class": ""}
        for name, url in {"Paper": PAPER, "Code": REPOSITORY}.items()
        if url
    ]
}
html_logo = "logo.svg"
html_favicon = "logo.svg"
html_static_path = ["style"]
html_search_scorer = str(Path(__file__).parent / "style/scorer.js")
html_css_files = ["site.css"]
html_js_files = [("site.js", {"defer": "defer"})]
html_baseurl = os.environ.get("SITE_URL", "")
html_extra_path = ["extra"]
html_copy_source = False
html_show_sourcelink = False


LENGTHS = {"long": 36, "phrase": 14}
"""Class -> the number of characters. Cells of words with more characters get the class, and so a minimum width."""
NUMBERS = re.compile(r"\[-?[\d.]+, -?[\d.]+\]|^[\d.]+( / [\d.]+)+$")
"""Intervals, and numbers with slashes: lines do not break in them."""


def setup(app: Any) -> None:
    """Escapes asterisks in docstrings, adds a description and a preview picture to each page, and marks long cells."""

    def escape(*arguments: Any) -> None:
        lines: list[str] = arguments[-1]
        lines[:] = [line.replace("*", r"\*") for line in lines]

    def about(_app: Any, _page: str, _template: str, context: dict[str, Any], _tree: Any) -> None:
        if 'name="description"' not in context.get("metatags", ""):
            title = re.sub("<[^>]*>", "", context.get("title", ""))
            words = f"{title}: magical_mj, the MAGICAL benchmark for robust imitation learning on MuJoCo."
            context["metatags"] = context.get("metatags", "") + f'<meta name="description" content="{words}">'
        if html_baseurl:
            address = f"{html_baseurl.rstrip('/')}/media/scene.png"
            context["metatags"] = context.get("metatags", "") + f'<meta property="og:image" content="{address}">'

    def mark_cells(_app: Any, tree: nodes.document, _page: str) -> None:
        for cell in tree.findall(nodes.entry):
            text = cell.astext()
            if re.search("[a-z]{3}", text):
                cell["classes"] += [name for name, length in LENGTHS.items() if len(text) > length][:1]
            for part in list(cell.findall(nodes.Text)):
                joined = NUMBERS.sub(lambda found: found[0].replace(" ", "\u00a0"), part)
                part.parent.replace(part, nodes.Text(joined))

    app.connect("doctree-resolved", mark_cells)
    app.connect("autodoc-process-docstring", escape)
    app.connect("html-page-context", about)
