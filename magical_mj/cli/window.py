"""A window to play in: shows pictures, and knows which keys are held. Needs pygame-ce."""

from __future__ import annotations

import contextlib
import os
from typing import Final, Literal

import numpy as np

from magical_mj import constants as c
from magical_mj.actions import Action, Drive, Gripper, Turn
from magical_mj.errors import MagicalError
from magical_mj.extras import missing_extra

Wish = Literal["reset", "next", "quit"]

BAR: Final = 36  # pixels below the pictures, for a line of text
PAPER: Final = (255, 255, 255)
INK: Final = (60, 60, 60)
TEXT_SIZE: Final = 22  # pixels


class Window:
    """A window as wide as two pictures, with a line of text below them.

    Args:
        title: what the frame says.
        size: side of a picture in pixels.
        speed: 1 is real time; 0 is as fast as it goes.

    Raises:
        MagicalError: if pygame-ce is not installed, or there is no display.
    """

    def __init__(self, title: str, size: int, speed: float = 1.0) -> None:
        os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        try:
            import pygame
        except ModuleNotFoundError:
            raise missing_extra("a window", "window") from None
        self._pygame = pygame
        self._size, self._rate = size, speed * c.CONTROL_RATE
        try:
            pygame.display.init()
            self._surface = pygame.display.set_mode((2 * size, size + BAR))
        except pygame.error as error:
            raise MagicalError(f"no window can be opened here: {error}; is there a display?") from error
        pygame.display.set_caption(title)
        pygame.font.init()
        self._font = pygame.font.Font(None, TEXT_SIZE)
        self._clock = pygame.time.Clock()
        self._held: set[int] = set()
        self._tapped: set[int] = set()

    def show(self, pictures: np.ndarray, text: str) -> None:
        """Show two pictures of shape (size, 2 size, 3) and a text, and wait until it is time for the next step."""
        pygame, surface = self._pygame, self._surface
        surface.fill(PAPER)
        surface.blit(pygame.surfarray.make_surface(pictures.swapaxes(0, 1)), (0, 0))
        surface.blit(self._font.render(text, True, INK), (10, self._size + 10))
        pygame.display.flip()
        self._clock.tick(self._rate)

    def wishes(self) -> list[Wish]:
        """What was asked for since the last call; keeps account of the keys."""
        pygame = self._pygame
        meanings: dict[int, Wish] = {
            pygame.K_r: "reset",
            pygame.K_n: "next",
            pygame.K_q: "quit",
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
        """The action of the keys that are held, or were tapped since the step before: arrows, and space to grip."""
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
