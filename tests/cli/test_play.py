"""Playing with the keyboard: what keys mean, and whole episodes with synthetic key events under a virtual display."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import magical_mj
from magical_mj.cli import main
from magical_mj.cli.play import Game, Window, play_in
from magical_mj.demos import load, verify
from magical_mj.scene.actions import ACTIONS, Action, Drive, Gripper, Turn
from tests.helpers.commands import Shell

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
    """Somebody at the keyboard: at some frames keys are pressed and released."""

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
    assert "not solved; kept, D discards it" in player.lines[-1][1]
    (demo,) = load("MoveToRegion", tmp_path)
    assert len(demo.actions) == 40
    assert demo.demonstrator == "human"
    first = Action(turn=Turn.LEFT, drive=Drive.FORWARD).number  # the up key is held still
    assert set(demo.actions.tolist()) <= {Action(drive=Drive.FORWARD).number, first}
    assert verify(demo).exact


@pytest.mark.parametrize("discard", [True, False])
def test_what_was_played_is_kept_at_once_and_discarded_on_request(
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
    """Never an episode of before that is the same; and without a folder nothing is kept."""
    env = magical_mj.Engine("MoveToRegion", seed=0)
    demo = load("MoveToRegion")[0]
    for folder, caption in ((tmp_path, "kept, D discards it"), (tmp_path, "the same as one that is kept"), (None, "")):
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
    """And advises to play in a browser, where only tasks of the benchmark can be played."""
    (tmp_path / "mine.py").write_text(OWN)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if driver is not None:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    error = shell.fails(1, "play", task, "--record", "kept")
    assert "A window needs a display" in error
    assert ("play --web" in error) == (task == "FindDupe")
    assert not (tmp_path / "kept").exists()


def test_without_its_extra_no_folder_is_made(shell: Shell, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    assert '[window]"' in shell.fails(1, "play", "FindDupe", "--record", "mine")
    assert list(tmp_path.iterdir()) == []
