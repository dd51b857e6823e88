"""A window to play in: shows pictures and reads the keyboard. Needs pygame-ce."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Sequence
from typing import Final, Literal

import numpy as np

from magical_mj.cli.film import INK, PAPER
from magical_mj.scene import constants as c
from magical_mj.scene.actions import Action, Drive, Gripper, Turn
from magical_mj.utils.errors import MagicalError
from magical_mj.utils.extras import missing_extra

Wish = Literal["reset", "next", "discard", "quit"]

LINES: Final = 2  # of text below the pictures
LINE: Final = 26  # pixels
BAR: Final = LINES * LINE + 16  # pixels below the pictures, for the text
FALLBACKS: Final = ("offscreen", "dummy")  # the video drivers that SDL chooses if there is no display
TEXT_SIZE: Final = 22  # pixels


class Window:
    """A window as wide as two pictures, with two lines of text below them.

    Args:
        title: the window's title.
        size: side of a picture in pixels.
        speed: 1 is real time; 0 is as fast as possible.
        advice: what to do without a display, for the error.

    Raises:
        MagicalError: if pygame-ce is not installed, or there is no display.
    """

    def __init__(self, title: str, size: int, speed: float = 1.0, advice: str = "") -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ModuleNotFoundError:
            raise missing_extra("a window", "window") from None
        self._pygame = pygame
        self._size, self._rate = size, speed * c.CONTROL_RATE
        try:
            if _without_display():  # SDL would look for one, and complain in words of its own
                raise pygame.error("there is no display")
            pygame.display.init()
            if pygame.display.get_driver() in FALLBACKS and "SDL_VIDEODRIVER" not in os.environ:
                raise pygame.error("the display does not answer")
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
        """Shows two pictures side by side, shape (size, 2 * size, 3), and two lines; waits for the next step."""
        pygame, surface = self._pygame, self._surface
        surface.fill(PAPER)
        surface.blit(pygame.surfarray.make_surface(pictures.swapaxes(0, 1)), (0, 0))
        for number, line in enumerate(lines):
            surface.blit(self._font.render(line, True, INK), (10, self._size + 10 + number * LINE))
        pygame.display.flip()
        self._clock.tick(self._rate)

    def wishes(self) -> list[Wish]:
        """The commands since the last call; also updates the state of the keys."""
        pygame = self._pygame
        meanings: dict[int, Wish] = {
            pygame.K_r: "reset",
            pygame.K_n: "next",
            pygame.K_d: "discard",
            pygame.K_ESCAPE: "quit",
        }
        found: list[Wish] = []
        self._tapped = set()
        for event in pygame.event.get():
            if event.type == pygame.QUIT:
                found.append("quit")
            elif event.type == pygame.KEYDOWN:
                self._held.add(event.key)
                self._tapped.add(event.key)
                with contextlib.suppress(KeyError):
                    found.append(meanings[event.key])
            elif event.type == pygame.KEYUP:
                self._held.discard(event.key)
            elif event.type == pygame.WINDOWFOCUSLOST:
                self._held.clear()
        return found

    def action(self) -> int:
        """The action of the keys that are held, or were pressed since the last step: arrows, and space to grip."""
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


def _without_display() -> bool:
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER")
    return sys.platform == "linux" and not any(os.environ.get(name) for name in displays)
