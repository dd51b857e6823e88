"""How Sphinx makes the documentation; `site/docs.py` gathers its sources."""

from typing import Any

from magical_mj import __version__

project = "magical_mj"
author = "The magical_mj developers"
project_copyright = "The magical_mj developers"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["extra"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # README's sections start where their page says
autodoc_typehints = "description"
autodoc_member_order = "bysource"
default_role = "code"  # docstrings write `names` as Markdown does
html_theme = "furo"
html_title = "magical_mj"
html_logo = "logo.svg"
html_favicon = "logo.svg"
html_static_path = ["style"]
html_css_files = ["site.css"]
html_extra_path = ["extra"]
html_copy_source = False
html_show_sourcelink = False


def setup(app: Any) -> None:
    """Docstrings mean no emphasis by their asterisks."""

    def escape(*arguments: Any) -> None:
        lines: list[str] = arguments[-1]
        lines[:] = [line.replace("*", r"\*") for line in lines]

    app.connect("autodoc-process-docstring", escape)
