"""Playing with the keyboard: synthetic keys without a display, and windows on a hidden X11 display."""

from __future__ import annotations

import itertools
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

import magical_mj
from magical_mj.actions import ACTIONS, NOOP, Action, Drive, Gripper, Turn
from magical_mj.cli import main, play
from magical_mj.cli.play import AFTER, KEYS, Game, Window, play_in
from magical_mj.demos import load, verify
from magical_mj.envs.presets import PRESETS
from tests.helpers.commands import Shell
from tests.helpers.display import Display, hidden_display

pygame = pytest.importorskip("pygame")

SIZE = 48


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Iterator[Window]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    window = Window("test", SIZE, speed=0)
    pygame.event.clear()
    yield window
    window.close()


def press(*keys: int) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))


def release(*keys: int) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYUP, key=key))


def test_every_action_has_its_keys(window: Window) -> None:
    turns = {Turn.NONE: [], Turn.LEFT: [pygame.K_LEFT], Turn.RIGHT: [pygame.K_RIGHT]}
    drives = {Drive.NONE: [], Drive.FORWARD: [pygame.K_UP], Drive.BACK: [pygame.K_DOWN]}
    for action in ACTIONS:
        keys = turns[action.turn] + drives[action.drive] + [pygame.K_SPACE] * (action.gripper == Gripper.CLOSE)
        press(*keys)
        window.wish()
        assert window.action() == action.number
        release(*keys)
        window.wish()
        assert window.action() == 0


def test_a_tap_between_two_steps_counts_for_one(window: Window) -> None:
    press(pygame.K_UP)
    release(pygame.K_UP)
    window.wish()
    assert window.action() == Action(drive=Drive.FORWARD).number
    window.wish()
    assert window.action() == 0


def test_opposite_keys_cancel_and_a_lost_focus_lets_go(window: Window) -> None:
    press(pygame.K_LEFT, pygame.K_RIGHT, pygame.K_UP)
    window.wish()
    assert window.action() == Action(drive=Drive.FORWARD).number
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    window.wish()
    assert window.action() == 0


class Player:
    """Simulates a player who presses and releases keys at given frames."""

    def __init__(self, window: Window, monkeypatch: pytest.MonkeyPatch, keys: dict[int, list[int]]) -> None:
        self.keys, self.lines, self.show = keys, [], window.show
        monkeypatch.setattr(window, "show", self.look)

    def look(self, pictures: np.ndarray, lines: list[str]) -> None:
        self.show(pictures, lines)
        self.lines.append(lines)
        for key in self.keys.get(len(self.lines), []):
            press(key)
            if key not in (pygame.K_UP, pygame.K_LEFT):
                release(key)
        if len(self.lines) == 500:
            press(pygame.K_ESCAPE)


def test_an_episode_is_played_recorded_and_read_again(
    window: Window, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    keys = {5: [pygame.K_UP], 14: [pygame.K_r], 16: [pygame.K_LEFT], 80: [pygame.K_ESCAPE]}
    player = Player(window, monkeypatch, keys)
    play_in(window, Game(env, "MoveToRegion", 0, tmp_path), SIZE)
    env.close()
    assert all(lines[0] == "Drive into the goal region." for lines in player.lines)
    assert ["press a key to start" in lines[1] for lines in player.lines[:7]] == [True] * 5 + [False] * 2
    assert "5 s, score so far 0.00" in player.lines[5][1]
    assert "not solved; saved, D discards it" in player.lines[-1][1]
    (demo,) = load("MoveToRegion", tmp_path)
    assert len(demo.actions) == 40
    assert demo.demonstrator == "human"
    first = Action(turn=Turn.LEFT, drive=Drive.FORWARD).number  # the up key is still held
    assert set(demo.actions.tolist()) <= {Action(drive=Drive.FORWARD).number, first}
    assert verify(demo).exact


@pytest.mark.parametrize("discard", [True, False])
def test_episodes_are_saved_at_once_and_discarded_on_request(
    window: Window, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str], discard: bool
) -> None:
    env = magical_mj.Engine("MoveToRegion", seed=0)
    last = [pygame.K_d, pygame.K_d] if discard else [pygame.K_n]
    player = Player(window, monkeypatch, {1: [pygame.K_UP], 50: last, 55: [pygame.K_ESCAPE]})
    play_in(window, Game(env, "MoveToRegion", 0, tmp_path), SIZE)
    env.close()
    assert "solved" in player.lines[45][1]
    assert len(list(tmp_path.iterdir())) == (not discard)
    assert ("discarded" in capsys.readouterr().out) == discard
    assert ("discarded" in player.lines[-1][1]) == discard


def test_only_what_was_saved_last_is_discarded(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """It never discards an equal episode that was saved before. Without a folder, it saves none."""
    env = magical_mj.Engine("MoveToRegion", seed=0)
    demo = load("MoveToRegion")[0]
    for folder, caption in (
        (tmp_path, "saved, D discards it"),
        (tmp_path, "the same episode was saved"),
        (None, ""),
    ):
        game = Game(env, "MoveToRegion", 0, folder)
        game.finish(demo)
        assert f"score 1.00, solved; {caption}" in game.caption()
    game.discard()
    assert len(load("MoveToRegion", tmp_path)) == 1
    assert capsys.readouterr().out.endswith("seed 0: score 1.00, solved\n")
    env.close()


def test_the_command_records_under_a_free_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    wishes = iter([None] * 41 + ["reset"] + [None] * 41 + ["quit"])
    monkeypatch.setattr(Window, "wish", lambda _: next(wishes))
    actions = itertools.chain([1] * 41, [2] * 41)
    monkeypatch.setattr(Window, "action", lambda _: next(actions))
    assert main(["play", "MoveToRegion", "--record", str(tmp_path), "--size", str(SIZE), "--speed", "4"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "MoveToRegion-Demo-human-000.npz",
        "MoveToRegion-Demo-human-001.npz",
    ]
    assert {demo.demonstrator for demo in load("MoveToRegion", tmp_path)} == {"human"}


OWN = (
    "from dataclasses import replace\nfrom magical_mj.tasks.find_dupe import SPEC as OURS\n"
    'SPEC = replace(OURS, name="Mine")\n'
)


@pytest.mark.parametrize(("task", "driver"), [("FindDupe", "no such driver"), ("FindDupe", None), ("mine:SPEC", None)])
def test_without_a_display_it_says_so_and_makes_nothing(
    task: str, driver: str | None, shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The error recommends playing in a browser, where only the benchmark's tasks can be played."""
    (tmp_path / "mine.py").write_text(OWN)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if driver is not None:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    error = shell.fails(1, "play", task, "--record", "kept")
    assert "A window needs a display" in error
    assert ("magical-mj serve" in error) == (task == "FindDupe")
    assert not (tmp_path / "kept").exists()


def test_without_its_extra_no_folder_is_made(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert '[window]"' in shell.fails(1, "play", "FindDupe", "--record", "mine")
    assert list(tmp_path.iterdir()) == []


needs_xvfb = pytest.mark.skipif(not shutil.which("Xvfb"), reason="needs Xvfb (Debian and Ubuntu: apt-get install xvfb)")

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


@needs_xvfb
@pytest.mark.parametrize(
    ("backend", "presets", "draws_first"),
    [("", tuple(PRESETS), True), ("egl", ("",), False), ("glfw", ("",), True)],
    ids=["any", "egl, first", "glfw"],
)
def test_a_window_opens_beside_drawing(
    display: Display, backend: str, presets: tuple[str, ...], draws_first: bool
) -> None:
    """With every preset and every backend."""
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
    """A picture of a line of text as it is drawn in the window."""
    import pygame

    pygame.font.init()
    letters = pygame.font.Font(None, play.TEXT_SIZE).render(text, True, play.INK)
    drawn = pygame.Surface(letters.get_size())
    drawn.fill(play.PAPER)
    drawn.blit(letters, (0, 0))
    return pygame.surfarray.array3d(drawn).swapaxes(0, 1)


def is_in(part: NDArray[np.uint8], whole: NDArray[np.uint8]) -> bool:
    """Whether a picture contains another one exactly. Compares all pixels."""
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


@needs_xvfb
@pytest.mark.skipif(not shutil.which("xdotool"), reason="needs xdotool (Debian and Ubuntu: apt-get install xdotool)")
def test_an_episode_is_played_with_real_keys(display: Display, tmp_path: Path) -> None:
    """The whole command. The text is read from the screen, and the server sends the keys."""
    command = [sys.executable, "-m", "magical_mj", "play", "MoveToRegion", "Jitter", "--record", str(tmp_path)]
    variables = os.environ | {"DISPLAY": display.name, "SDL_VIDEODRIVER": "x11"}

    def shows(text: str) -> bool:
        return is_in(words(text), display.picture())

    def play_to_the_end() -> str:
        """Holds the up key until the episode is saved. Returns the expected text of the window."""
        wait_for(lambda: shows(f"press a key to start, score so far 0.00 ({KEYS})"), "a new episode")
        display.xdotool("keydown", "Up")
        wait_for(lambda: any(tmp_path.glob("*.npz")), "a file")
        display.xdotool("keyup", "Up")
        (demo,) = load("MoveToRegion", tmp_path)
        assert demo.actions[0] != NOOP  # the clock started with the first key
        assert verify(demo).exact
        return f"score {demo.score:.2f}, {'solved' if demo.score == 1.0 else 'not solved'}"

    with subprocess.Popen([*command, "--speed", "4", "--size", "480"], env=variables) as game:
        try:
            wait_for(lambda: shows("Drive into the goal region."), "the goal")
            time.sleep(2)  # longer than the episode
            assert not any(tmp_path.iterdir())
            said = play_to_the_end()
            wait_for(lambda: shows(f"{said}; saved, D discards it; {AFTER}"), "that it is kept")
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
