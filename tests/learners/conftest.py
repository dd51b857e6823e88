"""The example package `magical_goals`, as if it were installed."""

import sys
import tomllib
from pathlib import Path

import pytest

PROJECT = Path(__file__).parents[2] / "examples" / "goals"
sys.path.insert(0, str(PROJECT))


@pytest.fixture(scope="session", autouse=True)
def installed(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Puts on the path what pip writes about the package's entry points."""
    about = tomllib.loads((PROJECT / "pyproject.toml").read_text("utf-8"))["project"]
    site = tmp_path_factory.mktemp("site")
    folder = site / "magical_goals-1.dist-info"
    folder.mkdir()
    (folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {about['name']}\nVersion: 1\n")
    lines = []
    for group, points in about["entry-points"].items():
        lines += [f"[{group}]", *(f"{name} = {value}" for name, value in points.items())]
    (folder / "entry_points.txt").write_text("\n".join(lines))
    sys.path.insert(0, str(site))
