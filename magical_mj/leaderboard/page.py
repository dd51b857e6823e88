"""The leaderboard as self-contained HTML with charts, and as Markdown."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import jinja2

from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.evaluation.reports.statistics import area, half_lost
from magical_mj.evaluation.reports.tables import DAGGER, NONE, Group, Table, markdown
from magical_mj.leaderboard.entry import SHIFT_SEEDS, Demonstrations, track
from magical_mj.leaderboard.standings import (
    ABOVE,
    BLOCKS,
    COLUMNS,
    COMMON,
    LEAST_RUNS,
    Standing,
    difference,
    improvement,
)
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.escape import terminal

TITLE: Final = "MAGICAL on MuJoCo: leaderboard"
STAR: Final = "★"
UNDECIDED: Final = "?"
"""The mark of a comparison that the interval does not decide."""
INTRODUCTION: Final = (
    "Each entry contains every episode of every run with its actions, and was checked by replaying a sample of them. "
    "Scores are between 0 and 1. An agent learns from demonstrations of one scene (Demo) and is tested with other "
    "poses, colours, shapes, numbers or dynamics. Compare methods within a block, which have the same rules, observe "
    "the same and may use the same kind of help. Methods are in the order of their generalisation, those without "
    f"results in some environments last. {STAR}: official, all {len(ENVIRONMENTS)} environments and {LEAST_RUNS} runs "
    f"or more; {DAGGER}: published, the paper's in the original simulator; all others are partial."
)
USES: Final = "may also use"
HEADINGS: Final = {
    "scores": "Scores",
    "drops": "What breaks first",
    "improvement": "Who beats whom",
    "shifts": "Under shifts",
    "costs": "What it cost",
    "entries": "Entries",
}
SHADED: Final = ("scores", "drops", "improvement", "shifts")
HTML: Final = "leaderboard.html"
MARKDOWN: Final = "leaderboard.md"
BEGINNINGS: Final = {
    HTML: f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{TITLE}</title>\n',
    MARKDOWN: f"# {TITLE}\n",
}
"""The first characters of a page. An earlier page is recognised by them and may be replaced."""
WIDTH: Final = 910  # pixels, as the lengths below
NAMES: Final = 310  # the width of the column with the methods' names
LETTER: Final = 6.3  # the mean width of a letter
ROW: Final = 26  # the height of a method's line


def check_free(out: Path) -> None:
    """Raises an `EvaluationError` if another file in this folder has the name of a page."""
    for name, beginning in BEGINNINGS.items():
        path = out / name
        if path.exists() and not (path.is_file() and path.read_bytes().startswith(beginning.encode())):
            raise EvaluationError(f"{path} is not a page of an earlier leaderboard: move it, or choose another folder")


def write_pages(methods: Sequence[Standing], out: Path) -> list[Path]:
    """Writes both pages into a folder, which must be free, and returns their paths."""
    contents = tables(methods)
    sections = [f"## {HEADINGS[table.name]}\n\n{markdown(table)}" for table in contents]
    pages = {
        HTML: _html(methods, contents),
        MARKDOWN: "\n".join([BEGINNINGS[MARKDOWN], f"{INTRODUCTION}\n", *sections]),
    }
    for name, text in pages.items():
        files.write(out / name, text, overwrite=True)
    return [out / name for name in pages]


class Figure(NamedTuple):
    """A cell with a number: its value, the interval and the share of environments below it, and its shade in %."""

    value: str
    below: tuple[str, ...]
    share: int


class Mark(NamedTuple):
    """A method in the chart: its name, also shortened, its kind, its score, and the interval if it has one."""

    name: str
    short: str
    kind: str
    value: float
    interval: tuple[float, float] | None


def _html(methods: Sequence[Standing], contents: Sequence[Table]) -> str:
    folder = Path(__file__).parent
    # the values are other people's: control characters are escaped first, and then what means something in HTML
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(folder),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        keep_trailing_newline=True,
        finalize=lambda value: terminal(value) if type(value) is str else value,
    )
    return environment.get_template("page.html").render(
        title=TITLE,
        introduction=INTRODUCTION,
        style=(folder / "style.css").read_text(encoding="utf-8"),
        headings=HEADINGS,
        sections={**{table.name: table for table in contents}, "entries": None},
        entered=_entered(methods),
        marks=[_mark(method) for method in methods if method.everywhere],
        shaded=SHADED,
        uses=USES,
        figure_of=_figure,
        x=_x,
        row=ROW,
        width=WIDTH,
        names=NAMES,
    )


def _figure(text: str) -> Figure | None:
    """The parts of a cell. None if it has no number."""
    found = re.fullmatch(r"(-?\d\.\d\d)( \[[\d., -]+\])?( \(\d+/\d+\)| \?)?", text)
    if found is None:
        return None
    return Figure(found[1], tuple(filter(None, found.groups()[1:])), round(60 * min(1.0, abs(float(found[1])))))


def _mark(method: Standing) -> Mark:
    """The generalisation of a method with all environments: above doing nothing."""
    name, most, score = label(method), int((NAMES - 10) / LETTER), method.scores[ABOVE]
    interval = None if math.isnan(score.low) else (score.low, score.high)
    return Mark(name, name if len(name) <= most else f"{name[: most - 1]}…", method.kind, score.value, interval)


def _x(share: float) -> float:
    return round(NAMES + max(share, 0) * (WIDTH - NAMES - 20), 1)


def tables(methods: Sequence[Standing]) -> list[Table]:
    """The tables: scores, drops by variant, probabilities of improvement, shifts if any were played, and costs."""
    shifts = [_shifts(methods)] if any(method.curves for method in methods) else []
    return [_scores(methods), _drops(methods), _improvements(methods), *shifts, _costs(methods)]


def label(method: Standing) -> str:
    """The method's name, with a mark of its kind."""
    return method.name + {"official": f" {STAR}", "partial": "", "published": DAGGER}[method.kind]


def _scores(methods: Sequence[Standing]) -> Table:
    def cells(method: Standing) -> tuple[str, ...]:
        runs = "" if method.kind == "published" else str(len(method.entry.runs))
        return ", ".join(method.privileges), runs, *(shown(method, column) for column in COLUMNS)

    return Table(
        "scores",
        "Mean scores. Memory (Demo, Jitter, Dynamics), distraction (Colour, Shape) and generalisation (Layout, "
        f"CountPlus, All) are means over the {len(COMMON)} tasks that have all variants. Columns of variants are means "
        f"over the tasks that have the variant, with their number if some are missing. {ABOVE}: the generalisation "
        "group's mean of (score - n) / (1 - n), where n is the score of doing nothing. In brackets, 95 % intervals "
        "over scenes and runs; where an environment has one run, over its scenes only",
        ("Method", USES, "runs", *COLUMNS),
        _grouped(methods, cells),
        tuple(f"{method.name} is partial: {', '.join(method.gaps)}." for method in methods if method.gaps),
    )


def shown(method: Standing, column: str) -> str:
    """A score with its interval. If tasks are missing, that of a variant is marked, and other means are left out."""
    lacks = method.lacks(column)
    if lacks and column not in VARIANTS:
        return NONE
    return " ".join(filter(None, (_text(method.scores.get(column)), lacks)))


def _drops(methods: Sequence[Standing]) -> Table:
    def cells(method: Standing) -> tuple[str, ...]:
        drops = (method.drops.get(name) for name in VARIANTS[1:])
        texts = (NONE if drop is None else _text(Estimate(drop)) for drop in drops)
        return shown(method, "Demo"), *texts, method.weakest or NONE

    return Table(
        "drops",
        "Decrease of the mean score from Demo, on the tasks that have the variant; and the variant with the largest "
        "decrease on the tasks that have all variants",
        ("Method", "Demo", *VARIANTS[1:], "falls most in"),
        _grouped(methods, cells),
    )


def _improvements(methods: Sequence[Standing]) -> Table:
    entered = _entered(methods)

    def cell(first: Standing, second: Standing) -> str:
        if first is second or math.isnan(chance := improvement(first, second)):
            return NONE
        return f"{chance:.2f}" + ("" if difference(first, second).decided else f" {UNDECIDED}")

    rows = [(label(method), *(cell(method, other) for other in entered)) for method in entered]
    return Table(
        "improvement",
        "Probability that a run of the method on the left beats one of the method above, over the environments "
        f"that both have played ({NONE} if there are none, or they were scored by different rules). {UNDECIDED}: the "
        "95 % interval of the difference of their mean scores contains 0",
        ("Method", *(method.name for method in entered)),
        (("", tuple(rows)),),
    )


def _shifts(methods: Sequence[Standing]) -> Table:
    def cell(method: Standing, axis: str) -> str:
        if axis not in method.curves:
            return NONE
        tasks, points = method.curves[axis]
        able = sum(f"{axis}:1" in track(task) for task in TASKS)
        return f"{area(points):.2f}" + (f" ({tasks}/{able})" if tasks < able else "")

    def first(method: Standing) -> str:
        halves = {axis: half_lost(points) for axis, (_, points) in method.curves.items()}
        known = {axis: strength for axis, strength in halves.items() if strength is not None}
        return min((f"{axis}:{strength}" for axis, strength in known.items()), key=lambda text: text[-1], default=NONE)

    entered = [method for method in methods if method.curves]
    return Table(
        "shifts",
        f"Mean score in Demo over strengths 0 to {STRENGTHS} of each shift (the area under the curve), in the scenes "
        f"of seeds 0 to {SHIFT_SEEDS - 1}, with the number of tasks if some are missing; and the shift that halves the "
        "score at the lowest strength",
        ("Method", *SHIFTS, "half lost first"),
        _grouped(entered, lambda method: (*(cell(method, axis) for axis in SHIFTS), first(method))),
    )


def _costs(methods: Sequence[Standing]) -> Table:
    def cells(method: Standing) -> tuple[str, ...]:
        card = method.entry.card
        training, data = card.training, card.demonstrations
        sees = "no observations" if method.entry.observations is None else method.entry.observations or "both views"
        facts = (sees, data.per_task, _set(data), training.hours, training.device, training.steps, card.hardware)
        texts = (NONE if fact is None else " ".join(str(fact).split()) for fact in facts)
        return shown(method, ABOVE), *texts

    return Table(
        "costs",
        f"The cost of a run ({NONE} if the entry does not state it), and what the policy observes",
        ("Method", ABOVE, "looks at", "demonstrations per task", "of set", "hours", "device", "steps", "hardware"),
        _grouped(_entered(methods), cells),
    )


def _set(data: Demonstrations) -> str | None:
    """The number of the shipped demonstrations, with the set if it is not the protocol's."""
    if data.set is None or data.loaded_set == 1:
        return None if data.set is None else str(data.set)
    return f"{data.set}, load(set={data.loaded_set})"


def _entered(methods: Sequence[Standing]) -> list[Standing]:
    return [method for method in methods if method.kind != "published"]


def _grouped(methods: Sequence[Standing], cells: Callable[[Standing], tuple[str, ...]]) -> tuple[Group, ...]:
    """The rows of methods by their blocks, without empty blocks."""
    groups = []
    for block, heading in BLOCKS.items():
        rows = tuple((label(method), *cells(method)) for method in methods if method.block == block)
        if rows:
            groups.append((heading, rows))
    return tuple(groups)


def _text(estimate: Estimate | None) -> str:
    if estimate is None or math.isnan(estimate.value):
        return NONE
    interval = "" if math.isnan(estimate.low) else f" [{estimate.low:.2f}, {estimate.high:.2f}]"
    return f"{estimate.value:.2f}{interval}".replace("-0.00", "0.00")
