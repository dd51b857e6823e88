"""`magical-mj play`: drive the robot with the keyboard, and record what you do."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

import magical_mj
from magical_mj.cli.console import OptionalTask, Seed, Size, Variant, check_fits, console, make_writable_folder
from magical_mj.cli.film import side_by_side
from magical_mj.cli.web import Collect, Host, Origin, Port, Tasks, Variants, Wanted, serve_page
from magical_mj.cli.window import Window
from magical_mj.scene.actions import NOOP
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import TASKS, environments, task_name, task_spec, variant_name

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.envs.composer import Environment

KEYS: Final = "arrows drive, space grips, R again, N next scene, Esc quits"
AFTER: Final = "R again, N next scene, Esc quits"

Record = Annotated[Path | None, typer.Option(help="Save each finished episode in this folder.", show_default=False)]
Speed = Annotated[float, typer.Option(min=0.1, max=4.0, help="Times real time.")]
Web = Annotated[bool, typer.Option("--web", help="Play in a browser instead of a window.")]


def play(
    context: typer.Context,
    task: OptionalTask = None,
    variant: Variant = "Demo",
    seed: Seed = 0,
    record: Record = None,
    size: Size = 480,
    speed: Speed = 1.0,
    web: Web = False,
    tasks: Tasks = "all",
    variants: Variants = "all",
    collect: Collect = None,
    wanted: Wanted = None,
    host: Host = "127.0.0.1",
    port: Port = 8008,
    origin: Origin = None,
) -> None:
    """Drive the robot yourself: arrows, space to grip, R to start again, N for the next scene, Esc to quit.

    With --record, finished episodes are saved as demonstrations; D discards one at its end.

    With --web, and any of the options below it, in a browser: on this machine, or on another one through ssh -L.
    """
    check_fits(context, not web, "in a window, that is, without --web", "record", "size", "speed")
    check_fits(context, web, "with --web", "tasks", "variants", "collect", "wanted", "host", "port", "origin")
    check_fits(context, task is not None, "with TASK", "seed")
    if web:
        first = None if task is None else (task_spec(task).name, variant_name(variant), seed)
        serve_page(first, environments(tasks, variants), collect, wanted, host, port, origin)
        return
    if task is None:
        raise typer.BadParameter("give TASK, or --web to choose in the browser.")
    browser = "; without one, play in a browser: magical-mj play --web" if task_name(task) in TASKS else ""
    title = f"{task} {variant_name(variant)}"
    with (
        closing(magical_mj.load(task, variant, seed=seed, observations=())) as env,
        closing(Window(title, size, speed, browser)) as window,
    ):
        episodes = Episodes(None if record is None else make_writable_folder(record))
        play_in(window, env, task, variant, seed, size, episodes)


class Episodes:
    """Handles finished episodes: reports them and, if there is a folder, saves them immediately as demonstrations.

    Since they are saved at once, nothing is lost if the window is closed; unwanted ones can be deleted afterwards.
    """

    def __init__(self, folder: Path | None) -> None:
        self._folder, self._screen = folder, console()
        self._path: Path | None = None

    def finish(self, demo: Demonstration) -> str:
        """Saves an episode that has ended; returns a message for the player."""
        result = f"score {demo.score:.2f}, {'solved' if demo.score == 1.0 else 'not solved'}"
        self._screen.print(f"seed {demo.scene_seed}: {result}")
        if self._folder is None:
            return result
        path, is_new = magical_mj.demos.keep(demo, self._folder)
        self._path = path if is_new else None
        self._screen.print(path, soft_wrap=True)
        return f"{result}; kept, D discards it" if is_new else f"{result}; the same as one that is kept"

    def discard(self) -> str | None:
        """Deletes the last episode if it was saved; returns a message for the player."""
        if self._path is None:
            return None
        self._path.unlink()
        self._screen.print(f"discarded {self._path}", soft_wrap=True)
        self._path = None
        return "discarded"


def play_in(
    window: Window, env: Environment, task: str, variant: str, seed: int, size: int, episodes: Episodes
) -> None:
    """Plays episodes until the player quits. Each episode starts with the first key."""
    goal = task_spec(task).summary
    horizon = env.horizon or 0
    while True:
        env.reset(seed=seed)
        recorder, steps, result = magical_mj.demos.Recorder(env), 0, ""
        while True:
            left = f"{(horizon - steps) / CONTROL_RATE:.0f} s" if steps else "press a key to start"
            now = f"{result}; {AFTER}" if result else f"{left}, score so far {env.score():.2f} ({KEYS})"
            window.show(side_by_side(env, size), [f"{goal[0].upper()}{goal[1:]}.", now])
            wishes = window.wishes()
            if "quit" in wishes:
                return
            if "discard" in wishes and result:
                result = episodes.discard() or result
            elif wishes and "discard" not in wishes:
                seed += "next" in wishes
                break
            action = window.action()
            if not result and (steps or action != NOOP):
                over = recorder.step(action).last()
                steps += 1
                if over:
                    result = episodes.finish(recorder.demonstration(task, variant, seed, "human", seed))
