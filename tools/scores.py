"""Tables of scores: of our entries in results/, of these by the rules of the paper's released code, and the paper's."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.evaluation.reports.floors import floors
from magical_mj.leaderboard.page import label, shown
from magical_mj.leaderboard.standings import (
    ABOVE,
    BLOCKS,
    COLUMNS,
    GROUPS,
    NEW_PLACES,
    Standing,
    floor,
    own_standings,
    published,
    standing,
)
from tools import released
from tools.claims import claims
from tools.pages import ROOT, number, table
from tools.test_scenes import right_first

RESULTS: Final = ROOT / "results"
AGENTS: Final = {
    "noop": "Doing nothing (`noop`)",
    "random": "Random actions (`random`)",
    "replay": "Replaying a demonstration (`replay`)",
}
"""The entries of policies that ignore their observations: lower bounds for learners."""
HEADLINES: Final = (
    "BC (ST, quick)",
    "Redraw (ST, quick)",
    "Relational (ST, State)",
    "BC (ST, State)",
    "GAIL (ST, State)",
    "Goals and planning (ST, State)",
)
"""The learners in the tables of docs/results.md and results-paper.md."""
PUBLISHED: Final = ("BC (ST)", "GAIL (ST)")
"""The paper's methods in the table of scores in each variant."""
SATURATED: Final = 0.95
"""From this score of the best learnt method, or of the floor, on, an environment does not tell methods apart."""
HOPELESS: Final = 0.1
"""Up to this score above the floor, (score - f) / (1 - f), the best learnt method does not solve an environment."""
LEARNT: Final = ("pictures", "pictures and more", "states", "states and more")
"""The blocks of methods that learn a policy."""


FIRST: Final = ("Right block first", "Then solved")
"""The columns from docs/first-blocks.csv; see `tools.test_scenes.right_first`."""


def groups(methods: Mapping[str, Standing]) -> str:
    """What methods chose, and their scores: in blocks, in the order of the leaderboard. `methods`: by entry."""
    rows: list[Sequence[str]] = []
    columns = (NEW_PLACES, ABOVE, *GROUPS)
    for block, heading in BLOCKS.items():
        group = sorted(
            ((name, method) for name, method in methods.items() if method.block == block),
            key=lambda named: named[1].rank,
        )
        rows += [(f"**{heading}**", *[""] * len((*FIRST, *columns)))] if group else []
        rows += [
            (_label(method), *_first(name), *(shown(method, column) for column in columns)) for name, method in group
        ]
    rows.append(("Floor", "", "", *(number(floor(column)) for column in columns)))
    return table(("Method", *FIRST, *columns), rows)


def _first(name: str) -> tuple[str, ...]:
    return tuple("" if figure is None else "{:.2f} [{:.2f}, {:.2f}]".format(*figure) for figure in right_first(name))


def compared(methods: Iterable[Standing]) -> str:
    """The mean score over tasks in each variant."""
    tasks = (f"{variant} ({len(COLUMNS[variant])})" for variant in VARIANTS)
    rows = [
        (_label(method), *(number(method.scores[variant].value) for variant in VARIANTS))
        for method in sorted(methods, key=lambda method: method.rank)
    ]
    return table(("Method", *tasks), rows)


def _label(method: Standing) -> str:
    return AGENTS.get(method.name, label(method))


def limits(learnt: Iterable[Standing]) -> str:
    """A table of the environments that do not tell methods apart."""
    methods = [method for method in learnt if method.everywhere and method.block in LEARNT]
    best = {pair: max(float(method.means[pair].mean()) for method in methods) for pair in ENVIRONMENTS}
    lowest = floors()
    blind = [pair for pair in ENVIRONMENTS if lowest[pair] >= SATURATED]
    saturated = [pair for pair in ENVIRONMENTS if best[pair] >= SATURATED]
    hopeless = [
        pair
        for pair in ENVIRONMENTS
        if pair not in blind and (best[pair] - lowest[pair]) / (1 - lowest[pair]) <= HOPELESS
    ]
    named = (("Blind", blind), ("Saturated", saturated), ("Hopeless", hopeless))
    return table(("", "Number", "Environments"), [(name, str(len(pairs)), _named(pairs)) for name, pairs in named])


def _named(pairs: Sequence[tuple[str, str]]) -> str:
    tasks = {task: [variant for other, variant in pairs if other == task] for task in TASKS}
    return "; ".join(f"{task} {', '.join(variants)}" for task, variants in tasks.items() if variants)


def results() -> dict[str, str]:
    """The table of docs/results.md by name."""
    chosen = {*HEADLINES, *AGENTS}
    return {
        "methods": groups({name: one for name, one in own_methods().items() if one.name in chosen and one.everywhere})
    }


def comparisons() -> dict[str, str]:
    """The tables of docs/results-paper.md by name."""
    chosen = {*HEADLINES, *AGENTS}
    rescored = by_released_rules()
    in_paper = [method for method in published() if method.name in PUBLISHED]
    return {
        "compared": compared([*(method for method in rescored if method.name in chosen), *in_paper]),
        "claims": claims(compared_with_the_paper()),
    }


def card() -> dict[str, str]:
    """The tables of docs/benchmark-card.md by name."""
    return {"limits": limits(own_methods().values()), "starts": starts()}


def starts() -> str:
    """A table of what the test scenes score at the start, on average, where this is not 0."""
    means = own_methods()["noop"].means
    rows = []
    for task in TASKS:
        found = {variant: float(means[task, variant].mean()) for variant in VARIANTS if (task, variant) in means}
        if any(found.values()):
            rows.append((task, *(number(found.get(variant, math.nan)) for variant in VARIANTS)))
    return table(("Task", *VARIANTS), rows)


def compared_with_the_paper() -> dict[str, Standing]:
    """Our methods by name, with scores by the rules of the paper's released code where they have them."""
    methods = (*own_methods().values(), *by_released_rules())
    return {method.name: method for method in methods}


@cache
def own_methods() -> dict[str, Standing]:
    """Our entries by the names of their folders."""
    return own_standings(RESULTS)


@cache
def by_released_rules() -> tuple[Standing, ...]:
    """Those of our entries that have scores by the released rules, with these scores."""
    found = []
    for name, own in own_methods().items():
        entry = released.by_released_rules(own.entry, RESULTS / name)
        if entry is not None:
            found.append(replace(standing(entry), kind=own.kind, gaps=own.gaps))
    return tuple(found)
