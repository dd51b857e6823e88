"""Writes tables between their markers, from the registry and, on the page of results, from the entries in results/.

`make docs` runs this.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.envs.presets import PRESETS
from magical_mj.evaluation.reports.statistics import mean_interval, rank_correlation
from magical_mj.leaderboard.page import label
from magical_mj.leaderboard.standings import BLOCKS, Standing, own_standings, published
from magical_mj.scene import constants as c
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.shift import STRENGTHS, Factor
from magical_mj.tasks.registry import task_spec
from magical_mj.variants import VARIANTS, Axis

ROOT: Final = Path(__file__).parent.parent
COMPARED: Final = ("BC (ST)", "BC (MT)", "GAIL (ST)", "GAIL (MT)", "WGAIL-GP (ST)", "AL (ST)")
"""The paper's methods with its default settings."""
AGENTS: Final = {
    "noop": "Doing nothing (`noop`)",
    "random": "Random actions (`random`)",
    "replay": "Replaying a demonstration (`replay`)",
}
"""The entries of policies that ignore their observations: lower bounds for learners."""
ABLATIONS: Final = ("BC (ST)", "BC (ST, no trans./rot. aug.)", "BC (ST, no aug.)", "BC (ST, allo.)")
"""The paper's BC and its ablations. Ours, with --quick, have the same names."""
GROUPS: Final = {
    "Memory": ("Demo", "Jitter", "Dynamics"),
    "Distraction": ("Colour", "Shape"),
    "Generalisation": ("Layout", "CountPlus", "All"),
}
"""Variants whose scores rise and fall together, by what they test."""
IN_COLOUR: Final = ("replay", "BC (ST, quick)", "Redraw (ST, quick)", "BC (ST, State)", "Relational (ST, State)")
"""Our methods in the table of Colour; the paper's are BC and GAIL, for one task."""
CLONED: Final = "BC (ST), compared with GAIL"
OURS: Final = {
    CLONED: "BC (ST, State)",
    "BC (ST)": "BC (ST, quick)",
    "BC (MT)": "BC (MT, quick)",
    "BC (ST, allo.)": "BC (ST, quick, allo.)",
    "BC (ST, no aug.)": "BC (ST, quick, no aug.)",
    "BC (ST, no trans./rot. aug.)": "BC (ST, quick, no trans./rot. aug.)",
    "GAIL (ST)": "GAIL (ST, State)",
    "GAIL (MT)": "GAIL (MT, State)",
    "WGAIL-GP (ST)": "WGAIL-GP (ST, State)",
    "AL (ST)": "AL (ST, State)",
}
"""The paper's methods -> ours that are compared with its claims: five or three runs in all environments."""
DIFFERENT: Final = 0.02
"""Two figures that differ by less are called equal."""

AXES: Final[dict[Axis, str]] = {
    "jitter": f"small changes of all poses: ±{c.JITTER_POSITION} of the arena's 2 per axis, ±{c.JITTER_ANGLE:.3f} rad, "
    f"and ±{c.JITTER_REGION_SIZE} of the regions' sides",
    "layout": "all poses, and the sizes of goal regions",
    "colour": "colours",
    "shape": "shapes",
    "count": "how many blocks, and in FixColour regions",
    "dynamics": "motor forces and the blocks' friction",
}


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def tasks() -> str:
    """Each task, its goal and its horizon."""
    rows = []
    for task in TASKS:
        spec = task_spec(task)
        variants = sum(name == task for name, _ in ENVIRONMENTS)
        rows.append((f"**{task}**", _sentence(spec.summary), str(spec.horizon()), str(variants)))
    return table(("Task", "Goal", "Steps", "Variants"), rows)


def variants() -> str:
    """Each variant, what it varies, and its tasks."""
    rows = []
    for variant, axes in VARIANTS.items():
        missing = [task for task in TASKS if (task, variant) not in ENVIRONMENTS]
        words = "; ".join(AXES[axis] for axis in axes)
        if variant == "All":
            words = "everything that can vary in the task, at once"
        rows.append((f"**{variant}**", _sentence(words or "nothing: the scene of the demonstrations"), _but(missing)))
    return table(("Variant", "Varies at each reset", "Tasks"), rows)


def presets() -> str:
    """Each preset of the Gymnasium ids and what it observes."""
    rows = [
        (f"`-{name}`" if name else '(the empty name, `""`)', _sentence(entry.summary))
        for name, entry in PRESETS.items()
    ]
    return table(("Preset", "Observation"), rows)


def _mean(standing: Standing, variants: Iterable[str], tasks: Iterable[str] = TASKS) -> float:
    """The mean over the environments of these variants and tasks. NaN without environments."""
    means = [
        float(values.mean())
        for (task, variant), values in standing.means.items()
        if variant in variants and task in tasks
    ]
    return sum(means) / len(means) if means else float("nan")


def _number(value: float) -> str:
    return "" if value != value else f"{value:.2f}"


def overview(standings: Sequence[Standing]) -> str:
    """Each method's mean score over tasks in each variant, in blocks. (m/n): over m of the n tasks."""
    rows: list[Sequence[str]] = []
    for block, heading in BLOCKS.items():
        group = [standing for standing in standings if standing.block == block]
        rows += [(f"**{heading}**", *[""] * (2 + len(VARIANTS)))] if group else []
        for standing in group:
            scores = (_over_tasks(standing, variant) for variant in VARIANTS)
            rows.append((_label(standing), ", ".join(standing.privileges), _runs(standing), *scores))
    return table(("Method", "May also use", "Runs", *VARIANTS), rows)


def _label(standing: Standing) -> str:
    return AGENTS.get(standing.name, label(standing))


def _runs(standing: Standing) -> str:
    return "5" if standing.kind == "published" else str(len(standing.entry.runs))


def _over_tasks(standing: Standing, variant: str) -> str:
    wanted = [pair for pair in ENVIRONMENTS if pair[1] == variant]
    played = [pair for pair in wanted if pair in standing.means]
    part = f" ({len(played)}/{len(wanted)})" if len(played) < len(wanted) else ""
    return f"{_mean(standing, (variant,)):.2f}{part}" if played else ""


def groups(standings: Iterable[Standing], noop: Standing) -> str:
    """Means over the groups of variants, with 95 % intervals over runs, of the methods played in all environments."""
    rows: list[Sequence[str]] = []
    complete = [standing for standing in standings if standing.everywhere]
    best_first = sorted(complete, key=lambda standing: -_mean(standing, GROUPS["Generalisation"]))
    others = [task for task in TASKS if task != "MoveToRegion"]
    for block, heading in BLOCKS.items():
        group = [standing for standing in best_first if standing.block == block]
        rows += [(f"**{heading}**", *[""] * (3 + len(GROUPS)))] if group else []
        for standing in group:
            means = (_with_interval(standing, variants) for variants in GROUPS.values())
            without = _number(_mean(standing, GROUPS["Generalisation"], others))
            rows.append((_label(standing), _runs(standing), *means, without, _above(standing, noop)))
    return table(("Method", "Runs", *GROUPS, "... without MoveToRegion", "... above doing nothing"), rows)


def _with_interval(standing: Standing, variants: Sequence[str]) -> str:
    strata = [values for (_, variant), values in standing.means.items() if variant in variants]
    several = all(len(runs) > 2 for runs in strata)
    interval = " [{:.2f}, {:.2f}]".format(*mean_interval(strata)) if several else ""
    return f"{_mean(standing, variants):.2f}{interval}"


def _above(standing: Standing, noop: Standing) -> str:
    """The mean over the environments of (score - noop's) / (1 - noop's). Empty if the rules differ."""
    if standing.entry.rules != noop.entry.rules:
        return ""
    pairs = [pair for pair in ENVIRONMENTS if pair[1] in GROUPS["Generalisation"]]
    floors = [float(noop.means[pair].mean()) for pair in pairs]
    parts = [(standing.means[pair].mean() - floor) / (1 - floor) for pair, floor in zip(pairs, floors, strict=True)]
    return f"{sum(parts) / len(parts):.2f}"


def colours(standings: Iterable[Standing], paper: Iterable[Standing]) -> str:
    """The scores in the variant Colour of each task."""
    ours = {standing.name: standing for standing in standings}
    papers = [standing for standing in paper if standing.name in ("BC (ST)", "GAIL (ST)")]
    shown = [*(ours[name] for name in IN_COLOUR), *papers]
    rows = [(_label(method), *(f"{method.means[task, 'Colour'].mean():.2f}" for task in TASKS)) for method in shown]
    return table(("Colour", *TASKS), rows)


def claims(standings: Iterable[Standing], paper: Iterable[Standing]) -> str:
    """The paper's claims, each with two figures of the paper, our figures, and whether their order is the same."""
    found = {standing.name: standing for standing in standings}
    ours = {name: found[our_name] for name, our_name in OURS.items()}
    papers = {standing.name: standing for standing in paper}
    papers[CLONED] = papers["BC (ST)"]
    rows = []
    for (claim, *theirs), (_, *here) in zip(_claimed(papers), _claimed(ours), strict=True):
        order = _order(*here)
        verdict = "again" if order == _order(*theirs) else "no difference" if order == "equal" else "no"
        rows.append((claim, *("{:.2f}, {:.2f}".format(*figures) for figures in (theirs, here)), verdict))
    return table(("Claim", "Paper", "Ours", ""), rows)


def _claimed(methods: Mapping[str, Standing]) -> list[tuple[str, float, float]]:
    """Each claim and the two figures that it compares."""
    cloned, bc, bc_all, from_above, unmoved, plain = (
        methods[name] for name in (CLONED, "BC (ST)", "BC (MT)", "BC (ST, allo.)", ABLATIONS[1], ABLATIONS[2])
    )
    gail, gail_all, wgail, al = (methods[name] for name in COMPARED[2:])
    both = [task for task in TASKS if (task, "Shape") in ENVIRONMENTS]
    lost = {name: 1 - _mean(bc, (name,), both) / _mean(bc, ("Demo",), both) for name in ("Colour", "Shape")}
    al_demo = {task: _mean(al, ("Demo",), (task,)) for task in TASKS}
    jitter = [_mean(method, ("Jitter",)) for method in (bc, unmoved, plain)]

    def pair(claim: str, variant: str, large: Standing, small: Standing, task: str = "") -> tuple[str, float, float]:
        tasks, where = ((task,), f"{variant}, {task}") if task else (TASKS, variant)
        return f"{claim} ({where})", _mean(large, (variant,), tasks), _mean(small, (variant,), tasks)

    return [
        ("BC loses a larger part of Demo's score in Colour than in Shape (seven tasks)", lost["Colour"], lost["Shape"]),
        pair("GAIL scores more than BC", "Demo", gail, cloned),
        pair("GAIL scores more than BC", "Layout", gail, cloned),
        pair("BC scores more than GAIL", "Colour", cloned, gail),
        pair("GAIL scores more than WGAIL-GP", "Demo", gail, wgail),
        (
            "AL learns MoveToRegion better than any other task (Demo; the best of the others)",
            al_demo.pop("MoveToRegion"),
            max(al_demo.values()),
        ),
        pair("BC for one task scores more than for all", "Demo", bc, bc_all),
        pair("GAIL for one task scores more than for all", "Demo", gail, gail_all),
        pair("BC for all tasks scores more than for one", "Demo", bc_all, bc, "FixColour"),
        *(
            pair("BC for one task scores more than for all", "Colour", bc, bc_all, task)
            for task in ("MoveToCorner", "MatchRegions", "FindDupe")
        ),
        pair("BC with the robot's view scores more than from above", "Layout", bc, from_above),
        pair("BC scores more with augmentations than without", "Jitter", bc, plain),
        (
            "Translation and rotation give most of that (Jitter: their gain, the others')",
            jitter[0] - jitter[1],
            jitter[1] - jitter[2],
        ),
        pair("BC scores more with translation and rotation than without", "Colour", bc, unmoved, "FindDupe"),
        pair("Colour augmentations alone change little", "Colour", unmoved, plain),
    ]


def _order(first: float, second: float) -> str:
    return "equal" if abs(first - second) < DIFFERENT else "more" if first > second else "less"


def trainings(learnt: Iterable[Standing], paper: Iterable[Standing]) -> str:
    """Each training's cost, and its rank correlation with the paper's method over the environments of both."""
    papers = {standing.name: standing for standing in paper}
    rows = []
    for standing in learnt:
        hours, steps = standing.entry.card.training.hours, standing.entry.card.training.steps
        tasks = 1 if "(ST" in standing.name else len({task for task, _ in standing.means})
        words = ["?" if hours is None else f"{hours / tasks:.2g}", "?" if steps is None else f"{steps / tasks:,.0f}"]
        other = papers.get(f"{standing.name.split(' (')[0]} ({'MT' if '(MT' in standing.name else 'ST'})")
        order = _number(rank_correlation(standing.means, other.means)) if other else ""
        rows.append((label(standing), *words, str(len(standing.means)), order))
    return table(("", "Hours a task", "Steps a task", "Environments", "Rank correlation"), rows)


def ablations(learnt: Iterable[Standing], paper: Iterable[Standing]) -> str:
    """BC and its ablations: mean scores over the tasks, the paper's in brackets, and their rank correlation."""
    papers = {standing.name: standing for standing in paper}
    ours = {standing.name.replace(", quick", ""): standing for standing in learnt if ", quick" in standing.name}
    rows = []
    for name in ABLATIONS:
        pairs = ((_mean(ours[name], (variant,)), _mean(papers[name], (variant,))) for variant in VARIANTS)
        order = _number(rank_correlation(ours[name].means, papers[name].means))
        rows.append((name, *(f"{here:.2f} ({there:.2f})" for here, there in pairs), order))
    return table(("", *VARIANTS, "Rank correlation"), rows)


def _sentence(words: str) -> str:
    return words[:1].upper() + words[1:]


def _but(missing: Sequence[str]) -> str:
    return f"all but {' and '.join(missing)}" if missing else "all"


def readme() -> dict[str, str]:
    """The tables of README.md by name."""
    return {"tasks": tasks(), "variants": variants()}


def results() -> dict[str, str]:
    """The tables of docs/results.md by name."""
    learnt, agents, paper = _results()
    own = [*learnt.values(), *agents]
    noop = next(standing for standing in agents if standing.name == "noop")
    return {
        "groups": groups([*own, *paper], noop),
        "overview": overview([*own, *paper]),
        "colours": colours(own, paper),
        "claims": claims(own, published()),
        "ablations": ablations(learnt.values(), published()),
        "trainings": trainings(learnt.values(), paper),
    }


def shifts() -> dict[str, str]:
    """The tables of docs/shifts.md by name: what each axis changes, and the factors that it draws."""
    rows = [
        (f"`{name}`" if index == 0 else "", factor.name, _sentence(factor.about), _sizes(factor))
        for name, kind in SHIFTS.items()
        for index, factor in enumerate(kind.factors)
    ]
    return {
        "axes": table(
            ("Axis", "What it changes"), [(f"`{name}`", _sentence(kind.summary)) for name, kind in SHIFTS.items()]
        ),
        "factors": table(("Axis", "Factor", "What it is", f"At strengths 1 to {STRENGTHS}"), rows),
    }


def _sizes(factor: Factor) -> str:
    """A factor's sizes at all strengths; one, if they are equal."""
    kinds = {"signed": "±", "positive": "0 to ", "exact": "", "choice": "below "}
    sizes = factor.sizes[:1] if len(set(factor.sizes)) == 1 else factor.sizes
    return kinds[factor.draw] + ", ".join(f"{size:g}" for size in sizes)


def _rank(standing: Standing) -> tuple[bool, bool, float]:
    """The key for sorting methods."""
    return standing.kind != "official", not standing.everywhere, -_mean(standing, VARIANTS)


@cache
def _results() -> tuple[dict[str, Standing], list[Standing], list[Standing]]:
    """Our learners by file name, complete and best ones first, then the agents, and the paper's methods."""
    own = own_standings(ROOT / "results")
    learnt = {name: standing for name, standing in own.items() if standing.name not in AGENTS}
    paper = [standing for standing in published() if standing.name in COMPARED]
    return (
        dict(sorted(learnt.items(), key=lambda item: _rank(item[1]))),
        [standing for standing in own.values() if standing.name in AGENTS],
        sorted(paper, key=lambda standing: COMPARED.index(standing.name)),
    )


PAGES: Final[Mapping[str, Callable[[], dict[str, str]]]] = {
    "README.md": readme,
    "docs/environments.md": lambda: {"presets": presets()},
    "docs/results.md": results,
    "docs/shifts.md": shifts,
}
"""Page -> the function that makes its tables."""


def filled(text: str, tables: Mapping[str, str], command: str = "make docs") -> str:
    """A page's text with up-to-date tables, which the command writes."""
    for name, body in tables.items():
        start, end = f"<!-- {name}: written by {command} -->", f"<!-- end of {name} -->"
        text, count = re.subn(f"{start}.*?{end}", f"{start}\n{body}\n{end}", text, flags=re.DOTALL)
        if count != 1:
            raise ValueError(f"the page needs exactly one pair of markers {start} and {end}")
    return text


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for page, tables in PAGES.items():
        path = ROOT / page
        path.write_text(filled(path.read_text(encoding="utf-8"), tables()), encoding="utf-8")
