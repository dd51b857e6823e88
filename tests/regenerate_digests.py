"""Writes the golden digests of the evaluation scenes anew; run from the repository's root, on purpose only.

    python -m tests.regenerate_digests --because "blocks are placed before the robot now"

Scenes are versioned data: scores are comparable only where the scenes are the same. So a changed digest is
a change that users must hear of. The reason goes into the data file; put it into the changelog as well.
"""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path
from typing import Any, Final

from magical_mj.registry import ENVIRONMENTS, sample_scene

DATA: Final = Path(__file__).parent / "data" / "scene_digests.json"
SEEDS: Final = range(100)


def digest(task: str, variant: str) -> str:
    """One fingerprint of the scenes of seeds 0 to 99."""
    digests = "".join(sample_scene(task, variant, seed).digest() for seed in SEEDS)
    return hashlib.sha256(digests.encode()).hexdigest()


def golden() -> dict[str, Any]:
    """The data file: "digests" by "Task-Variant", and "changes", the reasons for every version of them."""
    return json.loads(DATA.read_text())


def main() -> None:
    """Write the file; without a reason, say how."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--because", required=True, help="why the scenes change, for the record")
    reason = parser.parse_args().because.strip()
    if not reason:
        parser.error("the reason is empty")
    old = golden() if DATA.exists() else {"changes": [], "digests": {}}
    new = {f"{task}-{variant}": digest(task, variant) for task, variant in ENVIRONMENTS}
    changed = [name for name in {**old["digests"], **new} if old["digests"].get(name) != new.get(name)]
    if not changed:
        parser.exit(message="nothing has changed, nothing was written\n")
    DATA.write_text(json.dumps({"changes": [*old["changes"], reason], "digests": new}, indent=1) + "\n")
    parser.exit(message=f"{len(changed)} of {len(new)} digests changed: {', '.join(changed)}\n")


if __name__ == "__main__":
    main()
