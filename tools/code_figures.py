"""Prints how large and how plain the code is: `python -m tools.code_figures`.

Lines that check are those of `if` and `match` statements that only raise errors, and of `raise` statements elsewhere.
Records are data classes, named tuples and structs.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

from tests.test_architecture import ADDED
from tools.code_paths import main_paths

ROOT: Final = Path(__file__).parent.parent
LAZY_NAMES: Final = ROOT / "magical_mj/__init__.py"
"""The only module of the core that may name additions."""
COMPLEX: Final = 10


def checking(node: ast.AST) -> Iterator[int]:
    """The numbers of the lines that check something."""
    for child in ast.iter_child_nodes(node):
        only_raises = isinstance(child, ast.If) and not child.orelse and isinstance(child.body[-1], ast.Raise)
        if isinstance(child, ast.stmt) and (only_raises or isinstance(child, ast.Raise)):
            yield from range(child.lineno, (child.end_lineno or child.lineno) + 1)
        else:
            yield from checking(child)


def importing(tree: ast.AST) -> Iterator[int]:
    """The numbers of the lines of imports."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            yield from range(node.lineno, (node.end_lineno or node.lineno) + 1)


def is_addition(module: str) -> bool:
    """Whether the dotted name is that of something in `ADDED`."""
    package, _, inner = module.partition(".")
    return package == "magical_mj" and inner.partition(".")[0] in ADDED


def imported_additions(tree: ast.AST) -> Iterator[str]:
    """The dotted names of all that a module imports from additions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from filter(is_addition, names)


def records(tree: ast.AST) -> Iterator[int]:
    """The number of fields of each record that a module defines."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list, *node.bases]
            kinds = {ast.unparse(part).partition("(")[0].rpartition(".")[2] for part in parts}
            if kinds & {"dataclass", "NamedTuple", "Struct", "TypedDict"}:
                yield sum(isinstance(item, ast.AnnAssign) for item in node.body)


def lines_and_files(sources: Iterable[str]) -> str:
    """The number of lines and of files, in words."""
    sizes = [len(source.splitlines()) for source in sources]
    return f"{sum(sizes):,} lines in {len(sizes)} files"


def complex_functions() -> int:
    """The number of functions whose cyclomatic complexity is above `COMPLEX`."""
    limit = f"lint.mccabe.max-complexity={COMPLEX}"
    command = [sys.executable, "-m", "ruff", "check", "magical_mj", "--select", "C901", "--config", limit]
    found = subprocess.run([*command, "--output-format", "json"], cwd=ROOT, capture_output=True, text=True, check=False)
    return len(json.loads(found.stdout))


def main() -> None:
    """Prints the figures of the package and of the documentation, and the table of paths."""
    sources = {path: path.read_text("utf-8") for path in sorted((ROOT / "magical_mj").rglob("*.py"))}
    trees = {path: ast.parse(source) for path, source in sources.items()}
    below = {path: path.relative_to(ROOT / "magical_mj").parts[0].removesuffix(".py") for path in sources}
    core = {path for path in sources if below[path] not in ADDED}
    lines = sum(len(source.splitlines()) for source in sources.values())
    checks = sum(len(set(checking(tree))) for tree in trees.values())
    imports = sum(len(set(importing(tree))) for tree in trees.values())
    drawing = ("backend", "opengl", "picture", "renderer")
    opengl = [sources[ROOT / f"magical_mj/rendering/{name}.py"] for name in drawing]
    words = sum(len(path.read_text("utf-8").split()) for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    sizes = [size for tree in trees.values() for size in records(tree)]
    raises = sum(isinstance(node, ast.Raise) for tree in trees.values() for node in ast.walk(tree))
    print(f"magical_mj: {lines_and_files(sources.values())}")
    print(f"the core: {lines_and_files(sources[path] for path in core)}")
    names = [name for path in core - {LAZY_NAMES} for name in imported_additions(trees[path])]
    print(f"names that the core imports from additions: {len(names)}")
    print(f"lines that check: {checks / lines:.1%}; that import: {imports / lines:.1%}; raise statements: {raises}")
    print(f"records: {len(sizes)}; with at most 2 fields: {sum(size <= 2 for size in sizes)}")
    print(f"functions of a complexity above {COMPLEX}: {complex_functions()}")
    print(f"OpenGL, the choice of the renderer, and the 3-D view: {lines_and_files(opengl)}")
    print(f"README and docs: {words:,} words")
    print("\n| path | functions | files | depth |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, path in main_paths(Path(folder)):
            print(f"| {name} | {path.functions} | {path.files} | {path.depth} |", flush=True)


if __name__ == "__main__":
    main()
