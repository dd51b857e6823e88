"""The private names of dm_control that this package relies on: all of them in one file, and all of them there."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from dm_control import composer, mjcf
from dm_control.mjcf import physics as mjcf_physics

PACKAGE = Path(__file__).parents[2] / "magical_mj"
INTERNALS = PACKAGE / "environment" / "internals.py"


class Empty(composer.Task):
    """The least that composer takes for a task."""

    root_entity = composer.Arena()

    def get_reward(self, physics: object) -> float:
        return 0.0


def private_names(tree: ast.AST) -> Iterator[str]:
    """Attributes, methods and imports that begin with one underscore."""
    for node in ast.walk(tree):
        names = [getattr(node, "attr", ""), getattr(node, "name", "")]
        if isinstance(node, ast.ImportFrom):
            names += [alias.name for alias in node.names]
        yield from (name for name in names if isinstance(name, str) and name.startswith("_") and name[:2] != "__")


@pytest.fixture(scope="module")
def stock() -> dict[str, set[str]]:
    """What dm_control's own objects have, by the name of the class of ours that extends theirs."""
    environment = composer.Environment(Empty())
    return {
        "UnindexedPhysics": {*dir(mjcf.Physics.from_xml_string("<mujoco/>")), *dir(mjcf_physics)},
        "OpenEnvironment": set(dir(environment)),
    }


@pytest.mark.parametrize("name", ["UnindexedPhysics", "OpenEnvironment"])
def test_dm_control_still_has_every_private_name_that_we_use(name: str, stock: dict[str, set[str]]) -> None:
    classes = {node.name: node for node in ast.parse(INTERNALS.read_text()).body if isinstance(node, ast.ClassDef)}
    assert classes.keys() == stock.keys()
    used = set(private_names(classes[name]))
    assert len(used) > 3
    gone = used - stock[name]
    assert not gone, f"this version of dm_control has no {', '.join(sorted(gone))} any more: see {INTERNALS}"


def test_no_other_module_uses_them(stock: dict[str, set[str]]) -> None:
    """Where a module has classes that extend composer's: names of its own must be different, too."""
    found = []
    for module in sorted(set(PACKAGE.rglob("*.py")) - {INTERNALS}):
        tree = ast.parse(module.read_text())
        bases = {ast.unparse(base) for node in ast.walk(tree) if isinstance(node, ast.ClassDef) for base in node.bases}
        names = set[str]()
        if bases & {"OpenEnvironment", "UnindexedPhysics", "composer.Environment", "mjcf.Physics"}:
            names |= set(private_names(tree)) & (stock["UnindexedPhysics"] | stock["OpenEnvironment"])
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dm_control"):
                names |= {alias.name for alias in node.names if alias.name.startswith("_")}
        found += [f"{module.relative_to(PACKAGE)}: {name}" for name in sorted(names)]
    assert not found
