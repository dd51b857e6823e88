"""Playing in a browser: the page, what it has to know of the benchmark, and a server that simulates for it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

PAGE: Final = Path(__file__).parent / "page"
"""The page's files, which need `catalogue.json` and `scenes/` beside them."""
