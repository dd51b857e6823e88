"""A build hook: an installation under a Python that is too old fails at once, with an explanation.

Old versions of pip check `requires-python` only after they have tried all versions of all dependencies.
"""

from __future__ import annotations

import sys
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

OLDEST = (3, 11)


class PythonVersion(MetadataHookInterface):
    """Checks the running Python when pip requests the package's metadata, which is its first step."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Changes nothing in the metadata."""
        del metadata
        if sys.version_info < OLDEST:
            present, needed = (".".join(map(str, version)) for version in (sys.version_info[:2], OLDEST))
            raise RuntimeError(f"magical_mj needs Python {needed} or newer, but this is Python {present}")
