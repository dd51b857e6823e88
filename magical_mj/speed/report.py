"""What was measured, as a table for people, as Markdown and as JSON."""

from __future__ import annotations

import os
import platform
import resource
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from magical_mj._version import __version__
from magical_mj.rendering.canvas import opengl_name
from magical_mj.speed.measure import Cause, Measurement

HEAD: Final = (
    "Environment",
    "Preset",
    "steps/s",
    "bare loop",
    "ratio",
    "reset, same structure",
    "reset, new structure",
)
NAMES: Final = 2  # columns that hold no numbers
CAUSES: Final[tuple[Cause, ...]] = ("rewritten", "compiled")
CPU_INFO: Final = Path("/proc/cpuinfo")


def rows(measurements: Sequence[Measurement]) -> list[tuple[str, ...]]:
    """Under `HEAD`, a row for each environment. Resets: median (95th percentile), in milliseconds."""
    return [
        (
            f"{made.task} {made.variant}",
            made.preset or "none",
            f"{made.rate:,.0f}",
            f"{made.bare_rate:,.0f}",
            f"{made.ratio:.0%}",
            *(_milliseconds(made, cause) for cause in CAUSES),
        )
        for made in measurements
    ]


def _milliseconds(made: Measurement, cause: Cause) -> str:
    median, most = (made.reset_quantile(cause, share) for share in (0.5, 0.95))
    return "" if median is None or most is None else f"{1000 * median:.1f} ms ({1000 * most:.1f})"


def markdown(measurements: Sequence[Measurement], yardstick: float | None) -> str:
    """The table, and under it the machine."""
    lines = [HEAD, [*["---"] * NAMES, *["---:"] * (len(HEAD) - NAMES)], *rows(measurements)]
    table = "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
    return f"{table}\n\n{summary(yardstick)}"


def summary(yardstick: float | None) -> str:
    """The machine, the memory of this process, and the yardstick."""
    facts = machine()
    text = f"{facts['cpu']}, {facts['cores']} cores; {facts['opengl']}; at most {memory():.0f} MB"
    return text if yardstick is None else f"{text}; gym-pusht's pixels: {yardstick:,.0f} steps/s"


def as_json(measurements: Sequence[Measurement], yardstick: float | None) -> dict[str, Any]:
    """Everything, times in seconds."""
    return {
        "machine": machine(),
        "memory_mb": memory(),
        "gym_pusht_rate": yardstick,
        "environments": [_facts(made) for made in measurements],
    }


def _facts(made: Measurement) -> Mapping[str, Any]:
    resets = {
        cause: {
            "count": len(made.resets[cause]),
            "median": made.reset_quantile(cause, 0.5),
            "p95": made.reset_quantile(cause, 0.95),
        }
        for cause in CAUSES
    }
    names = ("task", "variant", "preset", "steps", "rate", "bare_rate", "ratio")
    return {name: getattr(made, name) for name in names} | {"resets": resets}


def machine() -> dict[str, str | int]:
    """What it ran on."""
    cpu = platform.processor() or platform.machine()
    if CPU_INFO.exists():
        cpu = next((line.split(": ")[1] for line in CPU_INFO.read_text().splitlines() if "model name" in line), cpu)
    return {
        "cpu": cpu,
        "cores": os.cpu_count() or 1,
        "opengl": opengl_name(),
        "python": platform.python_version(),
        "magical_mj": __version__,
    }


def memory() -> float:
    """The most that this process has held, in MB."""
    unit = 2**20 if sys.platform == "darwin" else 2**10  # of what the system reports
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
