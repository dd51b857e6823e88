"""`magical-mj doctor`: which OpenGL backend works here, and what to do where none does."""

from __future__ import annotations

import os
import subprocess
import sys

import mujoco
import pytest

from magical_mj.cli import doctor, main


def test_doctor_finds_a_backend() -> None:
    command = [sys.executable, "-m", "magical_mj", "doctor"]
    result = subprocess.run(command, env=os.environ | {"MUJOCO_GL": ""}, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout
    assert "works" in result.stdout
    assert mujoco.__version__ in result.stdout


def test_doctor_without_opengl_says_what_to_do(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "_probe", lambda backend: {"error": "no such library"})
    assert main(["doctor"]) == 1
    assert "libegl1" in capsys.readouterr().out


def test_doctor_names_a_wrong_setting(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    works = {"renderer": "x", "first": 1.0, "typical": 1.0}
    monkeypatch.setattr(doctor, "_probe", lambda backend: works if backend == "egl" else {"error": "broken"})
    monkeypatch.setenv("MUJOCO_GL", "glfw")
    assert main(["doctor"]) == 1
    assert "MUJOCO_GL=egl" in capsys.readouterr().out
