"""What is to be installed is said for the way in which this package was installed."""

from __future__ import annotations

import importlib.metadata
import json
import subprocess
import sys
from pathlib import Path

import pytest

from magical_mj.utils.extras import remedy

ORIGINS = [
    (None, 'pip install "magical-mj[web]"'),
    ({"url": "file:///a/b", "dir_info": {"editable": True}}, 'pip install -e "/a/b[web]"'),
    ({"url": "file:///a/b", "dir_info": {}}, 'pip install "magical-mj[web] @ file:///a/b"'),
    (
        {"url": "https://example.org/mj.git", "vcs_info": {"vcs": "git"}},
        'pip install "magical-mj[web] @ git+https://example.org/mj.git"',
    ),
    (
        {"url": "https://example.org/mj.whl", "archive_info": {}},
        'pip install "magical-mj[web] @ https://example.org/mj.whl"',
    ),
]


@pytest.mark.parametrize(("origin", "command"), ORIGINS)
def test_extras_come_from_where_the_package_came_from(
    origin: dict[str, object] | None, command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the metadata of an installed distribution, found before the real one."""
    info = tmp_path / "magical_mj-9.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: magical-mj\nVersion: 9\n")
    if origin is not None:
        (info / "direct_url.json").write_text(json.dumps(origin))
    monkeypatch.syspath_prepend(tmp_path)
    assert importlib.metadata.version("magical-mj") == "9"
    assert remedy("web") == command


def test_a_checkout_that_was_never_installed_names_itself() -> None:
    """Seen by a Python without any installed packages."""
    root = Path(__file__).parents[2]
    start = f"import sys; sys.path.insert(0, {str(root)!r}); from magical_mj.utils.extras import remedy"
    command = [sys.executable, "-I", "-S", "-c", f"{start}; print(remedy('web'))"]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    assert run.stdout == f'pip install -e "{root}[web]"\n'
