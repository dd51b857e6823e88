"""`magical-mj guess`: play an intent after two demonstrations, before you see its sentence."""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Final

import typer

import magical_mj
from magical_mj.cli import option
from magical_mj.cli.console import make_writable_folder
from magical_mj.cli.film import side_by_side
from magical_mj.cli.play import Game, Record, Speed, Window, play_in
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.registry import task_name

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.engine import Engine
    from magical_mj.web.puzzles import Puzzle

QUESTION: Final = "Do what the demonstrations did. What they want is shown at the end."


def guess(
    task: option.OptionalTask = None,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    record: Record = None,
    size: option.Size = 480,
    speed: Speed = 1.0,
    renderer: option.Renderer = None,
) -> None:
    """Watch two demonstrations of TASK, an intent, or of a random one. Then do the same in VARIANT.

    The keys are those of `magical-mj play`. The intent of the demonstrations is shown at the end.
    """
    from magical_mj.web.puzzles import DEMONSTRATIONS, puzzle_of, puzzles  # imported late: it loads the simulator

    if task is not None and not task_name(task).startswith("intent:"):
        raise typer.BadParameter(f"guess is for intents, such as intent:dev/3, and {task} is a task.")
    puzzle = secrets.choice(puzzles()) if task is None else puzzle_of(task)
    with closing(Window("What do you want?", size, speed)) as window:
        for number, letters in enumerate(puzzle.demonstrations):
            line = f"Demonstration {number + 1} of {DEMONSTRATIONS}. Then you do the same."
            with closing(magical_mj.Engine(puzzle.task, seed=number, renderer=renderer)) as env:
                if not watch(window, env, actions_of(letters), line, size):
                    return
        with closing(magical_mj.Engine(puzzle.task, variant, seed=seed, renderer=renderer)) as env:
            folder = None if record is None else make_writable_folder(record)
            play_in(window, Guess(env, seed, folder, puzzle), size)


def watch(window: Window, env: Engine, actions: Iterable[int], line: str, size: int) -> bool:
    """Shows an episode. N skips the rest. Returns False if the player quits."""
    for action in actions:
        window.show(side_by_side(env, size), [line, "N skips it, Esc quits"])
        if (wish := window.wish()) in ("next", "quit"):
            return wish == "next"
        env.step(action)
    return True


class Guess(Game):
    """A game whose goal and score are shown after the first episode."""

    def __init__(self, env: Engine, seed: int, folder: Path | None, puzzle: Puzzle) -> None:
        self._puzzle = puzzle
        super().__init__(env, puzzle.task, seed, folder)
        self.goal = QUESTION

    def finish(self, demo: Demonstration) -> None:
        """Reports the goal and what was reached instead, and saves the episode."""
        self.goal = self._puzzle.intent.sentence
        if demo.score < 1.0:
            reached = self._puzzle.reached_instead(self.env.initial_scene, self.env.scene)
            self.remark = f"What you did instead: {reached.sentence}" if reached else ""
        self.screen.print(self.goal, self.remark)
        super().finish(demo)

    def so_far(self) -> str:
        """Nothing before the goal is shown, since the score would tell it."""
        return "" if self.goal == QUESTION else super().so_far()
