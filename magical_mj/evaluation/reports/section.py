"""Sections that additions add to reports: their options, and a folder with a page of their own.

An installed package announces a section by an entry point, ``explain = "magical_mj.intents.explained:ExplainSection"``,
which refers to a subclass of `ReportSection`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

from magical_mj.evaluation.folder import recorded_settings
from magical_mj.evaluation.reports.results import episodes_of
from magical_mj.evaluation.reports.tables import Table, csv
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.tasks.spec import Rules
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.imports import announced, imported
from magical_mj.utils.settings import Settings

if TYPE_CHECKING:
    import pandas as pd

SECTION_GROUP: Final = "magical_mj.report_sections"
"""The entry-point group of sections."""

Write = Callable[[Path, Mapping[EpisodeResult, str]], Path]
"""Writes the files of a section into a folder, over those of an earlier report, and returns its page. The mapping has
the paths of episodes' films, relative to the folder."""


class Prepared(NamedTuple):
    """What a section adds to a report: a folder of its own, and the first tables of the report's page."""

    write: Write
    tables: Sequence[Table] = ()


@dataclass(frozen=True)
class Inputs:
    """The inputs of a section. The first three fields are arguments of `reports.report.report`."""

    folders: Sequence[Path]
    rules: Rules | None
    trusted: Collection[str]
    jobs: int | None
    """The number of worker processes. None: one per core."""
    watch: Callable[[int, int], object]
    """Called with a number of episodes, and the total."""

    def episodes(self) -> Iterator[tuple[Mapping[str, Any], EpisodeResult]]:
        """Each episode of the folders once, with the recorded settings of its evaluation; see `episodes_of`."""
        known = set[tuple[Any, ...]]()
        for folder in self.folders:
            recorded = recorded_settings(folder)
            for episode in episodes_of(folder, self.rules, self.trusted, jobs=self.jobs, watch=self.watch):
                key = episode.method, *episode.key
                if key not in known:  # a folder and its copy hold the same episodes
                    known.add(key)
                    yield recorded, episode


@dataclass(frozen=True, kw_only=True)
class ReportSection(Settings):
    """A section. The fields of a subclass are options of `magical-mj report`."""

    title: ClassVar[str]
    """The text of the report's link."""
    folder: ClassVar[str]
    """The folder of its files in the report."""
    option: ClassVar[str]
    """The option that asks for it."""

    @property
    def wanted(self) -> bool:
        """Whether its option was given."""
        return bool(getattr(self, self.option))

    def prepare(self, inputs: Inputs) -> Prepared:
        """Computes everything that is written later. Errors come before anything is written."""
        raise NotImplementedError


def write_page(page: Path, parts: Iterable[str], tables: Mapping[str, pd.DataFrame]) -> Path:
    """Writes a section's page, with blank lines between its parts, and tables as CSV next to it. Returns the page."""
    page.parent.mkdir(parents=True, exist_ok=True)
    for name, frame in tables.items():
        files.write(page.with_name(name), csv(frame), overwrite=True)
    files.write(page, "\n\n".join(part.strip() for part in parts) + "\n", overwrite=True)
    return page


@cache
def announced_sections() -> tuple[type[ReportSection], ...]:
    """The sections of installed packages."""
    points = announced("report section", SECTION_GROUP, (), str.isidentifier, 'mine = "package.module:MySection"')
    return tuple(imported("report section", name, point, EvaluationError) for name, point in points.items())
