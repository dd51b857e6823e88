"""`magical-mj doctor`: what can draw here, and what to do where OpenGL does not work."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
import tomllib
from pathlib import Path

import mujoco
import pytest

from magical_mj.cli.doctor import OWN, optional
from magical_mj.rendering.backend import osmesa_works
from tests.helpers.commands import process


def test_doctor_says_what_draws_and_names_a_wrong_setting() -> None:
    result = process("doctor", DISPLAY="", MUJOCO_GL="glfw", MAGICAL_MJ_RENDERER="software")
    assert result.returncode == 1
    assert mujoco.__version__ in result.stdout
    assert "Flat views are drawn by software (MAGICAL_MJ_RENDERER is software); the fastest here: " in result.stdout
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
    result = process("doctor", DISPLAY="", MUJOCO_GL="", __EGL_VENDOR_LIBRARY_FILENAMES="/nonexistent")
    assert result.returncode == 0
    assert "Flat views are drawn by software" in result.stdout
    assert "OpenGL, which draws the view `scene`" in result.stdout
    assert "libegl1" in result.stdout
    assert "MUJOCO_GL is osmesa, which does not start" in " ".join(result.stdout.split())


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="looks for processes in /proc")
def test_a_driver_that_hangs_ends_with_the_doctor_who_is_killed(tmp_path: Path) -> None:
    """The module stands for a driver; the process that tries it writes its number, and waits."""
    number = tmp_path / "number"
    hangs = f"import os, pathlib, time; pathlib.Path({str(number)!r}).write_text(str(os.getpid())); time.sleep(600)"
    (tmp_path / "glfw.py").write_text(hangs)
    paths = os.pathsep.join([str(tmp_path), *sys.path])
    doctor = subprocess.Popen([sys.executable, "-m", "magical_mj", "doctor"], env=os.environ | {"PYTHONPATH": paths})
    while not (number.exists() and number.read_text()):
        assert doctor.poll() is None
        time.sleep(0.1)
    doctor.kill()
    doctor.wait()
    driver, end = Path("/proc", number.read_text()), time.monotonic() + 60
    while driver.exists() and time.monotonic() < end:
        time.sleep(0.1)
    assert not driver.exists()
