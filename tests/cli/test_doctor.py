"""`magical-mj doctor`: which OpenGL backend works here, and what to do where none does."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import mujoco
import pytest

from magical_mj.cli.doctor import OWN, optional
from magical_mj.rendering.backend import osmesa_works
from tests.helpers.commands import process


def test_doctor_finds_a_backend_and_names_a_wrong_setting() -> None:
    result = process("doctor", DISPLAY="", MUJOCO_GL="glfw")
    assert result.returncode == 1
    assert mujoco.__version__ in result.stdout
    assert "works" in result.stdout
    assert "MUJOCO_GL=egl" in result.stdout


def test_every_extra_for_users_is_listed() -> None:
    project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
    packages = {
        re.split(r"[\[<>=;]", package)[0]: extra
        for extra, requirements in project["optional-dependencies"].items()
        if extra not in OWN
        for package in requirements
        if not package.startswith("magical-mj")
    }
    listed = optional()
    assert packages.keys() == listed.keys()
    assert (listed["torch"], listed["scipy"], listed["distributed"]) == ("il", "eval", "dask")


@pytest.mark.skipif(osmesa_works(), reason="OSMesa can draw without a driver")
def test_doctor_without_opengl_says_what_to_do() -> None:
    result = process("doctor", DISPLAY="", __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent")
    assert result.returncode == 1
    assert "libegl1" in result.stdout
    assert "MUJOCO_GL is osmesa, which does not start" in " ".join(result.stdout.split())
