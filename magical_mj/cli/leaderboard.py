"""`magical-mj verify`, `submit` and `leaderboard`: check results by replay, pack them, and make tables of them."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Final

import typer
from rich.console import Console
from rich.progress import MofNCompleteColumn

from magical_mj.cli.console import Bars, Jobs, check_fits, complain, console, make_writable_folder
from magical_mj.evaluation.scores import read
from magical_mj.leaderboard import Findings, check_entry, submit, verify
from magical_mj.leaderboard.check import MOST_REPLAYED, SHARE
from magical_mj.leaderboard.claims import Checked
from magical_mj.leaderboard.duplicates import copied
from magical_mj.leaderboard.entry import Entry, entries
from magical_mj.leaderboard.page import check_free, write_pages
from magical_mj.leaderboard.standings import gaps, standings
from magical_mj.utils.errors import EvaluationError

SHOWN: Final = 20
"""The largest number of problems that are printed; the others are counted."""

Entries = Annotated[Path, typer.Argument(help="The folder with the entries (*.json.xz), or one.", show_default=False)]
Pages = Annotated[Path | None, typer.Option("--out", help="The folder for the pages.", show_default="FOLDER")]
All = Annotated[bool, typer.Option("--all", help="Replay all episodes of each entry, not only a random part.")]
Sample = Annotated[
    int | None, typer.Option("--seed", min=0, help="Chooses the part.", show_default="another each time")
]
Folder = Annotated[Path, typer.Argument(help="The folder of an evaluation.", show_default=False)]
Folders = Annotated[list[Path], typer.Argument(help="Folders of evaluations of one method.", show_default=False)]
Out = Annotated[Path, typer.Option(help="The entry's file, which ends in .json.xz.", show_default=False)]
Card = Annotated[Path | None, typer.Option(help="A TOML file that describes the method; see docs/leaderboard.md.")]
Name = Annotated[
    str | None,
    typer.Option("--policy", help="The method to submit, if the folders hold several or EXTEND calls it otherwise."),
]
Extend = Annotated[Path | None, typer.Option(help="An earlier entry, to whose episodes these are added.")]


def verify_folder(folder: Folder, jobs: Jobs = None) -> None:
    """Replay the episodes of an evaluation, compare scenes and scores, and check that it is complete."""
    screen = console()
    with _bar(screen, f"replaying {folder}", len(read(folder))) as watch:
        found = verify(folder, jobs=jobs, watch=watch)
    screen.print(describe(found), soft_wrap=True)
    if not _complained(str(folder), found):
        screen.print("everything is there, and is what it says")
    else:
        raise typer.Exit(1)


def make_entry(folders: Folders, out: Out, card: Card = None, policy: Name = None, extend: Extend = None) -> None:
    """Pack the evaluations of one method, with its card, into an entry for the leaderboard."""
    make_writable_folder(out.parent)
    entry = submit(folders, out, card=card, policy=policy, extend=extend)
    parts = {name: value if isinstance(value, dict) else {"": value} for name, value in entry.card.items()}
    unsaid = [f"{name}.{inner}".rstrip(".") for name, part in parts.items() for inner in part if part[inner] is None]
    runs = "1 run" if len(entry.runs) == 1 else f"{len(entry.runs)} runs"
    screen = console()
    screen.print(f"{entry.method}: {len(entry.episodes)} episodes of {runs}, {out.stat().st_size / 1e6:.2f} MB")
    if unsaid:
        screen.print(f"the card does not say: {', '.join(unsaid)} (--card)", soft_wrap=True)
    missing = gaps(entry)
    if missing:
        screen.print(f"a partial entry: {', '.join(missing)}", soft_wrap=True)
    screen.print(out, soft_wrap=True)


def make_leaderboard(
    context: typer.Context,
    folder: Entries,
    out: Pages = None,
    everything: All = False,
    seed: Sample = None,
    jobs: Jobs = None,
) -> None:
    """Check all entries in a folder, and write the leaderboard: leaderboard.html and leaderboard.md."""
    check_fits(context, not everything, "without --all", "seed")
    paths, pages = entries(folder), out or (folder.parent if folder.is_file() else folder)
    check_free(make_writable_folder(pages))
    screen = console()
    if not everything:
        seed = secrets.randbits(32) if seed is None else seed
        screen.print(
            f"replaying {SHARE:.0%} of each entry, {MOST_REPLAYED} episodes at most; "
            f"--seed {seed} chooses the same again"
        )
    good, bad = dict[str, Entry](), 0
    for path in paths:
        with _bar(screen, f"checking {path.name}", None) as watch:
            try:
                entry, found = check_entry(path, everything=everything, seed=seed, jobs=jobs, watch=watch)
            except EvaluationError as error:
                complain(str(error))
                bad += 1
                continue
        screen.print(f"{path.name}: {entry.method}; {describe(found)}", soft_wrap=True)
        if _complained(path.name, found):
            bad += 1
        else:
            good[path.name] = entry
    for name, problem in copied(good).items():
        complain(f"{name} is not shown: {problem}")
        del good[name]
        bad += 1
    for page in write_pages(standings(list(good.values())), pages):
        screen.print(page, soft_wrap=True)
    if bad:
        raise EvaluationError(f"entries that are not what they claim, and are not on the page: {bad}")


def describe(found: Findings) -> str:
    """A sentence about the number of replayed episodes and the speed."""
    rate = found.steps / found.seconds if found.seconds else 0.0
    return f"{found.episodes} episodes replayed, {found.steps} steps in {found.seconds:.0f} s ({rate:.0f} steps/s)"


def _complained(name: str, found: Findings) -> bool:
    """Prints the problems, and returns whether there are any."""
    for problems, what in (
        (found.unfit, "does not fit"),
        (found.differing, "differs"),
        (found.missing, "is incomplete"),
    ):
        for problem in problems[:SHOWN]:
            complain(f"{name} {what}: {problem}")
        if len(problems) > SHOWN:
            complain(f"{name} {what}: {len(problems) - SHOWN} more")
    return not found.good


@contextmanager
def _bar(screen: Console, label: str, total: int | None) -> Iterator[Callable[[Checked], None]]:
    with Bars(screen, MofNCompleteColumn(), transient=True) as progress:
        bar = progress.add_task(label, total=total)
        yield lambda checked: progress.update(bar, advance=checked.episodes)
