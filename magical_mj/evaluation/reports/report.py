"""Reports: tables, figures and a page that shows them, made from the files of evaluations only."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final
from urllib.parse import quote

from magical_mj.evaluation.reports.figures import bars, heat_map
from magical_mj.evaluation.reports.results import Results, results
from magical_mj.evaluation.reports.tables import APPROXIMATE, csv, latex, markdown, result_tables
from magical_mj.evaluation.scores import EpisodeResult, folders_of
from magical_mj.utils import escape, files
from magical_mj.utils.errors import EvaluationError, counted
from magical_mj.utils.extras import check_extra

PAGE: Final = "report.md"
TITLE: Final = "# Evaluation"
DPI: Final = 150
FIGURES: Final = ("bars.png", "heat_map.png")
FILES: Final = {
    "Means over tasks as CSV": "variants.csv",
    "All environments as CSV": "environments.csv",
    "Means over tasks as LaTeX": "variants.tex",
    "Interquartile means as LaTeX": "interquartile.tex",
    "All environments as LaTeX": "environments.tex",
    "Bars as PDF": "bars.pdf",
    "Heat map as PDF": "heat_map.pdf",
}


def check_free(out: Path, others: Sequence[str] = ()) -> bool:
    """Whether a folder, which need not exist, holds an earlier report.

    Args:
        out: the folder.
        others: the names of files that will be made beside those of every report.

    Raises:
        EvaluationError: if there is none, but files that have names of ours.
    """
    page = out / PAGE
    if page.is_file() and page.read_bytes().startswith(f"{TITLE}\n\n".encode()):
        return True
    for name in (PAGE, *FIGURES, *FILES.values(), *others):
        if (out / name).exists():
            raise EvaluationError(f"{out / name} is not of an earlier report: move it, or choose another folder")
    return False


def begin(out: Path, others: Sequence[str] = ()) -> bool:
    """Begins the page, if there is none: by it, the files of a report that was interrupted are known as ours.

    Arguments, result and errors are those of `check_free`, but the folder must exist.
    """
    replaced = check_free(out, others)
    if not replaced:
        files.write(out / PAGE, f"{TITLE}\n\nThis report is not finished yet.\n")
    return replaced


def report(
    folders: Iterable[Path | str],
    out: Path | str,
    *,
    with_published: bool = False,
    mixed_presets: bool = False,
    links: Mapping[str, str] = MappingProxyType({}),
) -> Path:
    """Writes the tables (Markdown, CSV, LaTeX) and figures of some evaluations.

    Args:
        folders: the folders of the evaluations.
        out: the folder for the report; files of an earlier report are replaced.
        with_published: show the paper's results as well.
        mixed_presets: allow policies with different observations in one report.
        links: description -> file in `out`, for links on the page.

    Returns:
        The path of the page, in Markdown.

    Raises:
        SettingsError: if a single folder is given instead of several.
        EvaluationError: if a folder is not an evaluation, two of them cannot be combined, or `out` holds files with
            the names of the report's that are not of an earlier one.
        MissingExtraError: if an extra is missing.
    """
    check_extra("reports", "eval")
    return write_report(results(folders_of(folders), with_published, mixed_presets), out, links)


def write_report(data: Results, out: Path | str, links: Mapping[str, str] = MappingProxyType({})) -> Path:
    """The part of `report` that writes the files; see there."""
    out = Path(out)
    tables = result_tables(data)
    out.mkdir(parents=True, exist_ok=True)
    begin(out)
    parts = [
        TITLE,
        *(f"**{note}**" for note in tables[0].notes if note.startswith(APPROXIMATE)),
        _settings(data),
        "## Variants",
        *map(markdown, tables[:2]),
        "![Mean scores over tasks](bars.png)",
        "## Environments",
        "![Mean scores](heat_map.png)",
        *map(markdown, tables[2:]),
        "## Files",
        "\n".join(f"- {escape.markdown_link(text, quote(name))}" for text, name in {**links, **FILES}.items()),
    ]
    page = out / PAGE
    files.write(page, "\n\n".join(part.strip() for part in parts) + "\n", overwrite=True)
    texts = {"variants.csv": csv(data.variants), "environments.csv": csv(data.environments)}
    for name, text in {**texts, **{f"{table.name}.tex": latex(table) for table in tables}}.items():
        files.write(out / name, text, overwrite=True)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")  # of methods in other scripts
        for name, figure in {"bars": bars(data), "heat_map": heat_map(data)}.items():
            for suffix in ("png", "pdf"):
                with files.new_file(out / f"{name}.{suffix}", overwrite=True) as path:
                    figure.savefig(path, dpi=DPI, metadata=None if suffix == "png" else {"CreationDate": None})
    return page


def _settings(data: Results) -> str:
    """What was played, in a paragraph."""
    scores = data.scores
    presets = ", ".join(map(escape.markdown_code, scores["preset"].dropna().unique()))
    count = scores["policy"].nunique()
    methods = "one method" if count == 1 else f"{count} methods"
    environments = len(scores[["task", "variant"]].drop_duplicates())
    return (
        f"{counted(len(scores), 'episode')} of {methods} in {counted(environments, 'environment')}; "
        f"scores by the rules {escape.markdown_code(scores['rules'].iloc[0])}; "
        f"observations: {presets or 'none needed'}; "
        + escape.markdown(
            f"magical_mj {', '.join(scores['version'].unique())}, MuJoCo {', '.join(scores['mujoco'].unique())}."
        )
    )


def extremes(scores: Iterable[EpisodeResult]) -> list[tuple[str, EpisodeResult]]:
    """The episodes for videos: the best and the worst of each policy and task (the first of equals), if they differ."""
    best: dict[tuple[str, str], EpisodeResult] = {}
    worst: dict[tuple[str, str], EpisodeResult] = {}
    for score in scores:
        key = score.policy, score.task
        if score.actions:
            if score.score > best.setdefault(key, score).score:
                best[key] = score
            if score.score < worst.setdefault(key, score).score:
                worst[key] = score
    chosen: list[tuple[str, EpisodeResult]] = []
    for key, score in best.items():
        chosen.append(("best", score))
        if worst[key].score < score.score:
            chosen.append(("worst", worst[key]))
    return chosen
