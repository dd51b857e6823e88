"""Tables of scores: of our entries in results/, of these by the rules of the paper's released code, and the paper's."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

from magical_mj import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.evaluation.reports.statistics import rank_correlation
from magical_mj.leaderboard.page import label, shown, uses
from magical_mj.leaderboard.standings import (
    ABOVE,
    BLOCKS,
    COLUMNS,
    GROUPS,
    Standing,
    floor,
    own_standings,
    published,
    standing,
)
from tools import released
from tools.claims import ABLATIONS, CLONED, COMPARED, OURS, claims
from tools.pages import ROOT, number, table

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
    "BC (ST)",
    "GAIL (ST)",
    "Relational (ST, State)",
    "BC (ST, State)",
    "GAIL (ST, State)",
    "Goals and planning (ST, State)",
)
"""The learners in the table of variants."""
IN_COLOUR: Final = ("replay", "BC (ST, quick)", "Redraw (ST, quick)", "BC (ST, State)", "Relational (ST, State)")
"""Our methods in the table of Colour and Shape; the paper's are BC and GAIL, for one task."""
REPLAYED: Final = 0.7
"""From this mean score on, replaying a demonstration counts as enough in an environment."""
SATURATED: Final = 0.95
"""From this score of the best learnt method on, an environment does not tell methods apart."""
HOPELESS: Final = 0.1
"""Up to this score above doing nothing, (score - n) / (1 - n), the best learnt method does not solve an environment."""
LEARNT: Final = ("pictures", "pictures and more", "states", "states and more")
"""The blocks of methods that learn a policy."""


def in_blocks(methods: Sequence[Standing], header: Sequence[str], cells: Callable[[Standing], Iterable[str]]) -> str:
    """A table of methods in blocks, in the order of the leaderboard."""
    rows: list[Sequence[str]] = []
    for block, heading in BLOCKS.items():
        group = sorted((method for method in methods if method.block == block), key=lambda method: method.rank)
        rows += [(f"**{heading}**", *[""] * len(header))] if group else []
        rows += [(_label(method), *cells(method)) for method in group]
    return table(("Method", *header), rows)


def groups(methods: Iterable[Standing]) -> str:
    """The scores of methods with all environments in the groups of variants."""

    def cells(method: Standing) -> Iterable[str]:
        return uses(method), _runs(method), *(shown(method, column) for column in (*GROUPS, ABOVE))

    complete = [method for method in methods if method.everywhere]
    return in_blocks(complete, ("May also use", "Runs", *GROUPS, ABOVE), cells)


def overview(methods: Sequence[Standing]) -> str:
    """Each method's mean score over tasks in each variant; (m/n): over m of the n tasks."""

    def cells(method: Standing) -> Iterable[str]:
        return _runs(method), *(_score(method, variant) for variant in VARIANTS)

    tasks = (f"{variant} ({len(COLUMNS[variant])})" for variant in VARIANTS)
    return in_blocks(methods, ("Runs", *tasks), cells)


def _score(method: Standing, column: str) -> str:
    score = method.scores.get(column)
    return f"{score.value:.2f} {method.lacks(column)}".rstrip() if score else ""


def _label(method: Standing) -> str:
    return AGENTS.get(method.name, label(method))


def _runs(method: Standing) -> str:
    return "5" if method.kind == "published" else str(len(method.entry.runs))


def distraction(methods: Sequence[Standing], replay: Standing) -> str:
    """Mean scores in Colour and Shape, over the tasks that replaying a demonstration solves, and over the others."""
    columns: dict[str, list[tuple[str, str]]] = {}
    for variant in GROUPS["Distraction"]:
        pairs = COLUMNS[variant]
        enough = [pair for pair in pairs if replay.means[pair].mean() >= REPLAYED]
        for what, chosen in (("replay solves", enough), ("others", [pair for pair in pairs if pair not in enough])):
            columns[f"{variant}, {what}: {', '.join(task for task, _ in chosen)}"] = chosen
    rows = [(_label(method), *(number(method.mean(pairs).value) for pairs in columns.values())) for method in methods]
    return table(("Method", *columns), rows)


def limits(learnt: Iterable[Standing], replay: Standing) -> dict[str, str]:
    """A table of floors and best scores, and one of the environments that do not tell methods apart."""
    methods = [method for method in learnt if method.everywhere and method.block in LEARNT]
    best = {pair: max(float(method.means[pair].mean()) for method in methods) for pair in ENVIRONMENTS}
    floors = {pair: floor(*pair, "paper") for pair in ENVIRONMENTS}
    rows = []
    for task in TASKS:
        pairs = ((task, variant) for variant in VARIANTS)
        parts = (
            " / ".join(number(value) for value in (floors[pair], replay.means[pair].mean(), best[pair]))
            if pair in best
            else ""
            for pair in pairs
        )
        rows.append((task, *parts))
    saturated = [pair for pair in ENVIRONMENTS if best[pair] >= SATURATED]
    hopeless = [pair for pair in ENVIRONMENTS if (best[pair] - floors[pair]) / (1 - floors[pair]) <= HOPELESS]
    lists = [
        (name, str(len(pairs)), _named(pairs)) for name, pairs in (("Saturated", saturated), ("Hopeless", hopeless))
    ]
    return {"floors": table(("", *VARIANTS), rows), "limits": table(("", "Number", "Environments"), lists)}


def _named(pairs: Sequence[tuple[str, str]]) -> str:
    tasks = {task: [variant for other, variant in pairs if other == task] for task in TASKS}
    return "; ".join(f"{task} {', '.join(variants)}" for task, variants in tasks.items() if variants)


def agreement(methods: Mapping[str, Standing], paper: Iterable[Standing]) -> str:
    """The rank correlation of our methods with the paper's, over the environments."""
    papers = {method.name: method for method in paper}
    pairs = [(OURS[name], papers[name]) for name in COMPARED] + [(OURS[CLONED], papers["BC (ST)"])]
    rows = [(name, label(one), number(rank_correlation(methods[name].means, one.means))) for name, one in pairs]
    return table(("Ours", "The paper's", "Rank correlation"), rows)


def ablations(methods: Mapping[str, Standing], paper: Iterable[Standing]) -> str:
    """Of BC and BC with less: mean scores over the tasks, the paper's in brackets, and their rank correlation."""
    papers = {method.name: method for method in paper}
    rows = []
    for name in ABLATIONS:
        ours, theirs = methods[OURS[name]], papers[name]
        pairs = ((ours.scores[variant].value, theirs.scores[variant].value) for variant in VARIANTS)
        order = number(rank_correlation(ours.means, theirs.means))
        rows.append((name, *(f"{here:.2f} ({there:.2f})" for here, there in pairs), order))
    return table(("", *VARIANTS, "Rank correlation"), rows)


def results() -> dict[str, str]:
    """The tables of docs/results.md by name."""
    own, paper, rescored = own_methods(), _paper(), by_released_rules()
    methods = {method.name: method for method in rescored}
    in_colour = [
        *(methods[name] for name in IN_COLOUR),
        *(one for one in paper if one.name in ("BC (ST)", "GAIL (ST)")),
    ]
    chosen = [method for method in (*own.values(), *paper, *rescored) if method.name in (*HEADLINES, *AGENTS)]
    return {
        "groups": groups([*own.values(), *paper, *rescored]),
        "overview": overview([method for method in chosen if method.everywhere]),
        "distraction": distraction(in_colour, own["replay"]),
        "claims": claims(methods, published()),
        "ablations": ablations(methods, published()),
        "agreement": agreement(methods, published()),
    }


def card() -> dict[str, str]:
    """The tables of docs/benchmark-card.md by name."""
    own = own_methods()
    return limits(own.values(), own["replay"])


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


@cache
def _paper() -> list[Standing]:
    """The paper's methods with its default settings."""
    return [method for method in published() if method.name in COMPARED]
