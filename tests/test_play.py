"""Playing with the keyboard: what keys mean, and whole episodes with synthetic key events under a virtual display."""

from __future__ import annotations

import itertools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.actions import ACTIONS, Action, Drive, Gripper, Turn
from magical_mj.cli import main
from magical_mj.cli.play import play_in
from magical_mj.demos import Demonstration, load, verify

pygame = pytest.importorskip("pygame")

from magical_mj.cli.window import Window  # noqa: E402

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
        window.wishes()
        assert window.action() == action.number
        release(*keys)
        window.wishes()
        assert window.action() == 0


def test_a_tap_between_two_steps_counts_for_one(window: Window) -> None:
    press(pygame.K_UP)
    release(pygame.K_UP)
    window.wishes()
    assert window.action() == Action(drive=Drive.FORWARD).number
    window.wishes()
    assert window.action() == 0


def test_opposite_keys_cancel_and_a_lost_focus_lets_go(window: Window) -> None:
    press(pygame.K_LEFT, pygame.K_RIGHT, pygame.K_UP)
    window.wishes()
    assert window.action() == Action(drive=Drive.FORWARD).number
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    window.wishes()
    assert window.action() == 0


def test_an_episode_is_played_recorded_and_read_again(window: Window, monkeypatch: pytest.MonkeyPatch) -> None:
    env = magical_mj.load("MoveToRegion", seed=0, observations=())
    played: list[Demonstration] = []
    frames = 0
    show = window.show

    def script(pictures: np.ndarray, text: str) -> None:
        nonlocal frames
        show(pictures, text)
        frames += 1
        if frames == 1:
            press(pygame.K_UP)
        if frames == 10:
            release(pygame.K_UP)
            press(pygame.K_r)  # again, from the start
        if frames == 12:
            press(pygame.K_LEFT)
        if played:
            press(pygame.K_ESCAPE)

    monkeypatch.setattr(window, "show", script)
    play_in(window, env, "MoveToRegion", "Demo", 0, SIZE, played.append)
    env.close()
    (demo,) = played
    assert len(demo.actions) == 40
    assert demo.demonstrator == "human"
    assert set(demo.actions.tolist()) == {0, Action(turn=Turn.LEFT).number}
    assert verify(demo).exact


def test_the_command_records_under_a_free_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    wishes = iter([[] for _ in range(41)] + [["reset"]] + [[] for _ in range(41)] + [["quit"]])
    monkeypatch.setattr(Window, "wishes", lambda _: next(wishes))
    actions = itertools.chain([1] * 40, [2] * 40)
    monkeypatch.setattr(Window, "action", lambda _: next(actions))
    assert main(["play", "MoveToRegion", "--record", str(tmp_path), "--size", str(SIZE), "--speed", "4"]) == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "MoveToRegion-Demo-human-000.npz",
        "MoveToRegion-Demo-human-001.npz",
    ]
    assert {demo.demonstrator for demo in load("MoveToRegion", tmp_path)} == {"human"}


def test_without_a_display_it_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "no such driver")
    assert main(["play", "FindDupe"]) == 1
    assert "is there a display?" in capsys.readouterr().err


@pytest.mark.skipif(not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="needs Xvfb and xdotool")
def test_real_keys_under_a_virtual_display(tmp_path: Path) -> None:
    """The whole command in a real X server, with keys that the server sends."""
    read_end, write_end = os.pipe()
    command = ["Xvfb", "-displayfd", str(write_end), "-screen", "0", "640x480x24", "-nolisten", "tcp"]
    server = subprocess.Popen(command, pass_fds=[write_end], stderr=subprocess.DEVNULL)
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        display = f":{pipe.readline().strip()}"
    variables = os.environ | {"DISPLAY": display, "SDL_VIDEODRIVER": "x11"}
    play = [sys.executable, "-m", "magical_mj", "play", "MoveToRegion", "--record", str(tmp_path), "--size", "96"]
    game = subprocess.Popen([*play, "--speed", "4"], env=variables, stderr=subprocess.PIPE, text=True)
    try:

        def type_keys(*keys: str) -> None:
            subprocess.run(["xdotool", *keys], env=variables, check=True, timeout=20)

        for _ in range(200):  # until the window is there, nobody hears
            type_keys("key", "--delay", "100", "Up")
            if any(tmp_path.glob("*.npz")) or game.poll() is not None:
                break
        type_keys("key", "Escape")
        _, error = game.communicate(timeout=20)
        assert (game.returncode, error) == (0, "")
    finally:
        game.kill()
        game.wait()
        server.terminate()
        server.wait()
    (demo,) = load("MoveToRegion", tmp_path)
    assert Action(drive=Drive.FORWARD).number in demo.actions
