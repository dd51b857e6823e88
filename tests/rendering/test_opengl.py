"""OpenGL and processes: exits, forks, missing drivers, and the user's choice of backend."""

from __future__ import annotations

import _ctypes
import os
import re
import shutil
import subprocess
import sys
from ctypes.util import find_library
from pathlib import Path

import pytest

from tests.helpers.display import hidden_display

FIRST_FRAME = """
import magical_mj
env = magical_mj.Engine("MoveToRegion", seed=0)
env.render()
"""
DM_CONTROL = """
magical = magical_mj.load("FindDupe")
magical.reset()
magical.physics.render(64, 64, camera_id=0)
"""
DAEMON = """
import threading, time
work = lambda: (magical_mj.Engine("MoveToRegion").render(), started.set(), time.sleep(60))
started = threading.Event()
threading.Thread(target=work, daemon=True).start()
assert started.wait(60)
"""
BARE = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
NO_DRIVER = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="elsewhere MuJoCo has one backend")
FIRST_FRAMES = """
import threading
from concurrent.futures import ThreadPoolExecutor
import magical_mj
start, engines = threading.Barrier(8), [magical_mj.Engine("MatchRegions", seed=0, renderer="opengl") for _ in range(8)]
def draw(engine):
    start.wait()
    return int(engine.render("ego", 96).sum())
with ThreadPoolExecutor(8) as threads:
    (same,) = set(threads.map(draw, engines))
assert same
"""


def python(program: str, **variables: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", program], env=BARE | variables, capture_output=True, text=True, timeout=120, check=False
    )


@ON_LINUX
def test_opengl_is_named_before_the_first_picture() -> None:
    result = python("from magical_mj.rendering.opengl import opengl_name; print(opengl_name())")
    assert " / " in result.stdout, result.stderr


@pytest.mark.parametrize(
    ("ending", "code", "last_line"),
    [
        ("raise SystemExit(3)", 3, ""),
        ("raise KeyError('expected')", 1, "KeyError: 'expected'"),
        (DAEMON, 0, ""),
        (DM_CONTROL, 0, ""),
    ],
    ids=["exit", "exception", "daemon", "dm_control"],
)
def test_nothing_is_printed_at_exit(ending: str, code: int, last_line: str) -> None:
    if ending == DM_CONTROL:
        pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")
    result = python(f"{FIRST_FRAME}{ending}")
    assert (result.returncode, result.stdout) == (code, "")
    assert "ignored" not in result.stderr
    assert (result.stderr.strip().splitlines() or [""])[-1] == last_line


@ON_LINUX
def test_drawing_after_a_fork_is_refused_and_spawning_suggested() -> None:
    result = python(
        f"{FIRST_FRAME}"
        "import multiprocessing\n"
        "worker = multiprocessing.get_context('fork').Process(target=env.render)\n"
        "worker.start(); worker.join(60)\n"
        "raise SystemExit(worker.exitcode)"
    )
    assert result.returncode == 1
    assert "RenderingError" in result.stderr
    assert "'spawn' or 'forkserver'" in result.stderr


@ON_LINUX
@pytest.mark.parametrize(("view", "closing"), [("ego", "env.close()"), ("scene", "")])
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
    theirs = "renderer = mujoco.Renderer(env.model, 64, 64)\nrenderer.update_scene(env.data)\nrenderer.render()\n"
    ours = "env.render('ego', 64)\n"
    result = python(
        "import os; os.environ['MUJOCO_GL'] = 'egl'  # which mujoco's renderer looks at\n"
        "import magical_mj, mujoco\nenv = magical_mj.Engine('MoveToRegion')\n"
        + (ours + theirs if ours_first else theirs + ours)
        + "renderer.render()\nrenderer.close()\n"
    )
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")


@ON_LINUX
@pytest.mark.skipif(bool(find_library("OSMesa")), reason="OSMesa can draw without a driver")
class TestWithoutOpenGL:
    """No driver: EGL finds no device, and OSMesa is not installed."""

    def test_states_work_and_pictures_say_what_is_missing(self) -> None:
        program = (
            "import magical_mj\n"
            "env = magical_mj.Engine('FindDupe')\n"
            "env.step(1); env.state_vector()\n"
            "print('state')\n"
            "env.render()"
        )
        result = python(program, MAGICAL_MJ_RENDERER="opengl", **NO_DRIVER)
        assert result.stdout == "state\n"
        assert result.returncode == 1
        self.check_message(result.stderr)

    @pytest.mark.parametrize("backend", ["egl", "osmesa"])
    def test_a_backend_that_was_asked_for_and_fails_is_named(self, backend: str) -> None:
        program = "import magical_mj; magical_mj.Engine('FindDupe', renderer='opengl').render()"
        result = python(program, MUJOCO_GL=backend, **NO_DRIVER)
        assert result.returncode == 1
        self.check_message(result.stderr)
        assert f"MUJOCO_GL is {backend!r}" in result.stderr

    def check_message(self, error: str) -> None:
        """One error, which names the variable and the packages."""
        last = error.strip().splitlines()[-1]
        assert last.startswith("magical_mj.utils.errors.RenderingError: ")
        for word in ("MUJOCO_GL", "egl", "libegl1", "osmesa", "libosmesa6"):
            assert word in last


UNTOUCHED = """
import os
before = dict(os.environ)
import gymnasium, magical_mj, sys
assert dict(os.environ) == before
env = gymnasium.make("magical_mj/FindDupe-Demo-State-v0")
env.reset(seed=0); env.step(1)
magical_mj.export_mjcf(magical_mj.sample_scene("FindDupe", "Demo", 0), sys.argv[1] + "/scene.xml")
assert not [name for name in sys.modules if name.startswith(("OpenGL", "dm_control"))]
print(magical_mj.evaluate("noop", tasks="MoveToCorner", variants="Demo", episodes=1, jobs=1).score[0])
assert dict(os.environ) == before
"""


@ON_LINUX
@pytest.mark.parametrize(
    "variables",
    [
        {},
        {"PYOPENGL_PLATFORM": "glx", "MUJOCO_EGL_DEVICE_ID": "99"},
        {"PYOPENGL_PLATFORM": "osmesa", "MUJOCO_EGL_DEVICE_ID": "", **NO_DRIVER},
    ],
    ids=["usual", "glx", "osmesa"],
)
def test_episodes_without_pictures_need_no_opengl(variables: dict[str, str], tmp_path: Path) -> None:
    """Nor does an import, or an episode, change anything that other code of the process looks at."""
    result = subprocess.run(
        [sys.executable, "-c", UNTOUCHED, str(tmp_path)],
        env=BARE | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr


@ON_LINUX
@pytest.mark.parametrize("device", ["", "99"])
def test_a_wrong_device_is_named(device: str) -> None:
    result = python(FIRST_FRAME, MUJOCO_EGL_DEVICE_ID=device, MAGICAL_MJ_RENDERER="opengl")
    assert result.returncode == 1
    last = result.stderr.strip().splitlines()[-1]
    assert "RenderingError" in last
    assert f"MUJOCO_EGL_DEVICE_ID is {device!r}" in last


@ON_LINUX
def test_pyopengls_platform_does_not_matter() -> None:
    result = python(FIRST_FRAME, PYOPENGL_PLATFORM="osmesa")
    assert result.returncode == 0, result.stderr


VIEWER = """
import os, subprocess, threading, time
import magical_mj
from dm_control import viewer
env = magical_mj.load("MoveToRegion", seed=0, observations=("ego",), image_size=48)
seen = []
def policy(step):
    seen.append(step.observation["ego"].mean())
    if len(seen) == 3:
        os._exit(0 if min(seen) < 250 else 3)
    return 1
def press_space():  # it starts with a pause
    while True:
        time.sleep(0.5)
        subprocess.run("xdotool search --name Explorer key space", shell=True, capture_output=True)
threading.Thread(target=press_space, daemon=True).start()
viewer.launch(env, policy, width=160, height=120)
"""


@pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool (Debian: apt-get install)"
)
def test_dm_controls_viewer_shows_an_environment_that_draws(tmp_path: Path) -> None:
    """Its window has a context of GLX, ours is one of EGL: both draw in one thread, in turns."""
    pytest.importorskip("dm_control", reason="dm_control does not install with this Python or MuJoCo")
    with hidden_display(tmp_path) as display:
        result = python(VIEWER, DISPLAY=display.name)
    assert result.returncode == 0, result.stderr


@ON_LINUX
def test_first_frames_of_threads_come_one_after_another() -> None:
    result = python(FIRST_FRAMES)
    assert result.returncode == 0, result.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="asks the loader of Linux in which order it loads")
@pytest.mark.parametrize("backend", ["", "glfw"])
def test_tritons_library_is_loaded_before_any_driver(backend: str, tmp_path: Path) -> None:
    """Behind Mesa's LLVM, that of Triton ends the process; here another library has Triton's name."""
    library = tmp_path / "triton" / "libtriton.so"
    library.parent.mkdir()
    library.with_name("__init__.py").write_text(
        "import ctypes\nctypes.CDLL(__file__.replace('__init__.py', 'libtriton.so'))"
    )
    shutil.copy(_ctypes.__file__, library)
    program = (
        "import magical_mj\ntry: magical_mj.Engine('MoveToRegion').render()\n"
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
    drivers = [place for place, name in enumerate(loaded) if name in ("libLLVM", "libgallium")]
    assert all(place > loaded.index("libtriton") for place in drivers)
    assert drivers or backend == "glfw"


def test_drawing_goes_with_triton() -> None:
    pytest.importorskip("triton")
    program = "import magical_mj; magical_mj.Engine('MoveToRegion').render(); import triton; print('well')"
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, check=False).stdout == b"well\n"
