"""`magical-mj play`: drive the robot in a window."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
from typer import Option

import magical_mj
from magical_mj.actions import NOOP, Action, Drive, Gripper, Turn
from magical_mj.cli import option
from magical_mj.cli.console import console, make_writable_folder
from magical_mj.cli.film import INK, PAPER, side_by_side
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import TASKS, task_name, task_spec, variant_name
from magical_mj.utils.errors import MagicalError
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.engine import Engine

KEYS: Final = "arrows drive, space grips, R again, N next scene, Esc quits"
AFTER: Final = "R again, N next scene, Esc quits"

Wish = Literal["reset", "next", "discard", "quit"]

LINES: Final = 3  # lines of text below the pictures
LINE: Final = 26  # pixels
BAR: Final = LINES * LINE + 16  # pixels below the pictures, for the text
FALLBACKS: Final = ("offscreen", "dummy")  # the video drivers that SDL chooses without a display
TEXT_SIZE: Final = 22  # pixels

Record = Annotated[Path | None, Option(help="Save each finished episode in this folder.")]
Speed = Annotated[float, Option(min=0.1, max=4.0, help="Times real time.")]


def play(
    task: option.Task,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    record: Record = None,
    size: option.Size = 480,
    speed: Speed = 1.0,
    renderer: option.Renderer = None,
) -> None:
    """Drive the robot yourself: arrows, space to grip, R to start again, N for the next scene, Esc to quit.

    With --record, finished episodes are saved as demonstrations; D discards one at its end.
    """
    browser = "; without one, play in a browser: magical-mj serve" if task_name(task) in TASKS else ""
    with (
        closing(magical_mj.Engine(task, variant, seed=seed, renderer=renderer)) as env,
        closing(Window(f"{task} {variant_name(variant)}", size, speed, browser)) as window,
    ):
        game = Game(env, task, seed, None if record is None else make_writable_folder(record))
        play_in(window, game, size)


class Game:
    """Episodes that a person plays one after another. The clock of an episode starts with the first key.

    A finished episode is saved in the folder, if there is one, at once: it is not lost if the window is closed.
    """

    def __init__(self, env: Engine, task: str, seed: int, folder: Path | None) -> None:
        self.env, self._folder, self.screen = env, folder, console()
        summary = task_spec(task).summary
        self.goal = f"{summary[0].upper()}{summary[1:]}."
        self.start(seed)

    def start(self, seed: int) -> None:
        """Starts an episode in the scene of this seed."""
        self.env.reset(seed=seed)
        self.seed, self._steps, self._recorder = seed, 0, magical_mj.demos.Recorder(self.env)
        self._result: str | None = None
        self._path: Path | None = None
        self.remark = ""

    def act(self, action: int) -> None:
        """Takes an action. It has no effect before the first key and after the end."""
        if self._result is not None or (self._steps == 0 and action == NOOP):
            return
        self._steps += 1
        if self._recorder.step(action):
            self.finish(self._recorder.demonstration("human"))

    def finish(self, demo: Demonstration) -> None:
        """Reports and saves an episode that has ended."""
        self._result = f"score {demo.score:.2f}, {'solved' if demo.score == 1.0 else 'not solved'}"
        self.screen.print(f"seed {demo.scene_seed}: {self._result}")
        if self._folder is None:
            return
        path, is_new = magical_mj.demos.keep(demo, self._folder)
        self.screen.print(path, soft_wrap=True)
        self._path = path if is_new else None
        self._result += "; saved, D discards it" if is_new else "; the same episode was saved before"

    def discard(self) -> None:
        """Deletes the episode, if it has ended and was saved."""
        if self._path is not None:
            self._path.unlink()
            self.screen.print(f"discarded {self._path}", soft_wrap=True)
            self._path, self._result = None, "discarded"

    def caption(self) -> str:
        """The state of the episode, and the meaning of the keys."""
        if self._result is not None:
            return f"{self._result}; {AFTER}"
        seconds = ((self.env.horizon or 0) - self._steps) / CONTROL_RATE
        left = f"{seconds:.0f} s" if self._steps else "press a key to start"
        return f"{left}{self.so_far()} ({KEYS})"

    def so_far(self) -> str:
        """The caption's text about the score during an episode."""
        return f", score so far {self.env.score():.2f}"


def play_in(window: Window, game: Game, size: int) -> None:
    """Plays episodes in the same or the next scene until the player quits."""
    wish = None
    while wish != "quit":
        window.show(side_by_side(game.env, size), [game.goal, game.caption(), game.remark])
        wish = window.wish()
        if wish in ("reset", "next"):
            game.start(game.seed + (wish == "next"))
        elif wish == "discard":
            game.discard()
        elif wish is None:
            game.act(window.action())


class Window:
    """A window as wide as two pictures of `size` pixels, with three lines of text below them.

    A speed of 1 is real time; 0 is as fast as possible. `advice` is added to the error about a missing display.

    Raises:
        MagicalError: if pygame-ce is not installed, or no window can be opened.
    """

    def __init__(self, title: str, size: int, speed: float = 1.0, advice: str = "") -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        check_extra("windows", "window")
        import pygame

        self._pygame = pygame
        self._size, self._rate = size, speed * CONTROL_RATE
        try:
            pygame.display.init()
            if pygame.display.get_driver() in FALLBACKS and not os.environ.get("SDL_VIDEODRIVER"):
                raise pygame.error("SDL found no display, or the display does not answer")
            self._surface = pygame.display.set_mode((2 * size, size + BAR))
        except pygame.error as error:
            pygame.display.quit()
            raise MagicalError(
                f"no window can be opened here: {error}. A window needs a display (on Linux, DISPLAY or "
                f"WAYLAND_DISPLAY){advice}"
            ) from None
        pygame.display.set_caption(title)
        pygame.font.init()
        self._font = pygame.font.Font(None, TEXT_SIZE)
        self._clock = pygame.time.Clock()
        self._held: set[int] = set()
        self._tapped: set[int] = set()

    def show(self, pictures: np.ndarray, lines: Sequence[str]) -> None:
        """Shows two pictures, shape (size, 2 * size, 3), and up to three lines. Then waits for the next step."""
        pygame, surface = self._pygame, self._surface
        surface.fill(PAPER)
        surface.blit(pygame.surfarray.make_surface(pictures.swapaxes(0, 1)), (0, 0))
        for number, line in enumerate(lines):
            surface.blit(self._font.render(line, True, INK), (10, self._size + 10 + number * LINE))
        pygame.display.flip()
        self._clock.tick(self._rate)

    def wish(self) -> Wish | None:
        """The command since the last call; of several, the first in the order of `keys`. Reads all keys."""
        pygame = self._pygame
        keys: dict[int, Wish] = {
            pygame.K_ESCAPE: "quit",
            pygame.K_d: "discard",
            pygame.K_n: "next",
            pygame.K_r: "reset",
        }
        wishes: set[Wish | None] = set()
        self._tapped = set()
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                wishes.add("quit")
            elif event.type == pygame.KEYDOWN:
                self._held.add(event.key)
                self._tapped.add(event.key)
                wishes.add(keys.get(event.key))
            elif event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._held.clear()
        return next((wish for wish in keys.values() if wish in wishes), None)

    def action(self) -> int:
        """The action of the keys that are held or were pressed since the last step: arrows, and space to grip."""
        pygame = self._pygame
        down = self._held | self._tapped
        turn = (pygame.K_LEFT in down) - (pygame.K_RIGHT in down)
        drive = (pygame.K_UP in down) - (pygame.K_DOWN in down)
        return Action(
            Gripper.CLOSE if pygame.K_SPACE in down else Gripper.OPEN,
            {0: Turn.NONE, 1: Turn.LEFT, -1: Turn.RIGHT}[turn],
            {0: Drive.NONE, 1: Drive.FORWARD, -1: Drive.BACK}[drive],
        ).number

    def close(self) -> None:
        """Close the window."""
        self._pygame.display.quit()
        self._pygame.font.quit()
