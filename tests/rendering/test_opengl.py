"""OpenGL and processes: exits, forks, missing drivers, and the user's choice of backend."""

from __future__ import annotations

import _ctypes
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from magical_mj.rendering.backend import osmesa_works

FIRST_FRAME = """
import magical_mj
env = magical_mj.load("MoveToRegion", seed=0)
env.reset()
"""
DAEMON = """
import threading, time
work = lambda: (magical_mj.load("MoveToRegion").reset(), started.set(), time.sleep(60))
started = threading.Event()
threading.Thread(target=work, daemon=True).start()
assert started.wait(60)
"""
BARE = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
NO_DRIVER = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MuJoCo has one backend")


def python(program: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], env=BARE | variables, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize(
    ("ending", "code", "last_line"),
    [
        ("", 0, ""),
        ("raise SystemExit(3)", 3, ""),
        ("raise KeyError('expected')", 1, "KeyError: 'expected'"),
        (DAEMON, 0, ""),
    ],
    ids=["end", "exit", "exception", "daemon"],
)
def test_nothing_is_said_at_exit(ending: str, code: int, last_line: str) -> None:
    result = python(f"{FIRST_FRAME}{ending}")
    assert (result.returncode, result.stdout) == (code, "")
    assert "ignored" not in result.stderr
    assert (result.stderr.strip().splitlines() or [""])[-1] == last_line


@ON_LINUX
def test_drawing_after_a_fork_is_refused_and_spawning_suggested() -> None:
    result = python(
        f"{FIRST_FRAME}"
        "import multiprocessing\n"
        "worker = multiprocessing.get_context('fork').Process(target=env.step, args=(0,))\n"
        "worker.start(); worker.join(60)\n"
        "raise SystemExit(worker.exitcode)"
    )
    assert result.returncode == 1
    assert "RenderingError" in result.stderr
    assert "'spawn' or 'forkserver'" in result.stderr


@ON_LINUX
@pytest.mark.parametrize("view", ["ego", "scene"])
@pytest.mark.parametrize("closing", ["", "env.close()"])
def test_a_fork_after_drawing_ends_in_silence(view: str, closing: str) -> None:
    """The child has nothing of OpenGL's to free; it used to wait for ever at its exit. The parent draws on."""
    result = python(
        f"{FIRST_FRAME}"
        f"env.render({view!r}, 64)\n"
        "import os, sys\n"
        "child = os.fork()\n"
        "if child == 0:\n"
        f"    {closing}\n"
        "    sys.exit(7)\n"
        "status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])\n"
        f"env.render({view!r}, 64)\n"
        "sys.exit(status)"
    )
    assert (result.returncode, result.stdout) == (7, "")
    assert "ignored" not in result.stderr


@pytest.mark.parametrize("ours_first", [True, False])
def test_mujocos_renderer_beside_ours_is_silent_at_exit_if_closed(ours_first: bool) -> None:
    """If it is not closed, its own clean-up complains, in a program without us too."""
    theirs = (
        "renderer = mujoco.Renderer(env.physics.model.ptr, 64, 64)\n"
        "renderer.update_scene(env.physics.data.ptr)\n"
        "renderer.render()\n"
    )
    ours = "env.render('ego', 64)\n"
    result = python(
        "import magical_mj, mujoco\nenv = magical_mj.load('MoveToRegion', observations=())\nenv.reset()\n"
        + (ours + theirs if ours_first else theirs + ours)
        + "renderer.render()\nrenderer.close()\n"
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@ON_LINUX
@pytest.mark.skipif(osmesa_works(), reason="OSMesa can draw without a driver")
class TestWithoutOpenGL:
    """No driver: EGL finds no device, and OSMesa is not installed."""

    def test_states_work_and_pictures_say_what_is_missing(self) -> None:
        program = (
            "import magical_mj\n"
            "env = magical_mj.load('FindDupe', observations=('state',))\n"
            "env.reset(); env.step(1)\n"
            "print('state')\n"
            "env.render()"
        )
        result = python(program, **NO_DRIVER)
        assert result.stdout == "state\n"
        assert result.returncode == 1
        self.check_message(result.stderr)

    @pytest.mark.parametrize("backend", ["egl", "osmesa"])
    def test_a_backend_that_was_asked_for_and_fails_is_named(self, backend: str) -> None:
        result = python("import magical_mj; magical_mj.load('FindDupe')", MUJOCO_GL=backend, **NO_DRIVER)
        assert result.returncode == 1
        self.check_message(result.stderr)
        assert f"MUJOCO_GL is {backend}" in result.stderr

    def check_message(self, error: str) -> None:
        """One error, which names the variable and the packages."""
        last = error.strip().splitlines()[-1]
        assert last.startswith("magical_mj.utils.errors.RenderingError: ")
        for word in ("MUJOCO_GL", "egl", "libegl1", "osmesa", "libosmesa6"):
            assert word in last


@ON_LINUX
@pytest.mark.parametrize("wanted", ["egl", "glfw", "disable", "off"])
def test_a_users_choice_of_backend_is_kept(wanted: str) -> None:
    result = python("import magical_mj, os; print(os.environ['MUJOCO_GL'])", MUJOCO_GL=wanted)
    assert result.stdout == f"{wanted}\n"


@pytest.mark.skipif(sys.platform != "linux", reason="asks the loader of Linux in which order it loads")
@pytest.mark.parametrize("backend", ["", "egl", "glfw"])
def test_tritons_library_is_loaded_before_any_driver(backend: str, tmp_path: Path) -> None:
    """Behind Mesa's LLVM, that of Triton ends the process; here another library has Triton's name."""
    library = tmp_path / "triton" / "_C" / "libtriton.so"
    library.parent.mkdir(parents=True)
    (tmp_path / "triton" / "__init__.py").touch()
    shutil.copy(_ctypes.__file__, library)
    program = (
        "import magical_mj\ntry: magical_mj.load('MoveToRegion', image_size=16).reset()\n"
        "except magical_mj.utils.errors.RenderingError: pass"
    )
    result = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"PYTHONPATH": str(tmp_path), "MUJOCO_GL": backend, "LD_DEBUG": "files"},
        capture_output=True,
        text=True,
        check=True,
    )
    loaded = re.findall(r"file=(?:\S*/)?(lib\w+)\S* \[0\];  generating link map", result.stderr)
    assert "libtriton" in loaded
    drivers = [place for place, name in enumerate(loaded) if name in ("libLLVM", "libgallium", "libEGL", "libGLX")]
    assert all(place > loaded.index("libtriton") for place in drivers)
    assert drivers or backend == "glfw"


def test_drawing_goes_with_triton() -> None:
    pytest.importorskip("triton")
    program = "import magical_mj; magical_mj.load('MoveToRegion', image_size=16).reset(); import triton; print('well')"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).stdout == b"well\n"
