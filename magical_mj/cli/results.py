"""`magical-mj report` and `compare`: results of evaluations as tables, figures and videos."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from magical_mj.cli.console import Trust, console, make_writable_folder
from magical_mj.cli.film import film, replay
from magical_mj.evaluation.reports.report import begin, extremes, write_report
from magical_mj.evaluation.reports.results import compare, results
from magical_mj.evaluation.scores import EpisodeResult, episodes_in
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.extras import check_extra

FILM_SIZE = 192  # pixels
FILM_SPEED = 4  # times real time

Folders = Annotated[list[Path], typer.Argument(help="The folders of evaluations.", show_default=False)]
Out = Annotated[
    Path | None, typer.Option(help="The folder for the report.", show_default="DIR/report, of a single DIR")
]
Published = Annotated[bool, typer.Option("--published", help="Show the paper's own results as well.")]
Mixed = Annotated[
    bool, typer.Option("--mixed-presets", help="Allow policies with different observations in one report.")
]
Side = Annotated[
    str, typer.Argument(help="DIR, or DIR:POLICY if the folder holds several policies.", show_default=False)
]
Videos = Annotated[
    bool, typer.Option("--videos", help="Make videos of each policy's best and worst episode in each task.")
]


def make_report(
    folders: Folders,
    out: Out = None,
    published: Published = False,
    mixed_presets: Mixed = False,
    videos: Videos = False,
    trust: Trust = False,
) -> None:
    """Write a report of one or several evaluations: tables (Markdown, CSV, LaTeX), figures and videos."""
    del trust  # see magical_mj.utils.imports.command_line
    if out is None and len(folders) > 1:
        raise typer.BadParameter("several folders have one report: give --out, its folder.")
    check_extra("reports", "eval")
    screen = console()
    data = results(folders, published, mixed_presets)  # raises errors before anything is written
    if videos and set(data.scores["worlds"]) != {"single"}:
        raise SettingsError(f"--videos replays episodes of single worlds only, not of batched ones: {UNOFFICIAL}")
    if videos:
        check_extra("videos", "video")
    out = make_writable_folder(out or folders[0] / "report")
    chosen = extremes(score for folder in folders for score in episodes_in(folder)) if videos else []
    replaced = begin(out, film_names(chosen))
    page = write_report(data, out, film_episodes(chosen, out))
    screen.print(f"{page} replaces an earlier report" if replaced else page, soft_wrap=True)


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
    unpaired = comparison["unpaired"].iloc[-1]
    if unpaired:
        screen.print(f"{unpaired} scenes that only one of them has played are left out")


def film_names(chosen: Sequence[tuple[str, EpisodeResult]]) -> list[str]:
    """The names of the videos that `film_episodes` makes."""
    names: list[str] = []
    for which, score in chosen:
        name = f"{which}-{score.policy}-{score.task}.mp4".replace("/", "-")
        names.append(f"{len(names)}-{name}" if name in names else name)  # of a method called a-b after one called a/b
    return names


def film_episodes(chosen: Sequence[tuple[str, EpisodeResult]], out: Path) -> dict[str, str]:
    """Makes videos of episodes, each given with a word such as "best"; returns description -> file name."""
    links: dict[str, str] = {}
    for name, (which, score) in zip(film_names(chosen), chosen, strict=True):
        with film(out / name, FILM_SIZE, FILM_SPEED, overwrite=True) as video:
            replay(video, score)
        links[
            f"{score.policy}, {which} of {score.task}: {score.variant}, seed {score.seed}, score {score.score:.2f}"
        ] = name
    return links
