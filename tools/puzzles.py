"""Writes magical_mj/web/puzzles.json: the intents that people guess on the page, with demonstrations and rivals.

    python -m tools.puzzles        some minutes on one core; called again, it continues

These are the intents of the set dev. Each has two demonstrations by the expert, in two demo scenes, and the simplest
rivals that both leave, which tell a player what was reached instead.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from typing import Any, Final

from magical_mj.demos.recording import demonstrate
from magical_mj.intents import rivals
from magical_mj.intents.names import tasks_in
from magical_mj.intents.tasks import PREFIX, Task
from magical_mj.policies.interface import letters_of
from magical_mj.utils.errors import DemonstrationError
from magical_mj.web.puzzles import DEMONSTRATIONS, FILE

SET: Final = "dev"
BITS: Final = 22.0
"""The longest rivals."""
RIVALS: Final = 20


def puzzle(task: Task) -> dict[str, Any] | None:
    """The demonstrations and the rivals of an intent; None if the expert cannot demonstrate it."""
    name = f"{PREFIX}{task}"
    try:
        shown = [demonstrate(name, "Demo", seed) for seed in range(DEMONSTRATIONS)]
    except DemonstrationError:
        return None
    others = [rival for rival in rivals(shown, BITS) if rival != task.intent]
    return {
        "task": name,
        "demonstrations": [letters_of(demo.actions.tolist()) for demo in shown],
        "rivals": [str(rival) for rival in others[:RIVALS]],
    }


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter).parse_args()
    known = {one["task"]: one for one in json.loads(FILE.read_text(encoding="utf-8"))} if FILE.exists() else {}
    for task in tasks_in(SET):
        shown = replace(task, demos=DEMONSTRATIONS)
        if f"{PREFIX}{shown}" not in known and (made := puzzle(shown)):
            known[made["task"]] = made
            FILE.write_text(json.dumps(list(known.values()), indent=0) + "\n", encoding="utf-8")
