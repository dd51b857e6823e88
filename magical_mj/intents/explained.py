"""Explanations: which goals the episodes of evaluations pursued, in tables, files and pictures."""

from __future__ import annotations

import io
import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Final, TypeVar
from urllib.parse import quote

import numpy as np
from msgspec import Meta
from numpy.typing import NDArray
from PIL import Image

from magical_mj.evaluation.replay import engine_for
from magical_mj.evaluation.reports.section import Inputs, Prepared, ReportSection, write_page
from magical_mj.evaluation.reports.tables import Table, markdown
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.attribution import (
    FAILURES,
    Attribution,
    LastSolvable,
    attribute,
    last_solvable_steps,
    shown_task,
    task_rivals,
    unfit,
)
from magical_mj.intents.first_blocks import first_block_table
from magical_mj.intents.readings import ENDINGS
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.registry import EVERY_VARIANT, TASKS, task_spec
from magical_mj.utils import escape, files
from magical_mj.utils.errors import SettingsError, counted
from magical_mj.utils.settings import Natural

PAGE: Final = "explained.md"
SHOWN: Final = 5
"""The number of rivals in a table of the page; rivals.csv has all."""
EXAMPLES: Final = 3
MOST_REASONS: Final = 8
"""The most reasons for unexplained episodes that the page lists."""
SIDE: Final = 128  # pixels; of a scene
GAP: Final = 8  # pixels
NONE: Final = "none of the rivals"
ENVIRONMENT: Final = ("method", "task", "variant")
"""Most tables group episodes by these fields."""

Result = TypeVar("Result", Attribution, LastSolvable)


@dataclass
class Explanation:
    """The attributions of episodes, the last solvable steps of failed ones, and the reasons why others are missing."""

    attributions: list[Attribution] = field(default_factory=list[Attribution])
    last_solvable: list[LastSolvable] = field(default_factory=list[LastSolvable])
    problems: Counter[str] = field(default_factory=Counter[str])


def explain(inputs: Inputs, lost: int = 0) -> Explanation:
    """Replays the episodes of the inputs, and explains them.

    For `lost` unsolved episodes of each method, task and variant, the last solvable step is found, which takes seconds
    each.

    Raises:
        SettingsError: if no episode can be explained.
    """
    found, episodes, jobs = Explanation(), list[EpisodeResult](), inputs.jobs
    for recorded, episode in inputs.episodes():
        if problem := unfit(episode, recorded, inputs.trusted):
            found.problems[problem] += 1
        else:
            episodes.append(episode)
    if not episodes:
        raise SettingsError(f"--explain: no episode can be explained: {next(iter(found.problems), 'there are none')}")
    for done, result in enumerate(attribute(episodes, jobs=jobs), start=1):
        inputs.watch(done, len(episodes))
        if isinstance(result, Attribution):
            found.attributions.append(result)
        else:
            episode, problem = result
            found.problems[f"{episode.method}, {episode.title}: {problem}"] += 1
    found.attributions.sort(key=lambda result: _order(result.episode))
    if lost:
        wanted = [group[:lost] for group in _grouped(_failed(found.attributions), *ENVIRONMENT).values()]
        found.last_solvable = list(last_solvable_steps([result for group in wanted for result in group], jobs=jobs))
        found.last_solvable.sort(key=lambda result: _order(result.episode))
    return found


def write_explanation(found: Explanation, out: Path, films: Mapping[EpisodeResult, str] = MappingProxyType({})) -> Path:
    """Writes the page, its pictures, and two files of numbers into a folder, over those of an earlier report.

    `films` are the paths of episodes' films, relative to the folder. Returns the path of the page.
    """
    import pandas as pd

    out.mkdir(parents=True, exist_ok=True)
    parts = [
        "# Which goal did a policy pursue?",
        "A block was moved if it ended more than 0.15 from where it began. Columns without any episode are left out.",
        *_problems(found.problems),
        "## Endings",
        markdown(_endings(found.attributions)),
        *([markdown(_lost(found.last_solvable))] if found.last_solvable else []),
        "## Rivals that unsolved episodes reached",
    ]
    for (method, _, _), group in _grouped(_failed(found.attributions), "method", "task", "given").items():
        task = shown_task(group[0].episode)
        parts += [f"### {escape.markdown(method)}, {escape.markdown(task)}", *_rivals(group, out, films)]
    endings, rivals = pd.DataFrame(_ending_rows(found.attributions)), pd.DataFrame(_rival_rows(found.attributions))
    return write_page(out / PAGE, parts, {"endings.csv": endings, "rivals.csv": rivals})


def _problems(problems: Counter[str]) -> list[str]:
    """How many episodes are not explained for each reason. Rare reasons are counted together."""
    lines = [
        f"- {counted(number, 'episode')} not explained: {escape.markdown(why)}"
        for why, number in problems.most_common(MOST_REASONS)
    ]
    rest = problems.total() - sum(number for _, number in problems.most_common(MOST_REASONS))
    return lines + ([f"- {counted(rest, 'episode')} not explained for other reasons"] if rest else [])


def shares(group: Sequence[Attribution]) -> dict[str, float]:
    """The mean shares of the endings of some episodes."""
    return {name: sum(result.ending.get(name, 0.0) for result in group) / len(group) for name in ENDINGS}


def _endings(results: Sequence[Attribution]) -> Table:
    shown = [name for name in ENDINGS if any(name in result.ending for result in results)]
    groups = []
    for (method,), own in _grouped(results, "method").items():
        environments = {" ".join(pair): group for pair, group in _grouped(own, "task", "variant").items()}
        demo = [result for result in own if result.episode.variant == "Demo"]
        others = [result for result in own if result.episode.variant != "Demo"]
        rows, sums = [], {"all Demo": demo, "all others": others} if demo and others else {"all": own}
        for environment, group in {**environments, **sums}.items():
            means = shares(group)
            rows.append((environment, str(len(group)), *(_percent(means[name]) for name in shown)))
        groups.append((method, tuple(rows)))
    caption = "Shares of episodes by what they did (per cent). An episode that fits several columns is shared equally"
    return Table("endings", caption, ("Environment", "episodes", *shown), tuple(groups), _definitions(ENDINGS, shown))


def _definitions(known: Mapping[str, str], shown: Iterable[str]) -> tuple[str, ...]:
    return tuple(f"{name}: {known[name]}." for name in shown)


def _lost(results: Sequence[LastSolvable]) -> Table:
    shown = [name for name in FAILURES if any(result.failure == name for result in results)]
    groups = []
    for (method,), own in _grouped(results, "method").items():
        rows = []
        for (task,), group in _grouped(own, "task").items():
            kinds = Counter(result.failure for result in group)
            last = [result.last / len(result.episode.actions) for result in group if result.last is not None]
            middle = f"{np.median(last):.2f}" if last else ""
            rows.append((task, str(len(group)), *(_percent(kinds[name] / len(group)) for name in shown), middle))
        groups.append((method, tuple(rows)))
    header = ("Task", "unsolved episodes", *shown, "last solvable")
    caption = (
        "Unsolved episodes by what went wrong (per cent), and the last step from which the expert still solves them "
        "(median, as a share of the horizon)"
    )
    return Table("lost", caption, header, tuple(groups), _definitions(FAILURES, shown))


def _rivals(group: Sequence[Attribution], out: Path, films: Mapping[EpisodeResult, str]) -> list[str]:
    """The table and the pictures of one method and task. A sentence instead of a table if the task has no rivals."""
    task, method = shown_task(group[0].episode), group[0].episode.method
    variants = _grouped(group, "variant")
    rows, pictures = list[tuple[str, ...]](), list[str]()
    for number, alike in enumerate(_listed(group), start=1):
        sentence = _sentence(task, alike)
        rows.append(
            (
                sentence,
                *(_percent(_mean_share(some, alike)) for some in (group, *variants.values())),
                _percent(sum(_share(result, alike) > 0 for result in group) / len(group)),
            )
        )
        scenes = "".join(f"-{word}" for word in re.findall(r"[a-z0-9]+", task.partition(" [")[2]))
        name = f"{method}-{task_spec(task).name}{scenes}-{number}.png".replace("/", "-")
        reached = [result for result in group if _share(result, alike)]
        examples = sorted(reached, key=lambda result: -_share(result, alike))[:EXAMPLES]
        files.write(out / name, _png([_pair(result.episode) for result in examples]), overwrite=True)
        pictures += [f"![{sentence}]({quote(name)})", _about(sentence, examples, films)]
    header = ("Rival", "all", *(variant for (variant,) in variants), "reached by")
    caption = f"Shares of {counted(len(group), 'unsolved episode')} (per cent)"
    notes = [
        "Rival: another goal that the demonstrations reach. An episode reached it if only its end satisfies it.",
        "all and the variants: an episode counts once, shared among the rivals that it reached with weights 2^-bits.",
        "reached by: the share of episodes that reached it, whatever else they reached.",
    ]
    left = [result.remaining for result in group if not result.rivals]
    if left:
        which = "episodes without a reached rival" if task_rivals(task) else "unsolved episodes"
        notes.append(
            f"In {which}, the moves that the task's plan still has are {np.mean(left):.2f} world units long (mean)."
        )
    if not task_rivals(task):
        return [f"This task has no rivals. {notes[-1]}", *pictures]
    return [markdown(Table("rivals", caption, header, (("", tuple(rows)),), tuple(notes))), *pictures]


def _listed(group: Sequence[Attribution]) -> list[tuple[int, ...]]:
    """The rivals of a table, the largest share first. Rivals that the same episodes reached form one row.

    The empty row at the end is for the episodes that reached none.
    """
    reached = defaultdict[int, list[int]](list)
    for number, result in enumerate(group):
        for rival in result.rivals:
            reached[rival].append(number)
    alike = defaultdict[tuple[int, ...], list[int]](list)
    for rival in sorted(reached):
        alike[tuple(reached[rival])].append(rival)
    classes = sorted(map(tuple, alike.values()), key=lambda rivals: (-round(_mean_share(group, rivals), 9), rivals))
    return classes[:SHOWN] + ([()] if not all(result.rivals for result in group) else [])


def _about(sentence: str, examples: Sequence[Attribution], films: Mapping[EpisodeResult, str]) -> str:
    """What a picture shows."""
    parts = []
    for result in examples:
        episode = result.episode
        text = f"{episode.variant}, seed {episode.seed}, run {episode.run}"
        film = films.get(episode)
        parts.append(escape.markdown_link(f"{text} (film)", quote(film)) if film else escape.markdown(text))
    return f"{escape.markdown(sentence)} First and last scenes: {'; '.join(parts)}."


def _ending_rows(results: Sequence[Attribution]) -> list[dict[str, object]]:
    return [
        {"policy": method, "task": task, "variant": variant, "episodes": len(group), **shares(group)}
        for (method, task, variant), group in _grouped(results, *ENVIRONMENT).items()
    ]


def _rival_rows(results: Sequence[Attribution]) -> list[dict[str, object]]:
    """A row for each method, environment and reached rival, and one for the episodes that reached none."""
    rows: list[dict[str, object]] = []
    for (method, task, variant, _), group in _grouped(_failed(results), *ENVIRONMENT, "given").items():
        shown = shown_task(group[0].episode)
        total, reached = Counter[int | None](), Counter[int | None]()
        for result in group:
            total.update(result.rivals or {None: 1.0})
            reached.update(result.rivals.keys() or [None])
        for rival, share in sorted(total.items(), key=lambda item: (-item[1], -1 if item[0] is None else item[0])):
            intent = None if rival is None else task_rivals(shown)[rival]
            rows.append(
                {
                    "policy": method,
                    "task": task,
                    "variant": variant,
                    "failed": len(group),
                    "rival": NONE if intent is None else str(intent),
                    "sentence": "" if intent is None else intent.sentence,
                    "bits": float("nan") if intent is None else intent.bits,
                    "share": share / len(group),
                    "reached": reached[rival] / len(group),
                }
            )
    return rows


def _pair(episode: EpisodeResult) -> NDArray[np.uint8]:
    """The first and the last scene of an episode side by side, drawn by the software renderer."""
    with closing(engine_for(episode, "software")) as engine:
        before = engine.render("allo", SIDE)
        for action in actions_of(episode.actions):
            engine.step(action)
        gap = np.full((SIDE, GAP // 4, 3), 255, np.uint8)
        return np.concatenate([before, gap, engine.render("allo", SIDE)], axis=1)


def _png(pairs: Sequence[NDArray[np.uint8]]) -> bytes:
    """Pictures side by side, as a file."""
    gap = np.full((SIDE, 2 * GAP, 3), 255, np.uint8)
    row = [part for pair in pairs for part in (gap, pair)][1:]
    content = io.BytesIO()
    Image.fromarray(np.concatenate(row, axis=1)).save(content, "png")
    return content.getvalue()


def _grouped(results: Iterable[Result], *fields: str) -> dict[tuple[str, ...], list[Result]]:
    """The results by these fields of their episodes."""
    groups = defaultdict[tuple[str, ...], list[Result]](list)
    for result in results:
        groups[tuple(getattr(result.episode, name) for name in fields)].append(result)
    return groups


def _failed(results: Iterable[Attribution]) -> list[Attribution]:
    return [result for result in results if result.episode.score < 1.0]


def _order(episode: EpisodeResult) -> tuple[object, ...]:
    task = TASKS.index(episode.task) if episode.task in TASKS else len(TASKS)
    variant = EVERY_VARIANT.index(episode.variant)
    return episode.method, task, episode.task, variant, episode.seed, episode.run


def _share(result: Attribution, rivals: Sequence[int]) -> float:
    """The share of these rivals in an episode. If `rivals` is empty: 1 if the episode reached none, else 0."""
    if not rivals:
        return float(not result.rivals)
    return sum(result.rivals.get(rival, 0.0) for rival in rivals)


def _mean_share(results: Sequence[Attribution], rivals: Sequence[int]) -> float:
    return sum(_share(result, rivals) for result in results) / len(results)


def _sentence(task: str, rivals: Sequence[int]) -> str:
    """The simplest of these rivals in English, and the number of others. Without `rivals`: that none was reached."""
    if not rivals:
        return "None of the rivals." if task_rivals(task) else "Unsolved episodes."
    others = counted(len(rivals) - 1, "other")
    alike = f" (and {others}, reached by the same episodes)" if len(rivals) > 1 else ""
    return f"{task_rivals(task)[rivals[0]].sentence[:-1]}{alike}."


def _percent(share: float) -> str:
    return f"{100 * share:.0f}" if share else ""


@dataclass(frozen=True, kw_only=True)
class ExplainSection(ReportSection):
    """The options `--explain` and `--last-solvable` of `magical-mj report`."""

    title = "Which goal did a policy pursue?"
    folder = "explained"
    option = "explain"

    explain: Annotated[
        bool, Meta(description="Replay all episodes, and say which other goals failed ones reached: docs/explain.md.")
    ] = False
    last_solvable: Annotated[
        Natural,
        Meta(
            description="With --explain: for so many failed episodes of each policy, task and variant, the last step "
            "from which the expert still solves it. Each takes seconds."
        ),
    ] = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.last_solvable and not self.explain:
            raise SettingsError("--last-solvable has an effect only with --explain")

    def prepare(self, inputs: Inputs) -> Prepared:
        """Explains the episodes; see `explain`, `first_block_table` and `write_explanation`."""
        found = explain(inputs, self.last_solvable)
        return Prepared(partial(write_explanation, found), [*first_block_table(found.attributions)])
