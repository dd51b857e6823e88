"""`magical-mj report`, `compare`, `verify`, `submit` and `leaderboard`: the commands that use stored results."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Annotated, Final

import msgspec
import typer
from rich.table import Table
from typer import Argument, Option

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, complain, console, counting, make_writable_folder
from magical_mj.cli.film import by_file_name, film_episodes
from magical_mj.evaluation.entry import entry_files, is_entry
from magical_mj.evaluation.folder import recorded_settings
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.reports import explained
from magical_mj.evaluation.reports.report import begin, extremes, write_report
from magical_mj.evaluation.reports.results import compare, episodes_of, results
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.leaderboard import Entry, Findings, check_entries, read_entry, submit, verify
from magical_mj.leaderboard.check import MOST_REPLAYED, SHARE
from magical_mj.leaderboard.page import check_free, write_pages
from magical_mj.leaderboard.standings import gaps, standings
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import EvaluationError, SettingsError, counted
from magical_mj.utils.extras import check_extra

SHOWN: Final = 20
"""The largest number of problems that are printed. The others are counted."""

Folders = Annotated[list[Path], Argument(help="The folders of evaluations, or entries of the leaderboard.")]
Side = Annotated[str, Argument(help="DIR, or DIR:POLICY if the folder holds several policies.")]


def make_report(
    context: typer.Context,
    folders: Folders,
    out: Annotated[
        Path | None, Option(help="The folder for the report.", show_default="DIR/report, for a single DIR")
    ] = None,
    published: Annotated[bool, Option("--published", help="Show the paper's own results as well.")] = False,
    mixed_presets: Annotated[
        bool, Option("--mixed-presets", help="Allow policies with different observations in one report.")
    ] = False,
    videos: Annotated[
        bool, Option("--videos", help="Make videos of each policy's best and worst episode in each task.")
    ] = False,
    explain: Annotated[
        bool,
        Option("--explain", help="Replay all episodes, and say which goals failed ones pursued; see docs/explain.md."),
    ] = False,
    last_solvable: Annotated[
        int,
        Option(
            min=0,
            help="With --explain: for so many failed episodes of each policy, task and variant, the last step from "
            "which the expert still solves it. Each takes seconds.",
        ),
    ] = 0,
    jobs: option.Jobs = None,
    rules: Annotated[
        Rules | None,
        Option(help="Score all episodes by these rules; those scored by others are replayed, which can take minutes."),
    ] = None,
    trusted: option.Trusted = "",
) -> None:
    """Write a report of one or several evaluations: tables (Markdown, CSV), figures, videos and explanations."""
    if out is None and (len(folders) > 1 or is_entry(folders[0])):
        raise typer.BadParameter("only the report of a single evaluation has a default folder: give --out.")
    check_extra("reports", "eval")
    check_fits(context, explain, "with --explain", "last_solvable")
    check_fits(context, explain or rules is not None, "with --explain or --rules", "jobs")
    screen = console()
    may_name = trusted.split(",")
    with counting(screen, "replaying episodes") as watch:  # raises errors before anything is written
        data = results(folders, published, mixed_presets, rules, may_name, jobs=jobs, watch=watch)
    episodes = []
    if videos:
        check_extra("videos", "video")
        episodes, refused = _to_film(folders, rules, may_name)
        if not episodes and refused:
            raise SettingsError(f"--videos: {refused[0]}")
        for problem in refused:
            complain(problem)
    found = None
    if explain:
        with counting(screen, "replaying episodes") as watch:
            found = explained.explain(folders, rules, may_name, lost=last_solvable, jobs=jobs, watch=watch)
    out = make_writable_folder(out or folders[0] / "report")
    replaced = begin(out, [*by_file_name(episodes), *([explained.FOLDER] if explain else [])])
    links = film_episodes(episodes, out)
    if found is not None:
        films = {score.key: f"../{name}" for name, (_, score) in by_file_name(episodes).items()}
        explained.write_explanation(found, out / explained.FOLDER, films)
        links = {"Which goal did a policy pursue?": f"{explained.FOLDER}/{explained.PAGE}", **links}
    page = write_report(data, out, links)
    screen.print(f"{page} replaces an earlier report" if replaced else page, soft_wrap=True)


def _to_film(
    folders: list[Path], rules: Rules | None, trusted: Collection[str]
) -> tuple[list[tuple[str, EpisodeResult]], list[str]]:
    """The episodes for videos, and the reasons why others cannot be filmed, one for each method, folder and cause."""
    refused: dict[str, None] = {}

    def replayable() -> Iterator[EpisodeResult]:
        for folder in folders:
            recorded = recorded_settings(folder)
            for score in episodes_of(folder, rules, trusted):
                if problem := obstacle(score, recorded, trusted):
                    refused[f"{score.policy} in {folder} cannot be filmed: {problem}"] = None
                else:
                    yield score

    return extremes(replayable()), list(refused)


def make_comparison(a: Side, b: Side) -> None:
    """Compare two policies on the scenes that both have played: A - B, with its 95 % interval."""
    comparison = compare(a, b)
    names = comparison.attrs["policies"]
    if names[0] == names[1]:
        names = a, b
    screen = console()
    table = Table("variant", *names, "difference", "95 %", "better", "worse", "scenes", box=None, header_style="bold")
    for column in table.columns[1:]:
        column.justify = "right"
    for row in comparison.to_dict("records"):
        interval = f"[{row['low']:+.3f}, {row['high']:+.3f}]" if row["low"] == row["low"] else "-"
        means = (f"{row[side]:.3f}" for side in ("first", "second"))
        counts = (str(row[name]) for name in ("better", "worse", "scenes"))
        table.add_row(row["variant"], *means, f"{row['difference']:+.3f}", interval, *counts)
    screen.print(table)
    if (split := comparison.attrs["split"]) != "test":
        screen.print(f"on the split {split}: not by the official protocol")
    if (comparison["runs"] == 1).any():
        screen.print("one run: the intervals cover scenes, not the randomness of training")
    unpaired = comparison["unpaired"].iloc[-1]
    if unpaired:
        screen.print(f"without {counted(unpaired, 'scene')} that only one of them has played")


def verify_folders(folders: Folders, jobs: option.Jobs = None, trusted: option.Trusted = "") -> None:
    """Replay the episodes of an evaluation, compare scenes and scores, and check that it is complete."""
    screen, names = console(), ", ".join(map(str, folders))
    with counting(screen, f"replaying {names}") as watch:
        findings = verify(*folders, jobs=jobs, watch=watch, trusted=trusted.split(","))
    screen.print(f"{counted(findings.episodes, 'episode')} replayed")
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
    seed: Annotated[int | None, Option(min=0, help="The seed of the sample.", show_default="random")] = None,
    jobs: option.Jobs = None,
) -> None:
    """Check all entries in a folder, and write the leaderboard: leaderboard.html and leaderboard.md."""
    check_extra("leaderboards", "eval")
    check_fits(context, not everything, "without --all", "seed", "replay")
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
    good: dict[str, Entry] = {}
    for name, entry in entries.items():
        replayed = counted(findings[name].episodes, "episode")
        screen.print(f"{name}: {entry.method}; {replayed} replayed", soft_wrap=True)
        owner = next((other for other in good if good[other].method == entry.method), None)
        if owner is not None and good[owner].rules == entry.rules:
            complain(f"{name} is not shown: {owner} has a method of the same name, {entry.method}")
        elif not _printed_problems(name, findings[name]):
            good[name] = entry
    for page in write_pages(standings(list(good.values())), out):
        screen.print(page, soft_wrap=True)
    if bad := len(paths) - len(good):
        raise EvaluationError(f"entries that failed the checks and are not on the page: {bad}")


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
