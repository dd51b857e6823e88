"""The scenes of an environment as JSON data for the page, with an expert's actions, demonstrations and models."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from magical_mj import demos
from magical_mj.policies.interface import letters_of
from magical_mj.tasks.registry import sample_scene
from magical_mj.web.catalogue import scene_data

EXPERT: Final = Path(__file__).parent / "expert.json"
"""Task-Variant -> an expert's actions in seeds 0, 1, ..., as letters. ``tools/experts.py`` writes it."""
SCENES: Final = 20
"""The number of scenes that the page offers of each environment; of Demo there is only one."""
DEMONSTRATIONS: Final = 5
"""The number of a task's shipped demonstrations that the page can show."""
_BETWEEN_ELEMENTS: Final = re.compile(r"(?<=>)(?=\s*<)")


def environment_scenes(task: str, variant: str) -> dict[str, Any]:
    """The page's data of an environment: its first scenes (of Demo, the only one), as JSON data."""
    shipped = demos.load(task)[:DEMONSTRATIONS] if variant == "Demo" else []
    demonstrations = [letters_of(demo.actions) for demo in shipped]
    expert: list[str] = demonstrations[:1] or json.loads(EXPERT.read_text(encoding="utf-8"))[f"{task}-{variant}"]
    seeds = range(1 if variant == "Demo" else SCENES)
    return {
        "demonstrations": demonstrations,
        "scenes": [
            {"seed": seed, "expert": actions, "scene": scene_data(sample_scene(task, variant, seed))}
            for seed, actions in zip(seeds, expert, strict=True)
        ],
    }


def with_models(data: dict[str, Any], models: Sequence[str]) -> dict[str, Any]:
    """The same data with a model of each scene, compressed to a quarter of the size or less.

    Models have most of their XML elements in common. So each model is stored as a list of indices into a list of
    elements, whose texts make up the model.
    """
    numbers: dict[str, int] = {}
    scenes = [
        {**scene, "mjcf": [numbers.setdefault(element, len(numbers)) for element in _BETWEEN_ELEMENTS.split(model)]}
        for scene, model in zip(data["scenes"], models, strict=True)
    ]
    return {**data, "scenes": scenes, "elements": list(numbers)}
