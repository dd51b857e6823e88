"""The leaderboard as self-contained HTML with charts, and as Markdown."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from importlib.resources import files as resources
from pathlib import Path
from typing import Final

from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.evaluation.reports.statistics import area, half_lost
from magical_mj.evaluation.reports.tables import DAGGER, NONE, Group, Table, markdown
from magical_mj.leaderboard.entry import SHIFT_SEEDS, Demonstrations
from magical_mj.leaderboard.places import track
from magical_mj.leaderboard.standings import (
    ABOVE,
    BLOCKS,
    COLUMNS,
    COMMON,
    LEAST_RUNS,
    NEW_PLACES,
    Standing,
    difference,
    floor,
    improvement,
    repetition,
)
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.utils import files
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.escape import html

TITLE: Final = "MAGICAL on MuJoCo: leaderboard"
STAR: Final = "★"
UNDECIDED: Final = "?"
"""The mark of a comparison that the interval does not decide."""
INTRODUCTION: Final = (
    "Each entry contains every episode of every run with its actions, and was checked by replaying a sample of them. "
    "Scores are between 0 and 1. An agent learns from demonstrations of one scene (Demo) and is tested with other "
    "poses, colours, shapes, numbers or dynamics. Compare methods within a category: they have the same rules, observe "
    "the same and may use the same kind of help. Methods are in the order of their generalisation, those without "
    f"results in some environments last. {STAR}: official, all {len(ENVIRONMENTS)} environments, all test intents, or "
    f"both, and {LEAST_RUNS} runs or more, with authors and commands, and re-run; {DAGGER}: published, the paper's in "
    "the original simulator; all others are partial. Replayed: the actions lead to the scores, but anybody can tape an "
    "expert. Re-run: the entry's policies also played fresh scenes on this machine, of intents a sample, and the 95 % "
    "interval of the difference contains 0. Repeated: others trained it again, in another entry, and the 95 % interval "
    "of the difference in tasks contains 0."
)
USES: Final = "may also use"
HEADINGS: Final = {
    "scores": "Scores",
    "drops": "What breaks first",
    "improvement": "Who beats whom",
    "shifts": "Under shifts",
    "intents": "Intents",
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


def _html(methods: Sequence[Standing], contents: Sequence[Table]) -> str:
    contents_of = {table.name: _table(table) for table in contents}
    contents_of["scores"] = intervals(methods) + contents_of["scores"]
    contents_of["entries"] = "".join(map(_card, _entered(methods)))
    sections = "\n".join(
        f'<section id="{name}"><h2>{HEADINGS[name]}</h2>{content}</section>' for name, content in contents_of.items()
    )
    links = " ".join(f'<a href="#{name}">{HEADINGS[name]}</a>' for name in contents_of)
    style = (resources("magical_mj.leaderboard") / "style.css").read_text(encoding="utf-8")
    return (
        f"{BEGINNINGS[HTML]}"
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<style>\n{style}</style></head>\n<body><header><h1>{TITLE}</h1><p>{INTRODUCTION}</p>\n"
        f"<nav>{links}</nav></header>\n<main>\n{sections}</main></body></html>\n"
    )


def _table(table: Table) -> str:
    head = "".join(f"<th>{html(name)}</th>" for name in table.header)
    body = ""
    for heading, rows in table.groups:
        if heading:
            body += f'<tr><th class="group" colspan="{len(table.header)}">{html(heading)}</th></tr>'
        for method, *cells in rows:
            figures = "".join(
                chips(cell) if name == USES else _cell(cell, table.name in SHADED)
                for name, cell in zip(table.header[1:], cells, strict=True)
            )
            body += f"<tr><th>{html(method)}</th>{figures}</tr>"
    notes = "".join(f"<li>{html(note)}</li>" for note in table.notes)
    caption = html(table.caption)
    return (
        f'<p class="caption">{caption}.</p><div class="wide" tabindex="0" role="region" aria-label="{caption}">'
        f"<table><thead><tr>{head}</tr></thead>"
        f"<tbody>{body}</tbody></table></div><ul>{notes}</ul>"
    )


def chips(text: str) -> str:
    """A table cell with a chip for each privilege."""
    spans = " ".join(f"<span>{html(name)}</span>" for name in text.split(", ") if name)
    return f'<td class="chips">{spans}</td>'


def _cell(text: str, shaded: bool) -> str:
    """A table cell. A number has its interval and its share of the environments below it, and a shade by its size."""
    figure = re.fullmatch(r"(-?\d\.\d\d)( \[[\d., -]+\])?( \(\d+/\d+\)| \?)?", text)
    if figure is None:
        return f"<td>{html(text)}</td>"
    share = round(60 * min(1.0, abs(float(figure[1])))) if shaded else 0
    below = "".join(f"<small>{part}</small>" for part in figure.groups()[1:] if part)
    return f'<td class="figure" style="--share: {share}%">{figure[1]}{below}</td>'


def _card(method: Standing) -> str:
    """The declarations of an entry's card."""
    entry, card = method.entry, method.entry.card
    links = " ".join(f'<a href="{html(link)}">{html(link)}</a>' for link in card.links or ())
    recorded = entry.recorded
    facts = {
        "by": card.authors,
        "checked": method.level,
        "in fresh scenes": "; ".join(f"{what}: {signed(found)}" for what, found in method.rerun.items()),
        "uses": ", ".join(recorded.uses),
        "loaded from": ", ".join(recorded.loaded),
        "a step takes": None if recorded.milliseconds is None else f"{recorded.milliseconds:g} ms",
        "other data": card.demonstrations.other,
        "runs": ", ".join(map(str, entry.runs)),
        "episodes": len(entry.episodes),
        "protocol": entry.protocol,
        "magical_mj": ", ".join(entry.versions.version),
        "MuJoCo": ", ".join(entry.versions.mujoco),
    }
    items = "".join(f"<dt>{name}</dt><dd>{html(fact)}</dd>" for name, fact in facts.items() if fact)
    text = html(card.description or "")
    repeat = f"<p>Repeat it:</p><pre>{html(lines)}</pre>" if (lines := "\n".join(card.commands or ())) else ""
    return f"<article><h3>{html(method.name)}</h3><p>{text} {links}</p><dl>{items}</dl>{repeat}</article>"


def signed(difference: Estimate) -> str:
    """A difference and its interval, with their signs."""
    return "{:+.2f} [{:+.2f}, {:+.2f}]".format(*difference)


def intervals(methods: Sequence[Standing]) -> str:
    """The generalisation of each method with all environments: above the floor, a dot with its interval."""
    methods = [method for method in methods if method.everywhere]
    height = ROW * (len(methods) + 1)
    rows = _grid(height - ROW)
    for index, method in enumerate(methods):
        score, y = method.scores[ABOVE], ROW * (index + 0.5)
        rows += _name(label(method), NAMES - 10, y + 4)
        if not math.isnan(score.low):
            rows += f'<line class="{method.kind}" x1="{_x(score.low)}" x2="{_x(score.high)}" y1="{y}" y2="{y}"/>'
        rows += f'<circle class="{method.kind}" cx="{_x(score.value)}" cy="{y}" r="5"/>'
    title = "Generalisation above the floor, with 95 % intervals"
    picture = f'<svg viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{title}">{rows}</svg>'
    box = f'<div class="wide" tabindex="0" role="region" aria-label="{title}">{picture}</div>'
    return f'<p class="caption">{title}.</p>{box}'


def _name(name: str, right: float, y: float) -> str:
    """A method's name, shortened if it is long, ending at the position `right`."""
    most = int(right / LETTER)
    short = name if len(name) <= most else f"{name[: most - 1]}…"
    whole = f"<title>{html(name)}</title>" if short != name else ""
    return f'<text x="{right}" y="{y:.0f}" text-anchor="end">{html(short)}{whole}</text>'


def _grid(height: float) -> str:
    lines = ""
    for tick in range(0, 11, 2):
        x = _x(tick / 10)
        lines += f'<line class="grid" x1="{x}" x2="{x}" y1="0" y2="{height}"/>'
        lines += f'<text x="{x}" y="{height + 16}" text-anchor="middle">{tick / 10:g}</text>'
    return lines


def _x(share: float) -> float:
    return round(NAMES + max(share, 0) * (WIDTH - NAMES - 20), 1)


def tables(methods: Sequence[Standing]) -> list[Table]:
    """The tables: scores, drops by variant, probabilities of improvement, costs; shifts and intents if any were played.

    Methods that played only intents are in the last two.
    """
    scored = [method for method in methods if method.means]
    shifts = [_shifts(scored)] if any(method.curves for method in scored) else []
    intents = [table] if (table := _intents(methods)).groups else []
    return [_scores(scored), _drops(scored), _improvements(scored), *shifts, *intents, _costs(methods)]


def label(method: Standing) -> str:
    """The method's name, with a mark of its kind."""
    return method.name + {"official": f" {STAR}", "partial": "", "published": DAGGER}[method.kind]


def _scores(methods: Sequence[Standing]) -> Table:
    def cells(method: Standing) -> tuple[str, ...]:
        runs = "" if method.kind == "published" else str(len(method.entry.runs))
        return ", ".join(method.privileges), method.level, runs, *(shown(method, column) for column in COLUMNS)

    return Table(
        "scores",
        f"Mean scores. {NEW_PLACES}: in the scenes where it is wrong to move what stands where the demonstrations "
        f"moved something, or to end where they ended ({len(COLUMNS[NEW_PLACES])} environments). {ABOVE}: the "
        "generalisation group's mean of (score - f) / (1 - f), where f is the environment's floor: the best mean score "
        "of doing nothing, random actions and replaying a demonstration. Memory (Demo, Jitter, Dynamics), distraction "
        f"(Colour, Shape) and generalisation (Layout, CountPlus, All) are over the {len(COMMON)} tasks that have all "
        "variants. Columns of variants are over the tasks that have the variant, with their number if some are "
        "missing. In brackets, 95 % intervals over scenes and runs; where an environment has one run, over its scenes "
        "only",
        ("Method", USES, "checked", "runs", *COLUMNS),
        (*_grouped(methods, cells), ("", (("Floor", "", "", "", *(f"{floor(column):.2f}" for column in COLUMNS)),))),
        (
            *(f"{method.name} is partial: {', '.join(method.gaps)}." for method in methods if method.gaps),
            *_repetitions(methods),
        ),
    )


def _repetitions(methods: Sequence[Standing]) -> Iterator[str]:
    """A sentence about each entry that trained another entry's method again."""
    for other in (method for method in methods if method.entry.card.repeats):
        repeats = other.entry.card.repeats
        found = next(filter(None, (repetition(method, other) for method in methods)), None)
        if found is None:
            yield (
                f"{other.name} does not count as a repetition of {repeats}, an entry that must be on the page: it "
                "needs other authors, the same observations, rules and privileges, all environments, and as many runs "
                "and episodes."
            )
        else:
            value, low, high = found
            yield f"{other.name} repeats {repeats}: its mean score differs by {value:+.2f} [{low:+.2f}, {high:+.2f}]."


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


def _intents(methods: Sequence[Standing]) -> Table:
    """A row for each method and set of intents, in blocks by what policies observe and receive."""
    from magical_mj.intents import by_set  # imported late: it loads the simulator

    groups = defaultdict[str, list[tuple[str, ...]]](list)
    for method in _entered(methods):
        block = f"{BLOCKS[method.block]}; given {method.entry.recorded.given or 'nothing'}"
        groups[block] += [(label(method), *by_set.cells(row)) for row in by_set.rows(method.entry.counted)]
    return Table(
        "intents",
        "Intents by set. Success: the share of solved episodes; clean success: no block moved that the intent does not "
        "name. In brackets, 95 % intervals over intents, their scenes and runs. Best shortcut: of those that know the "
        "relations, but choose blocks by a rule",
        ("Method", *by_set.HEADER),
        tuple((block, tuple(rows)) for block, rows in groups.items() if rows),
        tuple(f"{method.name} is partial: {', '.join(method.gaps)}." for method in methods if not method.means),
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
