"""Which tests were skipped, why, and where each runs.

    python -m tools.skips out/tests.xml    (written by make test)

Fails if a reason is unknown: it must name what is missing, and `PLACES` where such tests run.
"""

from __future__ import annotations

import re
import sys
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Final

PLACES: Final[Mapping[str, str]] = {
    r"make integrations-test": "this command; in CI each week (weekly.yml), some in turn (.ci/run)",
    r"dm_control does not install": "Python 3.11 and 3.12 with MuJoCo 3, in CI (ci.yml)",
    r"is installed$": "without that library, in CI (.ci/run)",
    r"'(mujoco\.mjx|warp|mujoco_warp|triton|numba_cuda)'|numba-cuda|MuJoCo Warp": "an environment with that package",
    r"could not import": "with the development packages, in CI (.ci/run)",
    r"Xvfb|xdotool|make is not installed": "where that program is installed, in CI (.ci/run)",
    r"OSMesa can draw": "machines without OSMesa",
    r"Linux|/proc|permissions|C libraries|one backend": "Linux, in CI (.ci/run)",
    r"IPv6": "machines with IPv6",
    r"not part of the package|sdist has no|engine is not installed": "a checkout with those files or packages",
}
"""Pattern in the reason of a skip -> where such tests run. The first that fits counts."""


def place_of(reason: str) -> str:
    """Where tests run that were skipped for this reason. Empty if it is not known."""
    return next((place for pattern, place in PLACES.items() if re.search(pattern, reason)), "")


def skips(report: Path) -> Counter[tuple[str, str]]:
    """The number of skipped tests by file and reason, in pytest's report. A skipped file counts once."""
    found = Counter[tuple[str, str]]()
    for case in ET.parse(report).iter("testcase"):  # noqa: S314 - written by our own tests
        for skipped in case.iter("skipped"):
            file = (case.get("classname") or case.get("name") or "").split(".Test")[0]
            text = re.search(r"Skipped: (.*?)['\"]\)", skipped.text or "")  # of a whole file
            found[file, text[1] if text else skipped.get("message") or ""] += 1
    return found


def main() -> None:
    """Prints a line for each file and reason."""
    unknown = list[str]()
    for (file, reason), number in sorted(skips(Path(sys.argv[1])).items()):
        place = place_of(reason)
        print(f"{number:4} {file}: {reason}; runs: {place or '?'}")
        unknown += [] if place else [reason]
    if unknown:
        sys.exit(f"tools/skips.py does not know where these run: {'; '.join(unknown)}")


if __name__ == "__main__":
    main()
