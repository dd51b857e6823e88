"""`magical-mj report` and `compare`: the commands that use stored results."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer
from rich.table import Table
from typer import Argument, Option

from magical_mj.cli import option
from magical_mj.cli.console import check_fits, complain, console, counting, make_writable_folder
from magical_mj.cli.film import by_file_name, film_episodes
from magical_mj.evaluation.folder import folders_of, other_format, recorded_settings
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.reports.report import begin, extremes, write_report
from magical_mj.evaluation.reports.results import compare, episodes_of, results
from magical_mj.evaluation.reports.section import Inputs, ReportSection, announced_sections
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import SettingsError, counted
from magical_mj.utils.extras import check_extra
from magical_mj.utils.settings import described

Side = Annotated[str, Argument(help="DIR, or DIR:POLICY if the folder holds several policies.")]


def make_report(
    context: typer.Context,
    folders: option.Folders,
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
    jobs: option.Jobs = None,
    rules: Annotated[
        Rules | None,
        Option(help="Score all episodes by these rules; those scored by others are replayed, which can take minutes."),
    ] = None,
    trusted: option.Trusted = "",
    **options: Any,
) -> None:
    """Write a report of one or several evaluations: tables (Markdown, CSV), figures, videos and explanations."""
    folders = folders_of(folders)
    if out is None and (len(folders) > 1 or other_format(folders[0])):
        raise typer.BadParameter("only the report of a single evaluation has a default folder: give --out.")
    check_extra("reports", "eval")
    wanted = [section for section in sections_of(options) if section.wanted]
    replays = " or ".join([*(f"--{kind.option}" for kind in SECTIONS), "--rules"])
    check_fits(context, bool(wanted) or rules is not None, f"with {replays}", "jobs")
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
    prepared = []
    for section in wanted:
        with counting(screen, "replaying episodes") as watch:
            prepared.append(section.prepare(Inputs(folders, rules, may_name, jobs, watch)))
    out = make_writable_folder(out or folders[0] / "report")
    replaced = begin(out, [*by_file_name(episodes), *(section.folder for section in wanted)])
    links = film_episodes(episodes, out)
    films = {score: f"../{name}" for name, (_, score) in by_file_name(episodes).items()}
    for section, (write, _) in zip(wanted, prepared, strict=True):
        links = {section.title: f"{section.folder}/{write(out / section.folder, films).name}", **links}
    page = write_report(data, out, links, [table for one in prepared for table in one.tables])
    screen.print(f"{page} replaces an earlier report" if replaced else page, soft_wrap=True)


SECTIONS: Final = announced_sections()
option.add_options(make_report, *SECTIONS)


def sections_of(options: Mapping[str, Any]) -> list[ReportSection]:
    """The sections with these options."""
    return [kind(**{name: options[name] for name in described(kind)}) for kind in SECTIONS]


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
