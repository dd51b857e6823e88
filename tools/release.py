"""Checks that a version can be released: its number, changes and date agree in all files. `make release-check`.

    python tools/release.py [TAG]

Without a tag, it checks the version of the package.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent
MOST_BYTES: Final = {"*.whl": 5_000_000, "*.tar.gz": 6_000_000}
"""The limit of each file. Each has the demonstrations of all tasks and intents."""
UNPUBLISHED: Final = "unpublished"
"""What CHANGELOG.md has instead of a date before a release."""


def problems(tag: str | None) -> list[str]:
    """The problems that prevent a release, in sentences."""
    (version,) = re.findall(r'^__version__ = "(.*)"', (ROOT / "magical_mj" / "_version.py").read_text(), re.MULTILINE)
    heading = re.search(
        rf"^## \[{re.escape(version)}\] - (\S+)\n(.*?)(?=^## |\Z)", changelog(), re.MULTILINE | re.DOTALL
    )
    cited = dict(re.findall(r"^(version|date-released): (\S+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE))
    problems = []
    if tag is not None and tag != f"v{version}":
        problems.append(f"the tag is {tag}, but magical_mj/_version.py has {version}: it must be v{version}")
    if heading is None:
        problems.append(f'CHANGELOG.md has no line "## [{version}] - DATE"')
    elif not heading[2].strip():
        problems.append(f"CHANGELOG.md lists no changes for {version}")
    elif cited.get("date-released", UNPUBLISHED) != heading[1]:
        problems.append(f"CITATION.cff has the date {cited.get('date-released')}, but CHANGELOG.md {heading[1]}")
    elif tag is not None and heading[1] == UNPUBLISHED:
        problems.append("CHANGELOG.md says unpublished: write the date there and into CITATION.cff")
    if cited.get("version") != version:
        problems.append(f"CITATION.cff has the version {cited.get('version')}, but the package {version}")
    if tag is not None and re.search(
        r"^## \[Unreleased\]\n+[^#\s]|^## \[Unreleased\]\n+###", changelog(), re.MULTILINE
    ):
        problems.append(f"CHANGELOG.md has unreleased changes: move them to {version}")
    for pattern, most in MOST_BYTES.items():
        for path in (ROOT / "dist").glob(pattern):
            size = path.stat().st_size
            print(f"{path.name}: {size / 1e6:.1f} MB")
            if size > most:
                problems.append(f"{path.name} has {size:,} bytes; the limit is {most:,}")
    return problems


def changelog() -> str:
    """The text of CHANGELOG.md."""
    return (ROOT / "CHANGELOG.md").read_text()


if __name__ == "__main__":
    sys.exit("\n".join(problems(sys.argv[1] if len(sys.argv) > 1 else None)) or None)
