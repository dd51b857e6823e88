"""Writes tables between their markers, from the registry and, on the page of results, from the entries in results/.

`make docs` runs this.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.envs.presets import PRESETS
from magical_mj.scene import constants as c
from magical_mj.shifts import SHIFTS
from magical_mj.tasks.registry import task_spec
from magical_mj.variants import VARIANTS, Axis
from tools import demonstration_sets, fresh_scenes, learner_settings, learnt_rewards, pretraining, scores, shift_curves
from tools.pages import ROOT, filled, table

AXES: Final[dict[Axis, str]] = {
    "jitter": f"all poses a little: ±{c.JITTER_POSITION} per axis (the arena is 2 wide), "
    f"±{math.degrees(c.JITTER_ANGLE):.0f}°",
    "layout": "all poses and the sizes of goal regions",
    "colour": "colours",
    "shape": "shapes",
    "count": "the number of blocks, in FixColour also of regions",
    "dynamics": "motor forces and the blocks' friction",
}


def tasks() -> str:
    """Each task, its goal and its horizon."""
    rows = []
    for task in TASKS:
        spec = task_spec(task)
        rows.append((f"**{task}**", _sentence(spec.summary), str(spec.horizon())))
    return table(("Task", "Goal", "Steps"), rows)


def variants() -> str:
    """Each variant, what it varies, and its tasks."""
    rows = []
    for variant, axes in VARIANTS.items():
        missing = [task for task in TASKS if (task, variant) not in ENVIRONMENTS]
        words = ", ".join(AXES[axis] for axis in axes)
        if variant == "All":
            words = "everything that can vary in the task, at once"
        rows.append((f"**{variant}**", _sentence(words or "nothing: the scene of the demonstrations"), _but(missing)))
    return table(("Variant", "Varies at each reset", "Tasks"), rows)


def presets() -> str:
    """Each preset of the Gymnasium ids and what it observes."""
    rows = [
        (f"`-{name}`" if name else '(the empty name, `""`)', _sentence(entry.summary))
        for name, entry in PRESETS.items()
    ]
    return table(("Preset", "Observation"), rows)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _but(missing: Sequence[str]) -> str:
    return f"all but {' and '.join(missing)}" if missing else "all"


def shifts() -> dict[str, str]:
    """The table of docs/shifts.md: what each one changes."""
    rows = [(f"`{name}`", _sentence(kind.summary)) for name, kind in SHIFTS.items()]
    return {"axes": table(("Shift", "What it changes"), rows)}


def readme() -> dict[str, str]:
    """The tables of README.md by name."""
    return {"tasks": tasks(), "variants": variants()}


PAGES: Final[Mapping[str, Callable[[], dict[str, str]]]] = {
    "README.md": readme,
    "docs/benchmark-card.md": scores.card,
    "docs/demonstration-sets.md": demonstration_sets.tables,
    "docs/environments.md": lambda: {"presets": presets()},
    "docs/learnt-rewards.md": learnt_rewards.tables,
    "docs/methods.md": lambda: {"settings": learner_settings.settings()},
    "docs/pretraining.md": pretraining.tables,
    "docs/results.md": scores.results,
    "docs/results-paper.md": scores.comparisons,
    "docs/shift-curves.md": shift_curves.tables,
    "docs/shifts.md": shifts,
    "methods/relational/README.md": fresh_scenes.tables,
}
"""Page -> the function that makes its tables."""


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for page, tables in PAGES.items():
        path = ROOT / page
        path.write_text(filled(path.read_text(encoding="utf-8"), tables()), encoding="utf-8")
