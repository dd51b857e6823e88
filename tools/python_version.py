"""Has an installation under a Python that is too old fail at once, and say why.

Old versions of pip look at `requires-python` only after they have tried all versions of all dependencies.
"""

from __future__ import annotations

import sys
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

OLDEST = (3, 11)


class PythonVersion(MetadataHookInterface):
    """Checks the running Python when the package's metadata is asked for, which is the first thing pip does."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Changes nothing in the metadata."""
        del metadata
        if sys.version_info < OLDEST:
            present, needed = (".".join(map(str, version)) for version in (sys.version_info[:2], OLDEST))
            raise RuntimeError(f"magical_mj needs Python {needed} or newer, and this is Python {present}")
