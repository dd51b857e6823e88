"""Playing in a browser: the page, the data about the benchmark that it needs, and a server that simulates for it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

PAGE: Final = Path(__file__).parent / "page"
"""The folder of the page's files; when served, they need `catalogue.json` and `scenes/` next to them."""
