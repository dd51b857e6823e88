"""`magical-mj play`: drive the robot with the keyboard, and record what you do."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

import magical_mj
from magical_mj.cli.console import TASK_HELP, Seed, Size, Variant, claim_folder, console
from magical_mj.cli.film import side_by_side
from magical_mj.cli.web import Collect, Host, Origin, Port, Tasks, Variants, Wanted, serve_page
from magical_mj.cli.window import Window
from magical_mj.constants import CONTROL_RATE
from magical_mj.registry import environments, variant_name

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.environment import Environment

KEYS: Final = "arrows drive, space grips, R again, N next scene, Esc quits"

Record = Annotated[Path | None, typer.Option(help="Write each finished episode into this folder.", show_default=False)]
Speed = Annotated[float, typer.Option(min=0.1, max=4.0, help="Times real time.")]
OptionalTask = Annotated[str | None, typer.Argument(help=TASK_HELP, show_default=False)]
Web = Annotated[bool, typer.Option("--web", help="Play in a browser instead of a window.")]


def play(
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

    With --web, and any of the options below it, in a browser: on this machine, or on another one through ssh -L.
    """
    if web:
        first = None if task is None else (task, variant_name(variant), seed)
        serve_page(first, environments(tasks, variants), collect, wanted, host, port, origin)
        return
    if task is None:
        raise typer.BadParameter("which task? Only --web does without")
    env = magical_mj.load(task, variant, seed=seed, observations=())
    screen = console()
    if record is not None:
        claim_folder(record)

    def finished(demo: Demonstration) -> None:
        screen.print(f"seed {demo.scene_seed}: score {demo.score:.2f}")
        if record is not None:
            screen.print(magical_mj.demos.keep(demo, record), soft_wrap=True)

    window = Window(f"{task} {variant_name(variant)}", size, speed)
    try:
        play_in(window, env, task, variant, seed, size, finished)
    finally:
        window.close()
        env.close()


def play_in(
    window: Window,
    env: Environment,
    task: str,
    variant: str,
    seed: int,
    size: int,
    finished: Callable[[Demonstration], None],
) -> None:
    """The loop: episodes until somebody wants to quit; `finished` is given each that was played to its end."""
    horizon = env.horizon or 0
    while True:
        env.reset(seed=seed)
        recorder, steps, over = magical_mj.demos.Recorder(env), 0, False
        while True:
            left = f"score {env.score():.2f}" if over else f"{(horizon - steps) / CONTROL_RATE:.0f} s"
            window.show(side_by_side(env, size), f"{left}   ({KEYS})")
            wishes = window.wishes()
            if "quit" in wishes:
                return
            if wishes:
                seed += "next" in wishes
                break
            if not over:
                over = recorder.step(window.action()).last()
                steps += 1
                if over:
                    finished(recorder.demonstration(task, variant, seed, "human", seed))
