"""Requirements are those that are imported; and what is to be installed is said for how this package was installed."""

from __future__ import annotations

import ast
import importlib.metadata
import json
import re
import sys
import tomllib
from pathlib import Path

import pytest

from magical_mj.utils.extras import MODULES, remedy

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
RENAMED = {"pillow": "PIL", "pygame-ce": "pygame", "warp-lang": "warp"}
"""Requirement -> the module that it installs, where they differ in more than a hyphen."""
INDIRECT = {
    "numba_cuda": "from numba import cuda",
    "onnxscript": "torch.onnx.export(",
    "tensorboard": "from torch.utils.tensorboard",
}
"""What another library imports -> the code that makes it do so."""
HOSTS = {"lerobot", "stable_worldmodel", "vla_eval"}
"""Programs that load this package as a plug-in: they choose their versions, and ours."""
FOR_FILES = {"stable_baselines3"}
"""What reads a file of a user's: the error without it has the command that installs it."""
TRANSITIVE = {"OpenGL"}
"""What MuJoCo requires to draw at all."""


def modules(requirements: list[str]) -> set[str]:
    """The modules of requirements, without extras of this package."""
    names = {re.split(r"[^\w-]", requirement)[0] for requirement in requirements} - {"magical-mj"}
    return {RENAMED.get(name, name.replace("-", "_")) for name in names}


def imported(folder: Path) -> set[str]:
    """The modules outside the standard library that the files in a folder import."""
    nodes = [node for path in folder.rglob("*.py") for node in ast.walk(ast.parse(path.read_text()))]
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module}
    return {name.partition(".")[0] for name in names} - sys.stdlib_module_names - {"magical_mj"}


def test_required_packages_are_exactly_those_that_are_imported() -> None:
    extras = {name: modules(listed) for name, listed in PROJECT["optional-dependencies"].items()}
    site, used = extras.pop("site"), imported(ROOT / "magical_mj")
    required = modules(PROJECT["dependencies"]).union(*extras.values())
    assert required - used == set(INDIRECT)
    assert used - required <= HOSTS | FOR_FILES | TRANSITIVE
    code = "".join(path.read_text() for path in (ROOT / "magical_mj").rglob("*.py"))
    assert [name for name, call in INDIRECT.items() if call not in code] == []
    assert [name for name in site - {"sphinx"} if f'"{name}"' not in (ROOT / "site" / "conf.py").read_text()] == []


def test_a_missing_extra_is_known_by_its_own_requirements() -> None:
    """Besides those of others that it includes, such as torch, which `gpu` has from `il`.

    Requirements of some platforms only, such as numba-cuda, are checked where they are used.
    """
    for name, listed in PROJECT["optional-dependencies"].items():
        if name in MODULES:
            everywhere = [requirement for requirement in listed if ";" not in requirement]
            assert modules(everywhere) <= set(MODULES[name]), name
            assert set(MODULES[name]) - modules(listed) <= {"h5py", "torch"}, name


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


def test_a_checkout_that_was_never_installed_names_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.utils.extras.distribution", lambda _: importlib.metadata.distribution("no-such"))
    assert remedy("web") == f'pip install -e "{ROOT}[web]"'
