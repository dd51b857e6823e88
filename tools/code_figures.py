"""Prints how large and how plain the code is: `python tools/code_figures.py`.

Lines that check are those of `if` and `match` statements that only raise errors, and of `raise` statements elsewhere.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).parent.parent
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


def complex_functions() -> int:
    """The number of functions whose cyclomatic complexity is above `COMPLEX`."""
    limit = f"lint.mccabe.max-complexity={COMPLEX}"
    command = [sys.executable, "-m", "ruff", "check", "magical_mj", "--select", "C901", "--config", limit]
    found = subprocess.run([*command, "--output-format", "json"], cwd=ROOT, capture_output=True, text=True, check=False)
    return len(json.loads(found.stdout))


def main() -> None:
    """Prints the figures of the package and of the documentation."""
    sources = [path.read_text("utf-8") for path in sorted((ROOT / "magical_mj").rglob("*.py"))]
    trees = [ast.parse(source) for source in sources]
    lines = sum(len(source.splitlines()) for source in sources)
    checks = sum(len(set(checking(tree))) for tree in trees)
    imports = sum(len(set(importing(tree))) for tree in trees)
    drawing = ("backend", "opengl", "picture", "renderer")
    opengl = sum(len((ROOT / f"magical_mj/rendering/{name}.py").read_text("utf-8").splitlines()) for name in drawing)
    words = sum(len(path.read_text("utf-8").split()) for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    print(f"magical_mj: {lines:,} lines in {len(sources)} files")
    print(f"lines that check: {checks / lines:.1%}; that import: {imports / lines:.1%}")
    print(f"functions of a complexity above {COMPLEX}: {complex_functions()}")
    print(f"OpenGL, the choice of the renderer, and the 3-D view: {opengl} lines in {len(drawing)} files")
    print(f"README and docs: {words:,} words")


if __name__ == "__main__":
    main()
