"""`magical-mj play` and `inspect`: drive the robot in a window or a browser, and inspect any running model."""

from __future__ import annotations

import asyncio
import contextlib
import os
import re
import secrets
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

import numpy as np
import typer
from typer import Argument, Option

import magical_mj
from magical_mj.cli import option
from magical_mj.cli.console import check_fits, console, make_writable_folder
from magical_mj.cli.film import INK, PAPER, side_by_side
from magical_mj.policies.interface import actions_of
from magical_mj.scene.actions import NOOP, Action, Drive, Gripper, Turn
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair, environments, task_name, task_spec, variant_name
from magical_mj.utils.errors import MagicalError, SettingsError, check_name, short_repr
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.demos import Demonstration
    from magical_mj.engine import Engine
    from magical_mj.web.puzzles import Puzzle
    from magical_mj.web.server import PlayServer

KEYS: Final = "arrows drive, space grips, R again, N next scene, Esc quits"
QUESTION: Final = "Do what the demonstrations did. What they want is shown at the end."
AFTER: Final = "R again, N next scene, Esc quits"

Wish = Literal["reset", "next", "discard", "quit"]

LINES: Final = 3  # lines of text below the pictures
LINE: Final = 26  # pixels
BAR: Final = LINES * LINE + 16  # pixels below the pictures, for the text
FALLBACKS: Final = ("offscreen", "dummy")  # the video drivers that SDL chooses without a display
TEXT_SIZE: Final = 22  # pixels
ORIGIN: Final = re.compile(r"https?://([\w.-]+|\[[\da-f:.]+\])(:\d+)?/*", re.IGNORECASE)
LARGEST_SEED: Final = 2**53 - 1
"""The largest integer that JavaScript represents exactly."""


def play(
    context: typer.Context,
    task: option.OptionalTask = None,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    record: Annotated[Path | None, Option(help="Save each finished episode in this folder.")] = None,
    size: option.Size = 480,
    speed: Annotated[float, Option(min=0.1, max=4.0, help="Times real time.")] = 1.0,
    renderer: option.Renderer = None,
    guess: Annotated[
        bool, Option("--guess", help="Play an intent after two demonstrations, before you see its sentence.")
    ] = False,
    web: Annotated[bool, Option("--web", help="Play in a browser instead of a window.")] = False,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    collect: Annotated[Path | None, Option(help="Save submitted episodes in this folder.")] = None,
    wanted: Annotated[
        int | None, Option(min=1, help="Episodes to collect in each environment.", show_default="no limit")
    ] = None,
    study: Annotated[Path | None, Option(help="The study's settings, a file (.toml).")] = None,
    host: option.Host = "127.0.0.1",
    port: option.Port = 8008,
    origin: Annotated[
        str | None, Option(help="The page's public address behind a proxy, such as https://study.example.org.")
    ] = None,
) -> None:
    """Drive the robot yourself: arrows, space to grip, R to start again, N for the next scene, Esc to quit.

    With --record, finished episodes are saved as demonstrations; D discards one at its end.

    With --guess, you watch two demonstrations of TASK, an intent, or of a random one. Then you do the same in VARIANT.

    With --web, you play in a browser, on this machine or through ssh -L on another one. The options below it need it.
    """
    check_fits(context, not web, "in a window, that is, without --web", "record", "size", "speed", "renderer", "guess")
    check_fits(context, web, "with --web", "tasks", "variants", "collect", "wanted", "study", "host", "port", "origin")
    check_fits(context, study is None, "without --study, since the study sets it", "tasks", "variants", "wanted")
    check_fits(context, task is not None or guess, "with TASK", "seed")
    if web:
        first = None if task is None else (task_name(task), variant_name(variant), seed)
        serve_page(first, environments(tasks, variants), collect, wanted, study, host, port, origin)
        return
    if guess:
        guess_in_window(task, variant, seed, record, size, speed, renderer)
        return
    if task is None:
        raise typer.BadParameter("give TASK, or --web to choose in the browser.")
    browser = "; without one, play in a browser: magical-mj play --web" if task_name(task) in TASKS else ""
    with (
        closing(magical_mj.Engine(task, variant, seed=seed, renderer=renderer)) as env,
        closing(Window(f"{task} {variant_name(variant)}", size, speed, browser)) as window,
    ):
        game = Game(env, task, seed, None if record is None else make_writable_folder(record))
        play_in(window, game, size)


def guess_in_window(
    task: str | None, variant: str, seed: int, record: Path | None, size: int, speed: float, renderer: str | None
) -> None:
    """Shows the demonstrations of an intent, or of a random one, and then plays it without its sentence."""
    from magical_mj.web.puzzles import DEMONSTRATIONS, puzzle_of, puzzles  # imported late: it loads the simulator

    if task is not None and not task_name(task).startswith("intent:"):
        raise typer.BadParameter(f"--guess is for intents, such as intent:dev/3, and {task} is a task.")
    puzzle = secrets.choice(puzzles()) if task is None else puzzle_of(task)
    with closing(Window("What do you want?", size, speed)) as window:
        for number, letters in enumerate(puzzle.demonstrations):
            line = f"Demonstration {number + 1} of {DEMONSTRATIONS}. Then you do the same."
            with closing(magical_mj.Engine(puzzle.task, seed=number, renderer=renderer)) as env:
                if not watch(window, env, actions_of(letters), line, size):
                    return
        with closing(magical_mj.Engine(puzzle.task, variant, seed=seed, renderer=renderer)) as env:
            folder = None if record is None else make_writable_folder(record)
            play_in(window, Game(env, puzzle.task, seed, folder, puzzle), size)


def watch(window: Window, env: Engine, actions: Iterable[int], line: str, size: int) -> bool:
    """Shows an episode. N skips the rest. Returns False if the player quits."""
    for action in actions:
        window.show(side_by_side(env, size), [line, "N skips it, Esc quits"])
        if (wish := window.wish()) in ("next", "quit"):
            return wish == "next"
        env.step(action)
    return True


class Game:
    """Episodes that a person plays one after another. The clock of an episode starts with the first key.

    A finished episode is saved in the folder, if there is one, at once: it is not lost if the window is closed. In a
    puzzle, the goal and the score are shown after the first episode.
    """

    def __init__(self, env: Engine, task: str, seed: int, folder: Path | None, puzzle: Puzzle | None = None) -> None:
        self.env, self._folder, self._screen, self._puzzle = env, folder, console(), puzzle
        summary = task_spec(task).summary
        self.goal = QUESTION if puzzle else f"{summary[0].upper()}{summary[1:]}."
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
        if self._puzzle is not None:
            self.goal = self._puzzle.intent.sentence
            if demo.score < 1.0:
                reached = self._puzzle.reached_instead(self.env.initial_scene, self.env.scene)
                self.remark = f"What you did instead: {reached.sentence}" if reached else ""
            self._screen.print(self.goal, self.remark)
        self._screen.print(f"seed {demo.scene_seed}: {self._result}")
        if self._folder is None:
            return
        path, is_new = magical_mj.demos.keep(demo, self._folder)
        self._screen.print(path, soft_wrap=True)
        self._path = path if is_new else None
        self._result += "; saved, D discards it" if is_new else "; the same episode was saved before"

    def discard(self) -> None:
        """Deletes the episode, if it has ended and was saved."""
        if self._path is not None:
            self._path.unlink()
            self._screen.print(f"discarded {self._path}", soft_wrap=True)
            self._path, self._result = None, "discarded"

    def caption(self) -> str:
        """The state of the episode, and the meaning of the keys."""
        if self._result is not None:
            return f"{self._result}; {AFTER}"
        seconds = ((self.env.horizon or 0) - self._steps) / CONTROL_RATE
        left = f"{seconds:.0f} s" if self._steps else "press a key to start"
        return f"{left} ({KEYS})" if self.goal == QUESTION else f"{left}, score so far {self.env.score():.2f} ({KEYS})"


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


def _check_page(
    first: tuple[str, str, int] | None, environments: Sequence[Pair], collecting: bool, origin: str | None
) -> None:
    """Raises a `SettingsError` unless the page has these environments, and may have this address."""
    is_puzzle = first is not None and first[0].startswith("intent:")
    if not set(environments) <= set(ENVIRONMENTS) or not (first is None or first[0] in TASKS or is_puzzle):
        raise SettingsError("the page has the benchmark's own tasks, and any intent as TASK: play others in a window")
    if first is not None:
        check_seed_in_browser(first[2])
        if not is_puzzle and first[:2] not in environments:
            raise SettingsError(f"{first[0]}-{first[1]} is not among --tasks and --variants")
        if collecting:
            raise SettingsError(
                "with --collect, the server chooses the environments: give --tasks and --variants, not TASK"
            )
    if origin is not None and not ORIGIN.fullmatch(origin):
        raise SettingsError(
            f"--origin must be an address such as https://study.example.org, without a path, not {origin!r}"
        )


def serve_page(
    first: tuple[str, str, int] | None,
    environments: Sequence[Pair],
    collect: Path | None,
    wanted: int | None,
    study: Path | None,
    host: str,
    port: int,
    origin: str | None,
) -> None:
    """Serve until Ctrl-C. `first` is the task, the variant and the seed that the printed link opens."""
    _check_page(first, environments, collect is not None, origin)
    if (wanted is not None or study is not None) and collect is None:
        raise SettingsError(f"{'--wanted' if study is None else '--study'} needs --collect")
    origin = origin and origin.rstrip("/").lower()  # browsers send and compare it in this form
    check_extra("games in a browser", "web")
    from magical_mj.web.collection import Collection, Study, read_study
    from magical_mj.web.puzzles import VARIANTS, puzzle_of, puzzles
    from magical_mj.web.server import PlayServer

    collection = None
    if collect is not None:
        quotas = {f"{task}-{variant}": wanted for task, variant in environments}
        asked = Study(quotas) if study is None else read_study(study)
        environments = list(asked.pairs)
        collection = Collection(make_writable_folder(collect), asked)
    offered, fragment = list(puzzles()), "" if first is None else "#" + "-".join(map(str, first))
    if first is not None and first[0].startswith("intent:"):
        check_name("variant", first[1], VARIANTS)
        puzzle = puzzle_of(first[0])
        offered += [puzzle] * (puzzle not in offered)
        fragment = f"#{puzzle.name}-{first[1]}-{first[2]}{'@expert' if first[1] == 'Demo' else ''}"
    if collection is not None:
        offered = []
    server = PlayServer(environments, host, port, origin=origin, collection=collection, puzzles=offered)
    if collection is not None:
        server.token = collection.token()
    serve_until_interrupted(server, fragment)


def inspect(
    context: typer.Context,
    model: Annotated[str, Argument(metavar="TASK|FILE", help="A task, or an MJCF file (.xml).")],
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    host: option.Host = "127.0.0.1",
    port: option.Port = 8008,
) -> None:
    """Serve a page that simulates a model in 3-D and shows its bodies, joints, contacts, sensors and actuators.

    It prints the page's address. The first time, npm fetches MuJoCo's WebAssembly build and two libraries (5 MB).
    """
    is_file = model.lower().endswith((".xml", ".mjcf"))
    check_fits(context, not is_file, "with TASK", "variant", "seed")
    check_extra("models in a browser", "web")
    from magical_mj.engine.export import mjcf_text  # imported late: it loads the simulator
    from magical_mj.web.inspection import InspectServer, model_files

    if is_file:
        path = Path(model)
        if not path.is_file():
            raise SettingsError(f"the file {path} does not exist")
        files, fragment = model_files(path), "#file"
    else:
        name = f"{task_spec(model).name}-{variant_name(variant)}-{check_seed_in_browser(seed)}"
        if (task_spec(model).name, variant_name(variant)) in ENVIRONMENTS:
            files, fragment = {}, f"#{name}"
        else:
            with closing(magical_mj.Engine(model, variant, seed=seed)) as engine:
                files, fragment = {f"{name}.xml": mjcf_text(engine).encode()}, "#file"
    serve_until_interrupted(InspectServer(ENVIRONMENTS, host, port, model=files), f"inspect.html{fragment}")


def check_seed_in_browser(seed: int) -> int:
    """Returns the seed. Raises a `SettingsError` if JavaScript cannot represent it."""
    if seed > LARGEST_SEED:
        raise SettingsError(f"seeds in a browser are at most {LARGEST_SEED}, not {short_repr(seed)}")
    return seed


def serve_until_interrupted(server: PlayServer, path: str) -> None:
    """Serve until Ctrl-C. The printed link is the server's address followed by `path`."""
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(_serve(server, path))


async def _serve(server: PlayServer, path: str) -> None:
    try:
        started = await server.start()
    except (OSError, UnicodeError) as error:  # a UnicodeError if the host name is invalid
        raise OSError(
            f"cannot listen at this address ({error}); give another --host or --port; --port 0 is a free one"
        ) from error
    async with started as listening:
        console().print(f"{server.address}{path}", soft_wrap=True)
        if server.collection is not None:
            console().print(f"For the operator of the study: {server.operators_address}", soft_wrap=True)
        console().print("Ctrl-C stops the server.")
        await listening.serve_forever()
