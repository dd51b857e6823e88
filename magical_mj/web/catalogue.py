"""The data that the page loads first: descriptions of the tasks, the environments, and the look of everything."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from inspect import cleandoc
from textwrap import dedent
from typing import Any, Literal

from magical_mj import demos
from magical_mj.scene import Scene
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import Pair, task_spec
from magical_mj.web.look import look

Simulation = Literal["browser", "server"]


def sections(task: str) -> dict[str, str]:
    """The docstring of a task's module by its headings, such as "Goal" and "Score"; its first line is "Summary"."""
    text = sys.modules[task_spec(task).score.__module__].__doc__ or ""
    first, *lines = cleandoc(text).splitlines()
    found: dict[str, list[str]] = {"Summary": [first.partition(": ")[2]]}
    heading = "Summary"
    for line in lines:
        if line and not line[0].isspace():
            heading = line
            found[heading] = []
        else:
            found[heading].append(line)
    return {name: dedent("\n".join(content)).strip() for name, content in found.items()}


def catalogue(environments: Sequence[Pair], simulation: Simulation) -> dict[str, Any]:
    """The data that the page needs before the first scene, as JSON data.

    Args:
        environments: the pairs (task, variant) that can be chosen.
        simulation: where the simulation runs; the browser has the scenes of a few seeds only.
    """
    tasks = list(dict.fromkeys(task for task, _ in environments))
    return {
        "protocol": PROTOCOL,
        "simulation": simulation,
        "look": look(),
        "tasks": {task: _task(task) for task in tasks},
        "environments": [{"task": task, "variant": variant} for task, variant in environments],
    }


def _task(task: str) -> dict[str, Any]:
    spec = task_spec(task)
    return {
        "summary": spec.summary,
        "goal": " ".join(sections(task)["Goal"].split()),
        "horizon": spec.horizon("paper"),
        "solved": scene_data(demos.load(task)[0].scenes()[-1]),
    }


def scene_data(scene: Scene) -> dict[str, Any]:
    """A scene as JSON data."""
    return json.loads(scene.to_json())
