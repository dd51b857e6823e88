"""Writes the tables of README.md, which follow from the registry, between their markers. `make docs` runs this."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj import constants as c
from magical_mj.presets import PRESETS
from magical_mj.registry import task_spec
from magical_mj.variants import VARIANTS, Axis

README: Final = Path(__file__).parent.parent / "README.md"
EXPERTS: Final = README.parent / "docs" / "experts.md"

AXES: Final[dict[Axis, str]] = {
    "jitter": f"small changes of every pose: ±{c.JITTER_POSITION} per axis, ±{c.JITTER_ANGLE:.3f} rad",
    "layout": "all poses, and the sizes of goal regions",
    "colour": "colours",
    "shape": "shapes",
    "count": "how many blocks, and in FixColour regions",
    "dynamics": "motor forces and the blocks' friction",
}


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def tasks() -> str:
    """Each task, its goal and its horizon."""
    rows = []
    for task in TASKS:
        spec = task_spec(task)
        variants = sum(name == task for name, _ in ENVIRONMENTS)
        rows.append((f"**{task}**", _sentence(spec.summary), str(spec.horizon()), str(variants)))
    return table(("Task", "Goal", "Steps", "Variants"), rows)


def variants() -> str:
    """Each variant, what is drawn anew, and which tasks lack it."""
    rows = []
    for variant, axes in VARIANTS.items():
        missing = [task for task in TASKS if (task, variant) not in ENVIRONMENTS]
        words = "; ".join(AXES[axis] for axis in axes)
        if variant == "All":
            words = "everything that can vary in the task, at once"
        rows.append((f"**{variant}**", _sentence(words or "nothing: the scene of the demonstrations"), _but(missing)))
    return table(("Variant", "Drawn anew at each reset", "Tasks"), rows)


def presets() -> str:
    """Each preset of the Gymnasium ids and what it observes."""
    rows = [(f"`-{name}`" if name else "none", _sentence(entry.summary)) for name, entry in PRESETS.items()]
    return table(("Preset", "Observation"), rows)


def experts() -> str:
    """The experts' mean scores, as `make demonstrations` found them."""
    return EXPERTS.read_text().split("\n\n")[2]


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _but(missing: Sequence[str]) -> str:
    return f"all but {' and '.join(missing)}" if missing else "all"


def filled(text: str) -> str:
    """The README's text with up-to-date tables."""
    for name, body in (("tasks", tasks()), ("variants", variants()), ("presets", presets()), ("experts", experts())):
        start, end = f"<!-- {name}: written by make docs -->", f"<!-- end of {name} -->"
        text, count = re.subn(f"{start}.*?{end}", f"{start}\n{body}\n{end}", text, flags=re.DOTALL)
        if count != 1:
            raise ValueError(f"README.md needs exactly one pair of markers {start} and {end}")
    return text


if __name__ == "__main__":
    README.write_text(filled(README.read_text()))
