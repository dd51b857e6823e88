"""`magical-mj play --web`: the page in a browser, with the simulation in Python."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final
from urllib.parse import urlsplit

import typer

from magical_mj.cli.console import console, make_writable_folder
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair
from magical_mj.utils.errors import SettingsError, shown
from magical_mj.utils.extras import missing_extra

if TYPE_CHECKING:
    from magical_mj.web.server import PlayServer

LARGEST_SEED: Final = 2**53 - 1
"""The largest integer that JavaScript counts exactly."""

PANEL = "In a browser (--web)"
Tasks = Annotated[str, typer.Option(help="Names with commas between.", rich_help_panel=PANEL)]
Variants = Annotated[str, typer.Option(help="Names with commas between.", rich_help_panel=PANEL)]
Collect = Annotated[
    Path | None,
    typer.Option(help="Keep what people send in this folder.", rich_help_panel=PANEL, show_default=False),
]
Wanted = Annotated[
    int | None,
    typer.Option(
        min=1, help="How many to collect of each environment.", rich_help_panel=PANEL, show_default="as many as come"
    ),
]
Host = Annotated[str, typer.Option(help="Address to listen at.", rich_help_panel=PANEL)]
Port = Annotated[int, typer.Option(min=0, max=65535, help="0: any that is free.", rich_help_panel=PANEL)]
Origin = Annotated[
    str | None,
    typer.Option(
        help="Where people see the page, such as https://study.example.org, behind a proxy.",
        rich_help_panel=PANEL,
        show_default=False,
    ),
]


def serve_page(
    first: tuple[str, str, int] | None,
    environments: Sequence[Pair],
    collect: Path | None,
    wanted: int | None,
    host: str,
    port: int,
    origin: str | None,
) -> None:
    """Serve until somebody presses Ctrl-C; `first` is the task, the variant and the seed that the link leads to."""
    if not set(environments) <= set(ENVIRONMENTS):
        raise SettingsError("the page knows the scores of the benchmark's own tasks only: play others in a window")
    if first is not None and first[:2] not in environments:
        own = first[0] not in TASKS
        reason = "not a task of the benchmark, whose scores alone the page knows: play it in a window"
        raise SettingsError(f"{first[0]}-{first[1]} is {reason if own else 'not among --tasks and --variants'}")
    if first is not None and first[2] > LARGEST_SEED:
        raise SettingsError(f"seeds in a browser are at most {LARGEST_SEED}, not {shown(first[2])}")
    if first is not None and collect is not None:
        raise SettingsError("with --collect the server chooses what is played: give --tasks and --variants, not TASK")
    if wanted is not None and collect is None:
        raise SettingsError("--wanted needs --collect")
    if origin is not None:
        origin = _checked(origin)
    try:
        from magical_mj.web.collection import Collection
        from magical_mj.web.server import PlayServer
    except ModuleNotFoundError:
        raise missing_extra("Playing in a browser", "web") from None
    collection = None if collect is None else Collection(make_writable_folder(collect), environments, wanted)
    server = PlayServer(environments, host, port, origin=origin, collection=collection)
    if collection is not None:
        server.token = collection.token()
    with suppress(KeyboardInterrupt):
        asyncio.run(_serve(server, "" if first is None else "#" + "-".join(map(str, first))))


def _checked(origin: str) -> str:
    """An origin as browsers send it, without a slash at its end; they compare it letter by letter."""
    try:
        parts = urlsplit(origin)
    except ValueError:  # half of a bracket
        parts = urlsplit("")
    if parts.scheme not in ("http", "https") or not parts.netloc or parts.path.strip("/") or parts.query:
        raise SettingsError(
            f"--origin takes an address such as https://study.example.org, without a path; not {origin!r}"
        )
    return f"{parts.scheme}://{parts.netloc.lower()}"


async def _serve(server: PlayServer, place: str) -> None:
    try:
        started = await server.start()
    except (OSError, UnicodeError) as error:  # the latter for names that no host can have
        raise OSError(
            f"cannot listen there ({error}); give another --host or --port; --port 0 is a free one"
        ) from error
    async with started as listening:
        console().print(f"{server.address}{place}\nCtrl-C ends it.", soft_wrap=True)
        await listening.serve_forever()
