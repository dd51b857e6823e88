"""The package is built as docs/architecture.md says: kept by walking every import, late ones included."""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "magical_mj"
PAGE = (ROOT / "docs" / "architecture.md").read_text()
MODULES = sorted(PACKAGE.rglob("*.py"))

LAYERS = {part: int(layer) for layer, part in re.findall(r"^\| (\d) \| `(\w+)` \|", PAGE, re.MULTILINE)}
FACADE = "__init__"
"""``magical_mj/__init__.py`` gathers the public names, so only what is above it may use it."""

PURE = {"numpy", "shapely", *sys.stdlib_module_names}
STRANGERS = ("variants", "assets", "cli", "baselines", "integrations")
"""Parts that nobody on the same layer may import from."""
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
        """The part of the package that is imported from."""
        return self.path[1] if len(self.path) > 1 and self.path[1] in LAYERS else FACADE


def name(module: Path) -> str:
    return module.relative_to(PACKAGE).as_posix()


def part_of(module: Path) -> str:
    return module.relative_to(PACKAGE).parts[0].removesuffix(".py")


KNOW_NO_TASK = ("variants", "assets")
BELOW_GYMNASIUM = [
    module for module in MODULES if part_of(module) == "variants" or LAYERS[part_of(module)] < LAYERS["gym_env"]
]


def imports(module: Path) -> Iterator[Import]:
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            yield from (Import(tuple(alias.name.split(".")), node.lineno) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = tuple((node.module or "").split("."))
            yield from (Import((*base, alias.name), node.lineno) for alias in node.names)


def circle(graph: dict[str, set[str]]) -> list[str]:
    """Names that depend on each other in a circle; none if there is no circle."""
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        return error.args[1]
    return []


def test_the_page_names_every_part_and_no_other() -> None:
    assert set(LAYERS) == {part_of(module) for module in MODULES}


@pytest.mark.parametrize("module", MODULES, ids=name)
def test_modules_import_only_from_their_layer_and_below(module: Path) -> None:
    part = part_of(module)
    for found in imports(module):
        if not found.inner or found.part == part:
            continue
        where = f"{name(module)}:{found.line} imports {'.'.join(found.path)}"
        assert LAYERS[found.part] <= LAYERS[part], where
        assert LAYERS[found.part] < LAYERS[part] or found.part not in STRANGERS or part == "__main__", where


def test_parts_do_not_depend_on_each_other_in_a_circle() -> None:
    parts: dict[str, set[str]] = {}
    for module in MODULES:
        used = {found.part for found in imports(module) if found.inner}
        parts.setdefault(part_of(module), set()).update(used - {part_of(module)})
    assert not circle(parts)


def test_modules_do_not_depend_on_each_other_in_a_circle() -> None:
    names = {".".join((PACKAGE.name, *module.relative_to(PACKAGE).with_suffix("").parts)): module for module in MODULES}
    names = {path.removesuffix(".__init__"): module for path, module in names.items()}
    graph: dict[str, set[str]] = {}
    for path, module in names.items():
        used = [".".join(found.path) for found in imports(module) if found.inner]
        graph[path] = {other if other in names else other.rpartition(".")[0] for other in used} - {path}
    assert not circle(graph)
    assert circle({"a": {"b"}, "b": {"a"}})


@pytest.mark.parametrize("module", BELOW_GYMNASIUM, ids=name)
def test_the_simulator_and_gymnasium_stay_on_their_layers(module: Path) -> None:
    part = part_of(module)
    outer = [found for found in imports(module) if not found.inner]
    if LAYERS[part] <= LAYERS["tasks"] or part == "variants":
        wrong = [found for found in outer if found.path[0] not in PURE]
    else:
        wrong = [found for found in outer if found.path[0] == "gymnasium"]
    assert not wrong


@pytest.mark.parametrize("module", [module for module in MODULES if part_of(module) in KNOW_NO_TASK], ids=name)
def test_variants_and_assets_know_no_task(module: Path) -> None:
    """Variants know what tasks consist of, and assets not even that."""
    known = {"variants": ("spec",), "assets": ()}[part_of(module)]
    used = [found for found in imports(module) if found.inner and found.part == "tasks"]
    assert not [found for found in used if found.path[2] not in known]
    assert part_of(module) == "variants" or not [found for found in imports(module) if found.part == "variants"]


@pytest.mark.parametrize("module", MODULES, ids=name)
def test_modules_are_short_and_say_what_they_are(module: Path) -> None:
    text = module.read_text()
    assert ast.get_docstring(ast.parse(text)), f"{name(module)} has no docstring"
    assert len(text.splitlines()) <= MAX_LINES, f"{name(module)} is too long: split it"
