"""Writes generated tables between their markers in the pages. `make docs` runs this.

The tables come from the registry, and for results from the entries in results/.
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
from magical_mj.shifts.shift import STRENGTHS
from magical_mj.tasks.registry import task_spec
from magical_mj.variants import VARIANTS, Axis

ROOT: Final = Path(__file__).parent.parent
COMPARED: Final = ("BC (ST)", "BC (MT)", "GAIL (ST)", "GAIL (MT)", "WGAIL-GP (ST)", "AL (ST)")
"""The paper's methods with default settings, for comparison with ours."""
AGENTS: Final = {"noop": "Doing nothing (`noop`)", "random": "Random actions (`random`)"}
"""Entry -> label of the agents that every learner should outperform."""
HEADLINES: Final = (
    "BC (ST, quick)",
    "Redraw (ST, quick)",
    "BC (ST)",
    "GAIL (ST)",
    "Relational (ST, State)",
    "BC (ST, State)",
    "GAIL (ST, State)",
    "Goals and planning (ST, State)",
)
"""The learners in the README, if they were evaluated in all environments."""
ABLATIONS: Final = ("BC (ST)", "BC (ST, no trans./rot. aug.)", "BC (ST, no aug.)", "BC (ST, allo.)")
"""The paper's BC and its ablations. Ours, with --quick, have the same names."""

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
    """The table of tasks, with goals, horizons and numbers of variants."""
    rows = []
    for task in TASKS:
        spec = task_spec(task)
        variants = sum(name == task for name, _ in ENVIRONMENTS)
        rows.append((f"**{task}**", _sentence(spec.summary), str(spec.horizon()), str(variants)))
    return table(("Task", "Goal", "Steps", "Variants"), rows)


def variants() -> str:
    """The table of variants, with their axes and the tasks that lack them."""
    rows = []
    for variant, axes in VARIANTS.items():
        missing = [task for task in TASKS if (task, variant) not in ENVIRONMENTS]
        words = "; ".join(AXES[axis] for axis in axes)
        if variant == "All":
            words = "everything that can vary in the task, at once"
        rows.append((f"**{variant}**", _sentence(words or "nothing: the scene of the demonstrations"), _but(missing)))
    return table(("Variant", "Varies at each reset", "Tasks"), rows)


def presets() -> str:
    """The table of presets in Gymnasium ids, with their observations."""
    rows = [
        (f"`-{name}`" if name else '(the empty name, `""`)', _sentence(entry.summary))
        for name, entry in PRESETS.items()
    ]
    return table(("Preset", "Observation"), rows)


def _mean(standing: Standing, variants: Iterable[str]) -> float:
    """The mean score over the environments of these variants. NaN if there are none."""
    means = [float(values.mean()) for (_, variant), values in standing.means.items() if variant in variants]
    return sum(means) / len(means) if means else float("nan")


def _number(value: float) -> str:
    return "" if value != value else f"{value:.2f}"


def overview(standings: Sequence[Standing], *, intervals: bool = False) -> str:
    """The table of methods with their mean scores over tasks in each variant, in blocks.

    (m/n) marks a mean over only m of the n tasks. With `intervals`, means of several runs have their 95 % interval over
    the runs (stratified bootstrap).
    """
    rows: list[Sequence[str]] = []
    for block, heading in BLOCKS.items():
        group = [standing for standing in standings if standing.block == block]
        rows += [(f"**{heading}**", *[""] * (2 + len(VARIANTS)))] if group else []
        for standing in group:
            name = AGENTS.get(standing.name, label(standing))
            runs = "5" if standing.kind == "published" else str(len(standing.entry.runs))
            scores = (_over_tasks(standing, variant, intervals) for variant in VARIANTS)
            rows.append((name, ", ".join(standing.privileges), runs, *scores))
    return table(("Method", "May also use", "Runs", *VARIANTS), rows)


def _over_tasks(standing: Standing, variant: str, intervals: bool) -> str:
    wanted = [pair for pair in ENVIRONMENTS if pair[1] == variant]
    there = [pair for pair in wanted if pair in standing.means]
    part = f" ({len(there)}/{len(wanted)})" if len(there) < len(wanted) else ""
    strata = [standing.means[pair] for pair in there]
    if intervals and strata and all(len(runs) > 1 for runs in strata):
        part = " [{:.2f}, {:.2f}]".format(*mean_interval(strata)) + part
    return f"{_mean(standing, (variant,)):.2f}{part}" if there else ""


def costs(learnt: Iterable[Standing]) -> str:
    """The table of our learners with the cost of a training, for one task and for all of its tasks."""
    rows = []
    for standing in learnt:
        if standing.kind == "published":
            continue
        tasks = len({task for task, _ in standing.means})
        hours, steps = standing.entry.card.training.hours, standing.entry.card.training.steps
        each = 1 if "(ST" in standing.name else tasks
        rows.append(
            (
                label(standing),
                str(tasks),
                *("not recorded" if hours is None else f"{hours * factor:.2g}" for factor in (1 / each, tasks / each)),
                *("not recorded" if steps is None else f"{steps * factor:,.0f}" for factor in (1 / each, tasks / each)),
            )
        )
    columns = ("Tasks", "Hours a task", "Hours a run", "Environment steps a task", "... a run")
    return table(("", *columns), rows)


def agreement(learnt: Mapping[str, Standing], paper: Sequence[Standing]) -> str:
    """The table of rank correlations over environments between our trainings of the paper's methods and the paper."""
    rows = [
        (label(standing), *(_number(rank_correlation(standing.means, other.means)) for other in paper))
        for standing in learnt.values()
        if standing.name.split(" (")[0] in {other.name.split(" (")[0] for other in paper}
    ]
    return table(("", *COMPARED), rows)


def ablations(learnt: Iterable[Standing], paper: Iterable[Standing]) -> str:
    """The table of ablations of BC: mean scores over tasks, the paper's in brackets, and their rank correlations."""
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
    """Name -> table of README.md."""
    learnt, agents, paper = _results()
    shown = [method for method in (*learnt.values(), *paper) if method.name in HEADLINES and method.everywhere]
    return {"tasks": tasks(), "variants": variants(), "results": overview([*shown, *agents])}


def results() -> dict[str, str]:
    """Name -> table of docs/results.md."""
    learnt, agents, paper = _results()
    return {
        "overview": overview([*learnt.values(), *agents, *paper], intervals=True),
        "costs": costs(learnt.values()),
        "agreement": agreement(learnt, paper),
        "ablations": ablations(learnt.values(), published()),
    }


def shifts() -> dict[str, str]:
    """Name -> table of docs/shifts.md: the effect of each axis, and its factors with their sizes at each strength."""
    kinds = {"signed": "±", "positive": "0 to ", "exact": "", "choice": "below "}
    rows = [
        (
            f"`{name}`" if index == 0 else "",
            factor.name,
            _sentence(factor.about),
            *(f"{kinds[factor.draw]}{size:g}" for size in factor.sizes),
        )
        for name, kind in SHIFTS.items()
        for index, factor in enumerate(kind.factors)
    ]
    return {
        "axes": table(
            ("Axis", "What it changes"), [(f"`{name}`", _sentence(kind.summary)) for name, kind in SHIFTS.items()]
        ),
        "factors": table(("Axis", "Factor", "What it is", *map(str, range(1, STRENGTHS + 1))), rows),
    }


def _rank(standing: Standing) -> tuple[bool, bool, float]:
    """The sort key of methods: official ones first, then complete ones, then those with a high mean."""
    return standing.kind != "official", not standing.everywhere, -_mean(standing, VARIANTS)


@cache
def _results() -> tuple[dict[str, Standing], list[Standing], list[Standing]]:
    """Our learners by the names of their files, sorted by `_rank`; the agents; the paper's methods."""
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
"""Page -> its tables."""


def filled(text: str, tables: Mapping[str, str]) -> str:
    """The text of a page with the tables inserted between their markers."""
    for name, body in tables.items():
        start, end = f"<!-- {name}: written by make docs -->", f"<!-- end of {name} -->"
        text, count = re.subn(f"{start}.*?{end}", f"{start}\n{body}\n{end}", text, flags=re.DOTALL)
        if count != 1:
            raise ValueError(f"the page needs exactly one pair of markers {start} and {end}")
    return text


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for page, tables in PAGES.items():
        path = ROOT / page
        path.write_text(filled(path.read_text(encoding="utf-8"), tables()), encoding="utf-8")
