"""Success at the end and at any time, and the steps to success. Episodes are replayed, and scored after each step.

The benchmark's score counts only the last state. Other benchmarks count an episode as solved if it was solved at any
time. Success means a score of 1.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import numpy as np
from msgspec import Meta

from magical_mj.evaluation.replay import engine_for, in_chunks, obstacle, replay_problem
from magical_mj.evaluation.reports.intervals import Estimate, mean_over
from magical_mj.evaluation.reports.section import Inputs, Prepared, ReportSection, write_page
from magical_mj.evaluation.reports.statistics import by_run_and_scene
from magical_mj.evaluation.reports.tables import NONE, Table, markdown
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.tasks.registry import EVERY_VARIANT, in_order
from magical_mj.utils.errors import SettingsError, counted
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    import pandas as pd

PAGE: Final = "success.md"
ENVIRONMENT: Final = ["task", "variant", "shift"]

First = tuple[EpisodeResult, int | None, str | None]
"""An episode, the number of steps until its score was 1 for the first time, and the problem of its replay."""


def first_successes(episodes: Iterable[EpisodeResult], *, jobs: int | None = None) -> Iterator[First]:
    """Replays episodes without an `obstacle`, in order of completion. None: the score was never 1."""
    chunks = [[episode for _, episode in chunk] for chunk in in_chunks(("", episode) for episode in episodes)]
    results = map(_replay, chunks) if jobs == 1 or len(chunks) < 2 else map_unordered(_replay, chunks, jobs)
    for result in results:
        yield from result


def _replay(chunk: Sequence[EpisodeResult]) -> list[First]:
    """Replays episodes of one environment in this process."""
    results = list[First]()
    with closing(engine_for(chunk[0])) as engine:
        for episode in chunk:
            engine.reset(seed=None if episode.seed == engine.seed else episode.seed)
            solved = [0] if episode.failure is None and engine.score() == 1.0 else []

            def note(step: int, solved: list[int] = solved) -> None:
                if not solved and engine.score() == 1.0:
                    solved.append(step)

            problem = replay_problem(episode, engine, note)
            results.append((episode, next(iter(solved), None), problem))
    return results


def frame_of(results: Iterable[First]) -> pd.DataFrame:
    """A row for each episode, with its score, and the steps to success (NaN without success)."""
    import pandas as pd

    rows = [
        {
            "policy": episode.method,
            **{name: getattr(episode, name) for name in ("run", *ENVIRONMENT, "seed", "score")},
            "steps_to_success": np.nan if first is None else float(first),
        }
        for episode, first, _ in results
    ]
    frame = pd.DataFrame(rows)
    ranks = {"task": in_order(frame["task"]), "variant": list(EVERY_VARIANT)}
    return frame.sort_values(
        ["policy", *ENVIRONMENT, "run", "seed"],
        key=lambda column: column.map(ranks[column.name].index) if column.name in ranks else column,
        ignore_index=True,
    )


def table(frame: pd.DataFrame) -> Table:
    """The table of the page: a group for each method, with a row for each environment and one for all."""
    groups = []
    for policy, own in frame.groupby("policy", sort=False):
        rows = [_row(" ".join(filter(None, place)), [group]) for place, group in own.groupby(ENVIRONMENT, sort=False)]
        plain = [group for (*_, shift), group in own.groupby(ENVIRONMENT, sort=False) if not shift]
        rows += [_row("all without shifts" if own["shift"].any() else "all", plain)] if len(plain) > 1 else []
        groups.append((str(policy), tuple(rows)))
    return Table(
        "success",
        "The share of episodes with score 1 at the end and at any time, with its 95 % interval, and the median number "
        "of steps to the first success, where there was one",
        ("Environment", "episodes", "at the end", "at any time", "steps to success"),
        tuple(groups),
    )


def _row(name: str, environments: Sequence[pd.DataFrame]) -> tuple[str, ...]:
    ended = _share(environments, lambda rows: rows["score"] == 1.0)
    ever = _share(environments, lambda rows: rows["steps_to_success"].notna())
    steps = np.concatenate([rows["steps_to_success"].dropna() for rows in environments])
    middle = f"{np.median(steps):.0f}" if len(steps) else NONE
    return name, str(sum(map(len, environments))), ended, ever, middle


def _share(environments: Sequence[pd.DataFrame], solved: Callable[[pd.DataFrame], pd.Series[bool]]) -> str:
    """The mean over environments with its interval."""
    cells = [
        (rows["task"].iloc[0], number, by_run_and_scene(rows.assign(score=solved(rows).astype(float))))
        for number, rows in enumerate(environments)
    ]
    mean: Estimate = mean_over(cells)
    return f"{mean.value:.2f}" if np.isnan(mean.low) else f"{mean.value:.2f} [{mean.low:.2f}, {mean.high:.2f}]"


def write_success(frame: pd.DataFrame, problems: Counter[str], out: Path, _: Mapping[EpisodeResult, str]) -> Path:
    """Writes the page and success.csv, with a row for each episode, into a folder. Returns the path of the page."""
    left = [f"- {counted(number, 'episode')} left out: {why}" for why, number in problems.most_common()]
    return write_page(out / PAGE, ["# Success", *left, markdown(table(frame))], {"success.csv": frame})


@dataclass(frozen=True, kw_only=True)
class SuccessSection(ReportSection):
    """The option `--success` of `magical-mj report`."""

    title = "Success at any time"
    folder = "success"
    option = "success"

    success: Annotated[
        bool, Meta(description="Success at the end and at any time, and steps to success; episodes are replayed.")
    ] = False

    def prepare(self, inputs: Inputs) -> Prepared:
        """Replays all episodes."""
        problems, playable, found = Counter[str](), list[EpisodeResult](), list[First]()
        for recorded, episode in inputs.episodes():
            if problem := obstacle(episode, recorded, inputs.trusted):
                problems[problem] += 1
            else:
                playable.append(episode)
        for done, result in enumerate(first_successes(playable, jobs=inputs.jobs), start=1):
            inputs.watch(done, len(playable))
            if problem := result[2]:
                problems[f"{result[0].title}: {problem}"] += 1
            else:
                found.append(result)
        if not found:
            raise SettingsError(f"--success: no episode can be replayed: {next(iter(problems), 'there are none')}")
        return Prepared(partial(write_success, frame_of(found), problems))
