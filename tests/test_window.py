"""Windows under X11, in a display of their own: Gymnasium's `render_mode="human"` beside our drawing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

from magical_mj.presets import PRESETS

pytestmark = pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb (Debian and Ubuntu: apt-get install xvfb)")

WATCH = """
import sys, gymnasium, magical_mj
draws_first, presets = sys.argv[1] == "True", sys.argv[2:]
other = magical_mj.load("MoveToRegion", observations=())
other.reset()
if draws_first:
    other.render()
for preset in presets:
    name = "-".join(filter(None, ("magical_mj/MoveToRegion-Demo", preset, "v0")))
    env = gymnasium.make(name, render_mode="human")
    env.reset(seed=0)
    for action in (1, 4):
        env.step(action)
    other.render()
    env.close()
    print(name)
"""


@pytest.fixture(scope="module")
def display() -> Iterator[str]:
    """The name of a display that nobody sees."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1024x768x24", "-nolisten", "tcp"]
    with subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        with os.fdopen(reading) as answer:
            number = answer.readline().strip()
        yield f":{number}"
        server.terminate()


@pytest.mark.parametrize("draws_first", [True, False])
@pytest.mark.parametrize("backend", ["egl", "", "glfw"])
def test_a_window_opens_beside_drawing_with_every_preset(display: str, backend: str, draws_first: bool) -> None:
    pytest.importorskip("pygame")
    variables = {name: value for name, value in os.environ.items() if not name.startswith("SDL_")}
    result = subprocess.run(
        [sys.executable, "-c", WATCH, str(draws_first), *PRESETS],
        env=variables | {"DISPLAY": display, "MUJOCO_GL": backend, "PYGAME_HIDE_SUPPORT_PROMPT": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == len(PRESETS)
