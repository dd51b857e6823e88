"""`magical-mj serve` and `collect`: play in a browser, and collect demonstrations in a study."""

from __future__ import annotations

import asyncio
import contextlib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer
from typer import Argument, Option

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, console, make_writable_folder
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair, environments, task_name, variant_name
from magical_mj.utils.errors import SettingsError, check_name, short_repr
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.web.server import PlayServer

ORIGIN: Final = re.compile(r"https?://([\w.-]+|\[[\da-f:.]+\])(:\d+)?/*", re.IGNORECASE)
LARGEST_SEED: Final = 2**53 - 1
"""The largest integer that JavaScript represents exactly."""

Host = Annotated[str, Option(help="The address to listen on.")]
Port = Annotated[int, Option(min=0, max=65535, help="The port to listen on; 0: any free one.")]
Origin = Annotated[
    str | None, Option(help="The page's public address behind a proxy, such as https://study.example.org.")
]


def serve(
    context: typer.Context,
    task: option.OptionalTask = None,
    variant: option.Variant = "Demo",
    seed: option.Seed = 0,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    host: Host = "127.0.0.1",
    port: Port = 8008,
    origin: Origin = None,
) -> None:
    """Play in a browser, on this machine or through ssh -L on another one.

    The printed address opens the scene of TASK, VARIANT and SEED, or a choice among --tasks and --variants.
    """
    check_fits(context, task is not None, "with TASK", "seed")
    check_extra("games in a browser", "web")
    from magical_mj.web.puzzles import VARIANTS, puzzle_of, puzzles  # imported late: it loads the simulator
    from magical_mj.web.server import PlayServer

    offered = environments(tasks, variants)
    puzzle, fragment = None, ""
    if task is not None:
        first = task_name(task), variant_name(variant), check_seed_in_browser(seed)
        fragment = "#" + "-".join(map(str, first))
        if first[0].startswith("intent:"):
            check_name("variant", first[1], VARIANTS)
            puzzle = puzzle_of(first[0])
            fragment = f"#{puzzle.name}-{first[1]}-{seed}{'@expert' if first[1] == 'Demo' else ''}"
        elif first[0] not in TASKS:
            raise SettingsError(ONLY_OWN)
        elif first[:2] not in offered:
            raise SettingsError(f"{first[0]}-{first[1]} is not among --tasks and --variants")
    check_environments(offered)
    address = checked_origin(origin)
    listed = list(puzzles())
    if puzzle is not None and puzzle not in listed:
        listed.append(puzzle)
    serve_until_interrupted(PlayServer(offered, host, port, origin=address, puzzles=listed), fragment)


def collect(
    out: Annotated[Path, Argument(help="The folder for the submitted episodes.")],
    context: typer.Context,
    tasks: option.Tasks = "all",
    variants: option.Variants = "all",
    wanted: Annotated[
        int | None, Option(min=1, help="Episodes to collect in each environment.", show_default="no limit")
    ] = None,
    study: Annotated[Path | None, Option(help="The study's settings, a file (.toml).")] = None,
    host: Host = "127.0.0.1",
    port: Port = 8008,
    origin: Origin = None,
) -> None:
    """Collect demonstrations of people who play in their browsers. The server chooses the environment of each."""
    check_fits(context, study is None, "without --study, since the study sets it", "tasks", "variants", "wanted")
    pairs = environments(tasks, variants)
    check_environments(pairs)
    address = checked_origin(origin)
    check_extra("games in a browser", "web")
    from magical_mj.web.collection import Collection  # imported late: it loads the simulator
    from magical_mj.web.server import PlayServer
    from magical_mj.web.study import Study, read_study

    asked = Study({f"{task}-{variant}": wanted for task, variant in pairs}) if study is None else read_study(study)
    collection = Collection(make_writable_folder(out), asked)
    server = PlayServer(list(asked.pairs), host, port, origin=address, collection=collection)
    server.token = collection.token()
    serve_until_interrupted(server, "")


ONLY_OWN: Final = "the page has the benchmark's own tasks, and any intent as TASK: play others in a window"


def check_environments(environments: Sequence[Pair]) -> None:
    """Raises a `SettingsError` unless the page has these environments."""
    if not set(environments) <= set(ENVIRONMENTS):
        raise SettingsError(ONLY_OWN)


def checked_origin(origin: str | None) -> str | None:
    """The public address in the form that browsers send and compare."""
    if origin is not None and not ORIGIN.fullmatch(origin):
        raise SettingsError(
            f"--origin must be an address such as https://study.example.org, without a path, not {origin!r}"
        )
    return origin and origin.rstrip("/").lower()


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
