"""Other code that draws in the same process: neither its pictures nor ours change, in whatever order both begin."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import magical_mj
from tests.helpers.display import hidden_display

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the drivers of Linux")
WITH_DISPLAY = pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb (Debian: apt-get install xvfb)")
BARE = {
    name: value
    for name, value in os.environ.items()
    if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM", "DISPLAY", "WAYLAND_DISPLAY")
}
EGL = {"MUJOCO_GL": "egl"}
OFFSCREEN = {"SDL_VIDEODRIVER": "offscreen", "PYOPENGL_PLATFORM": "egl"}  # pygame's contexts are EGL's

Run = Callable[..., None]

BEGIN = """
import gymnasium, mujoco, numpy as np
import magical_mj

MODEL = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom size='.1' rgba='1 0 0 1'/></worldbody></mujoco>"
)
DATA = mujoco.MjData(MODEL)
mujoco.mj_forward(MODEL, DATA)

class Ours:
    '''An environment drawn by OpenGL, beside the pictures of the same one drawn without.'''

    def __init__(self):
        self.env = gymnasium.make("magical_mj/FindDupe-TestAll-LoRes4E-v0", renderer="opengl")
        self.seen = [self.env.reset(seed=0)[0]]
        self.expected = np.load("pictures.npy")

    def check(self):
        newest = self.env.step(5 * len(self.seen) % 18)[0][..., -3:]
        share = (newest == self.expected[len(self.seen)]).mean()
        assert share > 0.995, f"step {len(self.seen)}: {share}"
        self.seen.append(newest)

    def check_that_it_moved(self):
        assert (self.seen[-1] != self.seen[-3]).any()
"""
END = """
for _ in range(6):
    theirs.check()
    ours.check()
ours.check_that_it_moved()
"""

MUJOCO = """
class Theirs:
    def __init__(self):
        self.renderer = mujoco.Renderer(MODEL, 96, 96)
        self.expected = None

    def check(self):
        self.renderer.update_scene(DATA)
        picture = self.renderer.render()
        self.expected = picture if self.expected is None else self.expected
        assert np.ptp(picture) > 100 and (picture == self.expected).all()
"""
DM_CONTROL = """
from dm_control import mujoco as dm

class Theirs:
    def __init__(self):
        self.physics = dm.Physics.from_xml_string("<mujoco><worldbody><geom size='.1'/></worldbody></mujoco>")
        self.expected = self.physics.render(96, 96)

    def check(self):
        picture = self.physics.render(96, 96)
        assert np.ptp(picture) > 100 and (picture == self.expected).all()
"""
WINDOW = """
from OpenGL import GL

class Theirs:
    '''Paints a window with a colour that changes, and relies on its context staying current.'''

    def __init__(self):
        self.frames = 0
        self.open()

    def check(self):
        self.frames += 1
        GL.glClearColor(self.frames / 10, 0.5, 0, 1)
        GL.glClear(GL.GL_COLOR_BUFFER_BIT)
        pixel = GL.glReadPixels(5, 5, 1, 1, GL.GL_RGB, GL.GL_UNSIGNED_BYTE)
        assert list(pixel) == [round(255 * self.frames / 10), 128, 0], list(pixel)
        self.show()
"""
GLFW = f"""{WINDOW}
import glfw

def open_window(self):
    assert glfw.init()
    self.window = glfw.create_window(64, 48, "theirs", None, None)
    glfw.make_context_current(self.window)

Theirs.open = open_window
Theirs.show = lambda self: (glfw.swap_buffers(self.window), glfw.poll_events())
"""
PYGAME = f"""{WINDOW}
import pygame

def open_window(self):
    pygame.display.init()
    pygame.display.set_mode((64, 48), pygame.OPENGL | pygame.DOUBLEBUF)

Theirs.open = open_window
Theirs.show = lambda self: (pygame.display.flip(), pygame.event.pump())
"""
PLAIN_PYGAME = """
import pygame

class Theirs:
    '''A window without OpenGL, as that of Gymnasium's render_mode="human".'''

    def __init__(self):
        pygame.display.init()
        self.window, self.frames = pygame.display.set_mode((64, 48)), 0

    def check(self):
        self.frames += 1
        self.window.fill((self.frames, 128, 0))
        pygame.display.flip()
        pygame.event.pump()
        assert self.window.get_at((5, 5))[:3] == (self.frames, 128, 0)
"""
OTHER_SIZE = """
class Theirs:
    '''Two more worlds of ours, drawn at other sizes, the second one in 3-D, too.'''

    def __init__(self):
        make = lambda renderer: magical_mj.Engine("MatchRegions", "All", seed=3, renderer=renderer)
        self.engines = [make("opengl"), make("software")]
        self.solid = self.engines[0].render("scene", 80)

    def check(self):
        for size in (64, 200):
            opengl, software = (engine.render("allo", size) for engine in self.engines)
            assert (opengl == software).mean() > 0.995
        assert (self.engines[0].render("scene", 80) == self.solid).all()
"""
FILM = """
from gymnasium.wrappers import RenderCollection

class Theirs:
    '''Another environment that observes pictures, and is filmed as by RecordVideo: larger, after each step.'''

    def __init__(self):
        name = "magical_mj/MoveToCorner-Demo-LoRes4A-v0"
        make = lambda renderer: gymnasium.make(name, renderer=renderer, render_mode="rgb_array")
        self.envs = [RenderCollection(make(renderer), pop_frames=False) for renderer in ("opengl", "software")]
        for env in self.envs:
            env.reset(seed=1)

    def check(self):
        opengl, software = (env.step(7)[0][..., -3:] for env in self.envs)
        assert (opengl == software).mean() > 0.995
        opengl, software = (env.render()[-1] for env in self.envs)
        assert (opengl == software).mean() > 0.995
"""
THREADS = """
from concurrent.futures import ThreadPoolExecutor

class Theirs:
    '''Worlds of ours that are drawn by other threads meanwhile, each frame by whichever is free.'''

    def __init__(self):
        self.pool, self.jobs = ThreadPoolExecutor(4), []
        make = lambda seed, renderer: magical_mj.Engine("MakeLine", "All", seed=seed, renderer=renderer)
        self.pairs = [[make(seed, renderer) for renderer in ("opengl", "software")] for seed in range(6)]
        self.check()

    def check(self):
        assert all(job.result() > 0.995 for job in self.jobs)
        self.jobs = [self.pool.submit(self.step, number, *pair) for number, pair in enumerate(self.pairs)]

    def step(self, number, opengl, software):
        for engine in (opengl, software):
            engine.step(number)
        size = 64 + number
        return min((opengl.render(view, size) == software.render(view, size)).mean() for view in ("ego", "allo"))
"""

OURS = f"""{OTHER_SIZE}
Sizes = Theirs
{FILM}
Film = Theirs
{THREADS}
Threads = Theirs

class Theirs:
    def __init__(self):
        self.all = Threads(), Sizes(), Film()

    def check(self):
        for one in self.all:
            one.check()
"""


def pictures(actions: Sequence[int]) -> NDArray[np.uint8]:
    """The robot's view in FindDupe-All at the start and after each action, drawn without OpenGL."""
    engine = magical_mj.Engine("FindDupe", "All", seed=0, renderer="software")
    return np.stack(
        [engine.render("ego", 96), *((engine.step(action), engine.render("ego", 96))[1] for action in actions)]
    )


@pytest.fixture
def run(tmp_path: Path) -> Run:
    np.save(tmp_path / "pictures.npy", pictures([5 * step % 18 for step in range(1, 8)]))

    def run(*program: str, **variables: str) -> None:
        environment = BARE | {"PYTHONWARNINGS": "ignore"} | variables
        result = subprocess.run(
            [sys.executable, "-c", "".join(program)],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert (result.returncode, "ignored" in result.stderr) == (0, False), result.stderr[-2000:]

    return run


ORDERS = {"ours": "ours = Ours()\ntheirs = Theirs()\n", "theirs": "theirs = Theirs()\nours = Ours()\n"}
"""Whose pictures begin."""


@pytest.mark.parametrize(
    ("theirs", "first", "variables"),
    [
        pytest.param(MUJOCO, "ours", EGL, id="mujoco, ours"),
        pytest.param(MUJOCO, "theirs", EGL, id="mujoco, theirs"),
        pytest.param(DM_CONTROL, "theirs", EGL, id="dm_control"),
        pytest.param(PYGAME, "ours", OFFSCREEN, id="pygame, ours"),
        pytest.param(PYGAME, "theirs", OFFSCREEN, id="pygame, theirs"),
        pytest.param(OURS, "ours", {}, id="ours"),
    ],
)
def test_pictures_stay_current_without_a_display(theirs: str, first: str, variables: dict[str, str], run: Run) -> None:
    if "dm_control" in theirs:
        pytest.importorskip("dm_control", reason="dm_control does not install here")
    run(BEGIN, theirs, ORDERS[first], END, **variables)


@pytest.mark.parametrize("theirs", [MUJOCO, DM_CONTROL], ids=["mujoco", "dm_control"])
def test_pictures_stay_current_where_others_find_no_context_of_their_own(theirs: str, run: Run) -> None:
    """Without a display and MUJOCO_GL, others can open no window. They say so, and draw into no context of ours."""
    if "dm_control" in theirs:
        pytest.importorskip("dm_control", reason="dm_control does not install here")
    refused = (
        "import sys; sys.unraisablehook = print  # what dm_control says when it frees the context that it has not got\n"
        "ours = Ours()\nours.check()\n"
        "try: Theirs().check()\nexcept mujoco.FatalError: pass\nelse: raise AssertionError('a picture of whom?')\n"
    )
    run(BEGIN, theirs, refused, "for _ in range(6): ours.check()\nours.check_that_it_moved()\n")


def test_dm_control_may_be_imported_before_an_environment_is_loaded(run: Run, tmp_path: Path) -> None:
    pytest.importorskip("dm_control", reason="dm_control does not install here")
    np.save(tmp_path / "driven.npy", pictures(range(12, 18)))
    for begin in (DM_CONTROL + "import magical_mj\n", "import magical_mj\n" + DM_CONTROL):
        run(
            "import numpy as np\n",
            begin,
            "theirs = Theirs()\n"
            "env = magical_mj.load('FindDupe', 'All', seed=0, renderer='opengl')\n"
            "before = env.reset().observation['ego']\n"
            "for action, expected in zip(range(12, 18), np.load('driven.npy')[1:]):\n"
            "    theirs.check()\n"
            "    lit = env.physics.render(64, 64)\n"
            "    picture = env.step(action).observation['ego']\n"
            "    assert (picture == expected).mean() > 0.995\n"
            "    assert (env.physics.render(64, 64) != lit).any()\n"
            "assert (picture != before).any()\n",
            **EGL,
        )


@WITH_DISPLAY
@pytest.mark.parametrize("first", ORDERS)
@pytest.mark.parametrize("theirs", [GLFW, PYGAME], ids=["glfw", "pygame"])
def test_pictures_stay_current_beside_windows(theirs: str, first: str, run: Run, tmp_path: Path) -> None:
    with hidden_display(tmp_path) as display:
        run(BEGIN, theirs, ORDERS[first], END, DISPLAY=display.name)


@WITH_DISPLAY
@pytest.mark.parametrize("theirs", [MUJOCO, PLAIN_PYGAME], ids=["mujoco", "plain"])
def test_pictures_stay_current_beside_later_windows(theirs: str, run: Run, tmp_path: Path) -> None:
    with hidden_display(tmp_path) as display:
        run(BEGIN, theirs, ORDERS["ours"], END, DISPLAY=display.name)


def test_load_warns_if_dm_control_has_chosen_windows_without_a_display(run: Run) -> None:
    """It chooses when it is imported. Our own pictures are not affected."""
    pytest.importorskip("dm_control", reason="dm_control does not install here")
    load = (
        "import warnings\n"
        "with warnings.catch_warnings(record=True) as said:\n"
        "    warnings.simplefilter('always')\n"
        "    import magical_mj\n"
        "    env = magical_mj.load('MoveToRegion', seed=0, observations=('ego',))\n"
        "    assert env.reset().observation['ego'].std() > 0\n"
        "texts = [str(warning.message) for warning in said if 'MUJOCO_GL' in str(warning.message)]\n"
    )
    run("from dm_control import mujoco\n", load, "assert len(texts) == 1 and 'GLFW' in texts[0], texts\n")
    run("from dm_control import mujoco\n", load, "assert not texts, texts\n", **EGL)
    run(load, "from dm_control import mujoco\nassert not texts, texts\n")
