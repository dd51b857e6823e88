"""The folders of the package are its layers: kept by walking every import, late ones included."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

PACKAGE = Path(__file__).parents[1] / "magical_mj"
CORE = (
    "utils",
    "scene",
    "variants",
    "tasks",
    "assets",
    "rendering",
    "shifts",
    "engine",
    "envs",
    "experts",
    "policies",
    "demos",
    "evaluation",
    "cli",
)
"""The folders of the benchmark itself, lowest first: each imports only from those before it."""
ADDITIONS = ("exports", "xmagical", "batched", "intents", "leaderboard", "learners", "web", "integrations")
"""The other folders, which plug in by entry points. None is needed by the core."""
LAYERS = (*CORE, *ADDITIONS)
"""All folders, lowest first."""
PUBLIC = {
    "actions": "scene",
    "datasets": "exports",
    "observations": "scene",
    "protocol": "tasks",
    "wrappers": "envs",
}
"""The public modules, with the highest folder whose content each uses."""
ADDED = {*ADDITIONS, *(module for module, highest in PUBLIC.items() if highest in ADDITIONS)}
"""The folders and modules that are not part of the core."""
OUTSIDE = {"__init__": "evaluation", "__main__": "cli", "_version": "utils", **PUBLIC}
"""The modules beside the folders: the highest folder whose content each may use."""
PURE = {"numpy", "shapely", *sys.stdlib_module_names}
PURE_LAYERS = ("utils", "scene", "variants", "tasks")
PLAYED = {
    "question_files",
    "question_pictures",
    "by_set",
    "expert_data",
    "attribution",
    "explained",
    "evaluation",
    "given",
    "cli",
}
"""What needs the simulator in `intents`."""
OPTIONAL = {"cloudpickle", "distributed", "filelock", "msgspec"}
"""Libraries that `utils` wraps for all layers."""
TOP = {"leaderboard", "learners", "web", "integrations", "xmagical"}
"""Additions that no other folder imports."""
MODULES = sorted(PACKAGE.rglob("*.py"))


def name(module: Path) -> str:
    """The dotted name below the package."""
    return ".".join(module.relative_to(PACKAGE).with_suffix("").parts).removesuffix(".__init__")


def layer(module: str) -> str:
    return module.partition(".")[0]


def imports(module: Path) -> Iterator[str]:
    """The dotted names of everything that a module imports."""
    for node in ast.walk(ast.parse(module.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def inner(module: Path) -> Iterator[str]:
    """The modules of this package that a module imports."""
    names = {name(other) for other in MODULES}
    for path in imports(module):
        package, _, found = path.partition(".")
        if package == PACKAGE.name:
            yield found if found in names else found.rpartition(".")[0] or "__init__"


def test_every_folder_is_a_layer_and_the_other_files_are_public_modules() -> None:
    folders = {path.name for path in PACKAGE.iterdir() if any(path.glob("*.py"))}
    assert folders == set(LAYERS)
    assert {path.stem for path in PACKAGE.glob("*.py")} == set(OUTSIDE)


def test_layers_import_only_from_lower_ones() -> None:
    rank = {folder: index for index, folder in enumerate(LAYERS)}
    rank |= {module: rank[highest] for module, highest in OUTSIDE.items()}
    wrong = [
        f"{name(module)} imports {other}"
        for module in MODULES
        for other in inner(module)
        if layer(other) != layer(name(module)) and other != "_version"
        if name(module) != "__init__" or layer(other) not in (*PUBLIC, *ADDITIONS)  # its names of additions are lazy
        if rank[layer(other)] > rank[layer(name(module))] or layer(other) in TOP
    ]
    assert not wrong


def test_the_core_imports_no_addition() -> None:
    core = [module for module in MODULES if layer(name(module)) not in {*ADDED, "__init__"}]
    assert not [
        f"{name(module)} imports {other}" for module in core for other in inner(module) if layer(other) in ADDED
    ]


def test_modules_do_not_depend_on_each_other_in_a_circle() -> None:
    graph = {name(module): set(inner(module)) - {name(module)} for module in MODULES if name(module) != "__init__"}
    TopologicalSorter(graph).prepare()  # raises an error that names the circle


def test_tasks_and_variants_need_no_simulator_and_the_engine_neither_dm_control_nor_gymnasium() -> None:
    allowed = PURE | OPTIONAL
    for module in MODULES:
        used = {path.partition(".")[0] for path in imports(module)} - {PACKAGE.name}
        if layer(name(module)) in PURE_LAYERS or (
            layer(name(module)) == "intents" and not PLAYED & {*name(module).split(".")}
        ):
            assert used <= allowed, name(module)
        assert "dm_control" not in used or name(module).startswith("envs.composer"), name(module)
        if layer(name(module)) in LAYERS[: LAYERS.index("envs")]:
            assert not used & {"gymnasium", "dm_env"}, name(module)


def test_every_module_says_what_it_is() -> None:
    assert not [name(module) for module in MODULES if not ast.get_docstring(ast.parse(module.read_text()))]
