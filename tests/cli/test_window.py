"""Windows under X11, in a display of their own: Gymnasium's `render_mode="human"`, and `play` with real keys."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from magical_mj.cli import play
from magical_mj.cli.play import AFTER, KEYS
from magical_mj.demos import load, verify
from magical_mj.envs.presets import PRESETS
from magical_mj.scene.actions import NOOP
from tests.helpers.display import Display, hidden_display

pytestmark = pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb (Debian and Ubuntu: apt-get install xvfb)")

WATCH = """
import sys, gymnasium, magical_mj
draws_first, presets = sys.argv[1] == "True", sys.argv[2:]
other = magical_mj.Engine("MoveToRegion")
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
def display(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Display]:
    with hidden_display(tmp_path_factory.mktemp("display")) as display:
        yield display


@pytest.mark.parametrize(
    ("backend", "presets", "draws_first"),
    [("", tuple(PRESETS), True), ("", ("",), False), ("egl", ("",), False), ("glfw", ("",), True)],
    ids=["any", "any, first", "egl", "glfw"],
)
def test_a_window_opens_beside_drawing(
    display: Display, backend: str, presets: tuple[str, ...], draws_first: bool
) -> None:
    """With every preset, and with every backend that can be chosen."""
    pytest.importorskip("pygame")
    variables = {name: value for name, value in os.environ.items() if not name.startswith("SDL_")}
    result = subprocess.run(
        [sys.executable, "-c", WATCH, str(draws_first), *presets],
        env=variables | {"DISPLAY": display.name, "MUJOCO_GL": backend, "PYGAME_HIDE_SUPPORT_PROMPT": "1"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    assert len(result.stdout.splitlines()) == len(presets)


def words(text: str) -> NDArray[np.uint8]:
    """How a line of text looks in the window."""
    import pygame

    pygame.font.init()
    letters = pygame.font.Font(None, play.TEXT_SIZE).render(text, True, play.INK)
    drawn = pygame.Surface(letters.get_size())
    drawn.fill(play.PAPER)
    drawn.blit(letters, (0, 0))
    return pygame.surfarray.array3d(drawn).swapaxes(0, 1)


def is_in(part: NDArray[np.uint8], whole: NDArray[np.uint8]) -> bool:
    """Whether a picture is somewhere in another one: all its pixels, looked at one by one."""
    height, width = whole.shape[0] - part.shape[0] + 1, whole.shape[1] - part.shape[1] + 1
    places = np.argwhere((whole[:height, :width] == part[0, 0]).all(axis=-1))
    for y, x in np.random.default_rng(0).permutation(np.argwhere(np.ones(part.shape[:2]))):
        places = places[(whole[places[:, 0] + y, places[:, 1] + x] == part[y, x]).all(axis=-1)]
        if not len(places):
            return False
    return True


def wait_for(condition: Callable[[], bool], what: str) -> None:
    for _ in range(600):
        if condition():
            return
        time.sleep(0.1)
    raise AssertionError(f"not within a minute: {what}")


@pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool (Debian and Ubuntu: apt-get install xdotool)")
def test_an_episode_is_played_with_real_keys(display: Display, tmp_path: Path) -> None:
    """The whole command: what stands below the pictures is read from the screen, and the keys come from the server."""
    pytest.importorskip("pygame")
    command = [sys.executable, "-m", "magical_mj", "play", "MoveToRegion", "Jitter", "--record", str(tmp_path)]
    variables = os.environ | {"DISPLAY": display.name, "SDL_VIDEODRIVER": "x11"}

    def shows(text: str) -> bool:
        return is_in(words(text), display.picture())

    def play_to_the_end() -> str:
        """Holds the up key until the episode is kept; returns what the window is to say of it."""
        wait_for(lambda: shows(f"press a key to start, score so far 0.00 ({KEYS})"), "a new episode")
        display.xdotool("keydown", "Up")
        wait_for(lambda: any(tmp_path.glob("*.npz")), "a file")
        display.xdotool("keyup", "Up")
        (demo,) = load("MoveToRegion", tmp_path)
        assert demo.actions[0] != NOOP  # the clock started with the key
        assert verify(demo).exact
        return f"score {demo.score:.2f}, {'solved' if demo.score == 1.0 else 'not solved'}"

    with subprocess.Popen([*command, "--speed", "4", "--size", "480"], env=variables) as game:
        try:
            wait_for(lambda: shows("Drive into the goal region."), "the goal")
            time.sleep(3)  # three times as long as the episode is
            assert not any(tmp_path.iterdir())
            said = play_to_the_end()
            wait_for(lambda: shows(f"{said}; kept, D discards it; {AFTER}"), "that it is kept")
            display.xdotool("key", "d")
            wait_for(lambda: shows(f"discarded; {AFTER}"), "that it is discarded")
            assert not any(tmp_path.iterdir())
            display.xdotool("key", "n")
            play_to_the_end()
            display.xdotool("key", "Escape")
            assert game.wait(60) == 0
        finally:
            game.kill()
    (demo,) = load("MoveToRegion", tmp_path)
    assert (demo.demonstrator, demo.scene_seed) == ("human", 1)
