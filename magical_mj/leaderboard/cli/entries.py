"""`magical-mj verify`, `submit` and `leaderboard`: checks by replaying, entries, and the page."""

from __future__ import annotations

import secrets
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer
from typer import Argument, Option

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, complain, console, counting, make_writable_folder
from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.leaderboard import Entry, Findings, check_entries, read_entry, submit, verify
from magical_mj.leaderboard.check import MOST_REPLAYED, SHARE
from magical_mj.leaderboard.entry import entry_files
from magical_mj.leaderboard.names import appearance
from magical_mj.leaderboard.page import check_free, signed, write_pages
from magical_mj.leaderboard.rerun import LARGEST_SEED, PER_SET, SCENES, rerun, stored_policies
from magical_mj.leaderboard.standings import gaps, standings
from magical_mj.utils.errors import EvaluationError, MagicalError, counted
from magical_mj.utils.extras import check_extra

SHOWN: Final = 20
"""The largest number of problems that are printed. The others are counted."""


def verify_folders(folders: option.Folders, jobs: option.Jobs = None, trusted: option.Trusted = "") -> None:
    """Replay the episodes of an evaluation, compare scenes and scores, and check that it is complete."""
    screen, names = console(), ", ".join(map(str, folders))
    with counting(screen, f"replaying {names}") as watch:
        findings = verify(*folders, jobs=jobs, watch=watch, trusted=trusted.split(","))
    screen.print(f"{counted(findings.episodes, 'episode')} replayed")
    if findings.solved:
        screen.print(f"the scene starts with score 1 in {'; '.join(findings.solved)}", soft_wrap=True)
    if _printed_problems(names, findings):
        raise typer.Exit(1)
    screen.print("complete, and all scores are confirmed")


def make_entry(
    folders: Annotated[list[Path], Argument(help="Folders of evaluations of one method.")],
    out: Annotated[Path, Option(help="The entry's file, ending in .json.xz.")],
    card: Annotated[Path | None, Option(help="A TOML file that describes the method; see docs/leaderboard.md.")] = None,
    policy: Annotated[str | None, Option(help="The method to submit, if the folders hold several.")] = None,
) -> None:
    """Pack the evaluations of one method, with its card, into an entry for the leaderboard."""
    make_writable_folder(out.parent)
    entry = submit(folders, out, card=card, policy=policy)
    facts = msgspec.to_builtins(entry.card)
    parts = {name: value if isinstance(value, dict) else {"": value} for name, value in facts.items()}
    unsaid = [f"{name}.{inner}".rstrip(".") for name, part in parts.items() for inner in part if part[inner] is None]
    size = out.stat().st_size / 1e6
    screen = console()
    episodes, runs = counted(len(entry.episodes), "episode"), counted(len(entry.runs), "run")
    screen.print(f"{entry.method}: {episodes} of {runs}, {size:.2f} MB")
    if unsaid:
        screen.print(f"the card lacks: {', '.join(unsaid)} (--card)", soft_wrap=True)
    missing = gaps(entry)
    if missing:
        screen.print(f"a partial entry: {', '.join(missing)}", soft_wrap=True)
    screen.print(out, soft_wrap=True)


def make_leaderboard(
    context: typer.Context,
    folder: Annotated[Path, Argument(help="The folder with the entries (*.json.xz), or one.")],
    out: Annotated[Path, Option(help="The folder for the pages.")] = Path("out/leaderboard"),
    replay: Annotated[int, Option(min=1, help="The most episodes of an entry to replay.")] = MOST_REPLAYED,
    everything: Annotated[
        bool, Option("--all", help="Replay all episodes of each entry, not only a random sample.")
    ] = False,
    again: Annotated[
        bool, Option("--rerun", help="Play the policies that entries hold in fresh scenes, and compare the scores.")
    ] = False,
    scenes: Annotated[int, Option(min=2, help="With --rerun: fresh scenes in each environment of tasks.")] = SCENES,
    intents: Annotated[
        int, Option(min=1, help="With --rerun: intents of each set, drawn at random; a fresh scene in each variant.")
    ] = PER_SET,
    seed: Annotated[int | None, Option(min=0, help="The seed of the samples.", show_default="random")] = None,
    jobs: option.Jobs = None,
) -> None:
    """Check all entries in a folder, and write the leaderboard: leaderboard.html and leaderboard.md."""
    check_extra("leaderboards", "eval")
    check_fits(context, not everything, "without --all", "replay")
    check_fits(context, again, "with --rerun", "scenes", "intents")
    check_fits(context, again or not everything, "without --all, or with --rerun", "seed")
    paths = entry_files(folder)
    check_free(make_writable_folder(out))
    screen = console()
    seed = secrets.randbits(32) if seed is None else seed
    if not everything:
        screen.print(
            f"replaying {SHARE:.0%} of each entry, {counted(replay, 'episode')} at most; "
            f"--seed {seed} repeats this sample"
        )
    entries: dict[str, Entry] = {}
    for path in paths:
        try:
            entries[path.name] = read_entry(path)
        except EvaluationError as error:
            complain(str(error))
    with counting(screen, "replaying episodes") as watch:
        findings = check_entries(entries, most=None if everything else replay, seed=seed, jobs=jobs, watch=watch)
    good, reruns = _good(entries, findings), dict[str, dict[str, Estimate]]()
    for path in paths if again else ():
        if path.name not in good:
            continue
        sizes = {"first_seed": seed % LARGEST_SEED, "scenes": scenes, "per_set": intents}
        if found := _rerun(path, good[path.name], jobs, sizes):
            reruns[path.name] = found
            if any(one.decided for one in found.values()):
                complain(f"{path.name} differs: its policies do not score as the entry says")
                del good[path.name]
    for page in write_pages(standings(good, reruns), out):
        screen.print(page, soft_wrap=True)
    if bad := len(paths) - len(good):
        raise EvaluationError(f"entries that failed the checks and are not on the page: {bad}")


def _good(entries: Mapping[str, Entry], findings: Mapping[str, Findings]) -> dict[str, Entry]:
    """The entries without problems, by name. Prints the problems. Of methods with alike names, the first one stays."""
    good: dict[str, Entry] = {}
    for name, entry in entries.items():
        replayed = counted(findings[name].episodes, "episode")
        console().print(f"{name}: {entry.method}; {replayed} replayed", soft_wrap=True)
        alike = appearance(entry.method)
        owner = next((other for other in good if appearance(good[other].method) == alike), None)
        if owner is not None and good[owner].rules == entry.rules:
            complain(f"{name} is not shown: {owner} has a method whose name reads the same, {entry.method}")
        elif not _printed_problems(name, findings[name]):
            good[name] = entry
    return good


def _rerun(path: Path, entry: Entry, jobs: int | None, sizes: Mapping[str, int]) -> dict[str, Estimate]:
    """The results of the policies in an entry's folder. Empty if there are none, or they cannot be played."""
    screen = console()
    try:
        policies = stored_policies(path)
        if not policies:
            screen.print(f"{path.name}: no policies to re-run", soft_wrap=True)
            return {}
        with counting(screen, f"re-running {path.name}") as watch:
            found = rerun(entry, policies, jobs=jobs, watch=watch, **sizes)
    except MagicalError as error:  # also those of an intent, of a demonstration or of the renderer
        complain(f"{path.name} cannot be re-run: {error}")
        return {}
    first = f"in fresh scenes from {sizes['first_seed']} on"
    for what, difference in found.items():
        screen.print(f"{path.name}: re-run {first}: {what}: {signed(difference)}", soft_wrap=True)
    return found


def _printed_problems(name: str, findings: Findings) -> bool:
    """Prints the problems. Returns whether there are any."""
    for problems, what in (
        (findings.unfit, "does not fit"),
        (findings.differing, "differs"),
        (findings.missing, "is incomplete"),
    ):
        for problem in problems[:SHOWN]:
            complain(f"{name} {what}: {problem}")
        if len(problems) > SHOWN:
            complain(f"{name} {what}: {len(problems) - SHOWN} more")
    return not findings.good
