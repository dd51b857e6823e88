"""Runs the notebooks of examples/notebooks and saves their outputs. `make notebooks`.

python tools/notebooks.py [NAME ...]
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import nbformat  # pyright: ignore[reportMissingImports]
from nbclient import NotebookClient  # pyright: ignore[reportMissingImports]

ROOT: Final = Path(__file__).parent.parent
FOLDER: Final = ROOT / "examples" / "notebooks"
LONGEST: Final = 240  # seconds for a cell
MOST_BYTES: Final = 200_000


def run(path: Path) -> float:
    """Runs one notebook in an empty folder and writes it with its outputs. Returns the duration in seconds."""
    start = time.monotonic()
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(
            notebook, timeout=LONGEST, record_timing=False, resources={"metadata": {"path": folder}}
        ).execute()
    for cell in notebook.cells:
        cell.metadata = {}
        for output in cell.get("outputs", []):
            output.get("data", {}).pop("image/jpeg", None)  # the same picture is there as PNG
    notebook.metadata.pop("language_info", None)  # it contains the version of Python
    text = f"{nbformat.writes(notebook, indent=1)}\n"
    if len(text) > MOST_BYTES:
        sys.exit(f"{path.name} has {len(text):,} bytes with its outputs; the limit is {MOST_BYTES:,}")
    path.write_text(text)
    return time.monotonic() - start


def main() -> None:
    """Runs the named notebooks, by default all, in the order of their numbers."""
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    names = sys.argv[1:] or sorted(path.name for path in FOLDER.glob("*.ipynb"))
    for name in names:
        print(f"{name}: {run(FOLDER / name):.0f} s", flush=True)


if __name__ == "__main__":
    main()
