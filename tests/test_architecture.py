"""Each floor of the house knows only the floors below it: kept by walking every import, late ones included.

| floor | what | may import |
|---|---|---|
| 0 | constants, errors, fields, scene, geometry, actions, protocol, files, extras | standard library, numpy, shapely |
| 1 | planning, tasks | floor 0; no simulator |
| 2 | variants; assets | floor 0; variants also the tasks' spec, and no simulator; neither knows the other |
| 3 | registry, environment, observations, rendering, export, parallel | 0-2, mujoco, dm_control |
| 4 | Gymnasium, episodes, agents, experts, demonstrations | 0-3, gymnasium |
| 5 | batched, evaluation, leaderboard, speed, web | 0-4 |
| 6 | cli | 0-5 |
| 7 | baselines | anything; nobody imports them: commands and loaders of policies are plug-ins, by their entry points |
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

PACKAGE = Path(__file__).parent.parent / "magical_mj"
MODULES = sorted(PACKAGE.rglob("*.py"))

FLOORS: dict[str, int] = {
    **dict.fromkeys(
        ["constants", "errors", "fields", "scene", "geometry", "actions", "protocol", "files", "extras"], 0
    ),
    **dict.fromkeys(["references", "_version"], 0),
    **dict.fromkeys(["planning", "tasks"], 1),
    **dict.fromkeys(["variants", "assets"], 2),
    **dict.fromkeys(["registry", "observations", "rendering", "export", "env_settings", "state"], 3),
    **dict.fromkeys(["environment", "scene_task", "simulation", "composer_internals", "composer_observables"], 3),
    **dict.fromkeys(["announced", "parallel"], 3),
    **dict.fromkeys(["episodes", "agents"], 4),
    **dict.fromkeys(["presets", "registration", "frames", "gym_env", "wrappers", "experts", "demos"], 4),
    **dict.fromkeys(["batched", "evaluation", "leaderboard", "speed", "web"], 5),
    **dict.fromkeys(["cli", "__main__"], 6),
    **dict.fromkeys(["baselines", "integrations"], 7),
}
FACADE = "__init__"
"""``magical_mj/__init__.py`` gathers the public names from floors 0 to 4, so only higher floors may use it."""

PURE = {"numpy", "shapely", *sys.stdlib_module_names}
MAX_LINES = 300


class Import(NamedTuple):
    """``magical_mj.tasks.spec`` as ("magical_mj", "tasks", "spec"), and the line it is imported in."""

    path: tuple[str, ...]
    line: int

    @property
    def inner(self) -> bool:
        return self.path[0] == "magical_mj"

    @property
    def part(self) -> str:
        """The part of the package that is imported."""
        return self.path[1] if len(self.path) > 1 and self.path[1] in FLOORS else FACADE


def name(module: Path) -> str:
    return module.relative_to(PACKAGE).as_posix()


def part_of(module: Path) -> str:
    return module.relative_to(PACKAGE).parts[0].removesuffix(".py")


def imports(module: Path) -> Iterator[Import]:
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            yield from (Import(tuple(alias.name.split(".")), node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = tuple((node.module or "").split("."))
            yield from (Import((*base, alias.name), node.lineno) for alias in node.names)


@pytest.mark.parametrize("module", MODULES, ids=name)
def test_every_module_has_a_floor(module: Path) -> None:
    part = part_of(module)
    assert part == FACADE or part in FLOORS, f"{part} is new: give it a floor in {Path(__file__).name}"


@pytest.mark.parametrize("module", [module for module in MODULES if part_of(module) != FACADE], ids=name)
def test_modules_import_only_from_the_floors_below(module: Path) -> None:
    part = part_of(module)
    for found in imports(module):
        if not found.inner or found.part == part:
            continue
        where = f"{name(module)}:{found.line} imports {'.'.join(found.path)}"
        if found.part == FACADE:
            assert FLOORS[part] > FLOORS["gym_env"], where
        elif found.part in ("variants", "assets", "cli", "baselines"):  # neighbours that must not know each other
            assert FLOORS[found.part] < FLOORS[part] or part == "__main__", where
        else:
            assert FLOORS[found.part] <= FLOORS[part], where


@pytest.mark.parametrize("module", [module for module in MODULES if part_of(module) != FACADE], ids=name)
def test_the_simulator_and_gymnasium_stay_on_their_floors(module: Path) -> None:
    part = part_of(module)
    for found in imports(module):
        where = f"{name(module)}:{found.line} imports {'.'.join(found.path)}"
        if found.inner:
            continue
        if FLOORS[part] <= FLOORS["tasks"] or part == "variants":
            assert found.path[0] in PURE, where
        elif FLOORS[part] < FLOORS["gym_env"]:
            assert found.path[0] != "gymnasium", where


@pytest.mark.parametrize("module", MODULES, ids=name)
def test_variants_and_assets_know_no_task(module: Path) -> None:
    for found in imports(module):
        where = f"{name(module)}:{found.line} imports {'.'.join(found.path)}"
        if part_of(module) == "variants" and found.inner and found.part == "tasks":
            assert found.path[2] == "spec", where
        if part_of(module) == "assets" and found.inner:
            assert found.part not in ("tasks", "variants"), where


@pytest.mark.parametrize("module", MODULES, ids=name)
def test_modules_are_short_and_say_what_they_are(module: Path) -> None:
    text = module.read_text()
    assert ast.get_docstring(ast.parse(text)), f"{name(module)} has no docstring"
    assert len(text.splitlines()) <= MAX_LINES, f"{name(module)} is too long: split it"
