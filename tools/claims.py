"""The paper's claims about its methods, compared with the same figures of ours, by the same rules.

    python -m tools.claims    # the table of docs/results-paper.md

One rule decides: a claim holds if the 95 % interval of the difference lies on the claimed side of 0, and fails if it
lies on the other side. Otherwise it is undecided. "Equal" fails if the interval excludes 0, and holds if it lies within
`MARGIN` of 0. The paper's intervals are made of its standard deviations over five runs, ours of episodes.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.special import stdtrit

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.actions import ACTIONS
from magical_mj.evaluation.reports.intervals import CONFIDENCE, Cell, Estimate, estimate
from magical_mj.evaluation.reports.results import PUBLISHED_RUNS, published_results
from magical_mj.leaderboard.standings import Standing
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.registry import Pair
from tools.pages import table

OURS: Final = {
    "BC (ST), compared with GAIL": "BC (ST, State)",
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
"""The paper's methods -> ours that are compared with its claims: five or three runs in all environments, by the same
rules."""
FROM_PICTURES: Final = {
    "GAIL (ST), from images": "GAIL (ST, quick)",
    "GAIL (ST, allo.)": "GAIL (ST, quick, allo.)",
    "GAIL (ST, no aug.)": "GAIL (ST, quick, no aug.)",
}
"""The same for GAIL from images, which played few tasks. These have the same scores by both rules."""
FEW: Final = ("MoveToRegion", "FindDupe", "FixColour")
"""The tasks that all of `FROM_PICTURES` played."""
OTHER_SCENES: Final = frozenset(
    [("FixColour", "Demo"), ("FixColour", "Jitter"), ("FixColour", "Dynamics"), ("FindDupe", "Jitter")]
)
"""The environments that are not compared: the released code centres their inner blocks before it moves them."""
COMPARABLE: Final = tuple(pair for pair in ENVIRONMENTS if pair not in OTHER_SCENES)
MARGIN: Final = 0.05
"""Scores that differ by less are called equal."""
VERDICTS: Final = ("Holds", "Undecided", "Fails", "No data")

Weights = Mapping[tuple[str, Pair], float]
"""(the paper's method, environment) -> the factor of its mean in a figure."""


class Claim(NamedTuple):
    """A claim of the paper about two figures, which are weighted sums of mean scores. The first is larger, or equal."""

    text: str
    first: Weights
    second: Weights
    equal: bool = False

    @property
    def difference(self) -> Weights:
        """The first figure less the second."""
        weights: dict[tuple[str, Pair], float] = defaultdict(float)
        for sign, figure in ((1, self.first), (-1, self.second)):
            for key, weight in figure.items():
                weights[key] += sign * weight
        return weights


class Compared(NamedTuple):
    """A claim with both figures and their difference, in the paper and here."""

    claim: str
    paper: tuple[float, float] | None
    papers: str
    ours: tuple[float, float] | None
    difference: Estimate
    verdict: str


def verdict(difference: Estimate, equal: bool = False) -> str:
    """Whether a claim holds, by the interval of the difference."""
    if np.isnan(difference.low):
        return "No data"
    if equal:
        return "Fails" if difference.decided else "Holds" if max(map(abs, difference[1:])) < MARGIN else "Undecided"
    return "Undecided" if not difference.decided else "Holds" if difference.low > 0 else "Fails"


def at(method: str, variants: str, tasks: Iterable[str] = TASKS, factor: float = 1.0) -> Weights:
    """The mean score of a method over the environments that are compared."""
    pairs = [pair for pair in COMPARABLE if pair[0] in tasks and pair[1] in variants.split(", ")]
    return {(method, pair): factor / len(pairs) for pair in pairs}


def listed(best: str) -> list[Claim]:
    """The claims with figures. `best` is the task other than MoveToRegion in which our AL scores most."""
    cloned, bc, bc_all, bc_allo, plain, unmoved, gail, gail_all, wgail, al = OURS
    pictures, gail_allo, gail_plain = FROM_PICTURES
    shapes = [task for task, variant in ENVIRONMENTS if variant == "Shape"]
    still = ("MoveToCorner", "MatchRegions", "MakeLine")
    hard = [task for task in TASKS if task not in ("MoveToCorner", "MoveToRegion")]
    moved = [task for task in TASKS if (task, "Jitter") in COMPARABLE]

    def pair(
        text: str, large: str, small: str, variant: str, tasks: Sequence[str] = TASKS, equal: bool = False
    ) -> Claim:
        shown = [task for task in tasks if (task, variant) in COMPARABLE]
        where = variant if tuple(tasks) == TASKS else f"{variant}; {', '.join(shown)}"
        return Claim(f"{text} ({where})", at(large, variant, tasks), at(small, variant, tasks), equal)

    def only(task: str, other: str) -> Claim:
        text = f"AL solves only {task} (Demo; {task}, {other})"
        return Claim(text, at(al, "Demo", (task,)), at(al, "Demo", (other,)))

    return [
        *(
            Claim(f"{name}: Demo > Jitter", at(method, "Demo", moved), at(method, "Jitter", moved))
            for name, method in (("BC", bc), ("GAIL", gail))
        ),
        *(
            Claim(
                f"{name}: Demo > Layout, CountPlus and All (without MoveToCorner and MoveToRegion)",
                at(method, "Demo", hard),
                at(method, "Layout, CountPlus, All", hard),
            )
            for name, method in (("BC", bc), ("GAIL", gail))
        ),
        *(
            Claim(f"{name}: Shape > Colour (seven tasks)", at(method, "Shape", shapes), at(method, "Colour", shapes))
            for name, method in (("BC", bc), ("GAIL", gail))
        ),
        Claim(
            f"BC: shapes cause no trouble (Demo, Shape; {', '.join(still)})",
            at(bc, "Demo", still),
            at(bc, "Shape", still),
            equal=True,
        ),
        pair("GAIL > BC", gail, cloned, "Demo"),
        pair("GAIL > BC", gail, cloned, "Layout"),
        pair("GAIL > BC, from images", pictures, bc, "Layout", ("MoveToRegion",)),
        pair("BC > GAIL", cloned, gail, "Colour"),
        pair("GAIL > WGAIL-GP", gail, wgail, "Demo"),
        only("MoveToCorner", "MoveToRegion"),
        only("MoveToRegion", best),
        pair("BC ST > MT", bc, bc_all, "Demo"),
        pair("GAIL ST > MT", gail, gail_all, "Demo"),
        *(pair("BC ST > MT", bc, bc_all, "Colour", (task,)) for task in ("MoveToCorner", "MatchRegions", "FindDupe")),
        pair("BC ego > allo", bc, bc_allo, "Layout"),
        pair("BC ego > allo", bc, bc_allo, "Jitter"),
        pair("GAIL ego > allo", pictures, gail_allo, "Layout", FEW),
        pair("GAIL > without augmentations of the discriminator", pictures, gail_plain, "Demo", FEW),
        *(pair("BC > without augmentations", bc, plain, variant) for variant in ("Demo", "Jitter", "Layout")),
        Claim(
            "Translation and rotation give most of that (Jitter: their gain, the others')",
            {**at(bc, "Jitter"), **at(unmoved, "Jitter", factor=-1)},
            {**at(unmoved, "Jitter"), **at(plain, "Jitter", factor=-1)},
        ),
        pair("BC > without translation and rotation", bc, unmoved, "Colour", ("FindDupe",)),
        pair("Colour jitter and noise alone change little", unmoved, plain, "Colour", equal=True),
    ]


WITHOUT_DATA: Final = (
    "BC MT > ST (Demo; FixColour): other scenes",
    "In FixColour, the same arc from every start",
    "In MoveToCorner and FindDupe, past a block that was shifted a little",
    "In new colours, in the wrong direction",
    "In MoveToRegion, ego turns until the region is ahead",
)
"""The paper's claims that we have not measured, or measured in other scenes."""


def compared(methods: Mapping[str, Standing]) -> list[Compared]:
    """All claims, with our figures by the rules of the paper's released code."""
    ours = {name: methods[our_name] for name, our_name in (OURS | FROM_PICTURES).items()}
    spreads = {(row.policy, (row.task, row.variant)): (row.mean, row.std) for row in published_results().itertuples()}
    learnt = ours["AL (ST)"].means
    others = (task for task, variant in COMPARABLE if variant == "Demo" and task != "MoveToRegion")
    best = max(others, key=lambda task: learnt[task, "Demo"].mean())
    rows = []
    for claim in listed(best):
        found = _ours(claim.difference, ours)
        figures = _ours(claim.first, ours).value, _ours(claim.second, ours).value
        papers = _papers(claim.first, spreads).value, _papers(claim.second, spreads).value
        says = verdict(_papers(claim.difference, spreads), claim.equal)
        rows.append(Compared(claim.text, papers, says, figures, found, verdict(found, claim.equal)))
    for text, first, second, found in _seen(ours):
        rows.append(Compared(text, None, "", (first, second), found, verdict(found)))
    rows += [Compared(text, None, "", None, Estimate(np.nan), "No data") for text in WITHOUT_DATA]
    return rows


def claims(methods: Mapping[str, Standing]) -> str:
    """The table of claims, grouped by our verdict."""
    rows: list[Sequence[str]] = []
    every = compared(methods)
    for heading in VERDICTS:
        group = [row for row in every if row.verdict == heading]
        rows += [(f"**{heading}** ({len(group)})", "", "", "", "")] if group else []
        rows += [
            (row.claim, _pair(row.paper), row.papers.lower(), _pair(row.ours), _interval(row.difference))
            for row in group
        ]
    return table(("The paper's claim", "Paper", "by this rule", "Ours", "Difference"), rows)


def _pair(figures: tuple[float, float] | None) -> str:
    return "" if figures is None else "{:.2f}, {:.2f}".format(*figures).replace("-0.00", "0.00")


def _interval(found: Estimate) -> str:
    return "" if np.isnan(found.low) else "{:+.2f} [{:+.2f}, {:+.2f}]".format(*found)


def _ours(weights: Weights, methods: Mapping[str, Standing]) -> Estimate:
    by_method: dict[str, dict[Pair, float]] = defaultdict(dict)
    for (name, pair), weight in weights.items():
        by_method[name][pair] = weight
    return estimate([cell for name, of_pairs in by_method.items() for cell in methods[name].cells(of_pairs, name)])


def _papers(weights: Weights, spreads: Mapping[tuple[str, Pair], tuple[float, float]]) -> Estimate:
    """The paper's figure, whose interval is Student's by the standard deviations (ddof = 0) of its five runs."""
    rows = [
        (weight, *spreads[name.partition("), ")[0].rstrip(")") + ")", pair]) for (name, pair), weight in weights.items()
    ]
    value = sum(weight * mean for weight, mean, _ in rows)
    parts = np.array([weight**2 * std**2 / (PUBLISHED_RUNS - 1) for weight, _, std in rows])
    if not parts.any():
        return Estimate(value, value, value)
    freedom = parts.sum() ** 2 / np.sum(parts**2 / (PUBLISHED_RUNS - 1))
    half = float(stdtrit(freedom, (1 + CONFIDENCE) / 2) * np.sqrt(parts.sum()))
    return Estimate(value, value - half, value + half)


def _seen(methods: Mapping[str, Standing]) -> list[tuple[str, float, float, Estimate]]:
    """The claims about policies' behaviour, without figures in the paper."""
    bc, allo = methods["BC (ST)"], methods["BC (ST, allo.)"]
    region = ("MoveToRegion",)
    freezes = "BC freezes in new colours (unsolved episodes that end without movement: Colour, Demo)"
    spins = "BC allo spins in MoveToRegion's Layout (unsolved episodes that end turning in place; ego)"
    rows = []
    for text, sides, motions in (
        (freezes, ((bc, "Colour", TASKS), (bc, "Demo", TASKS)), {(0, 0)}),
        (spins, ((allo, "Layout", region), (bc, "Layout", region)), {(1, 0), (2, 0)}),
    ):
        cells = [ended(*side, motions) for side in sides]
        first, second = (estimate(side).value for side in cells)
        minus = [cell._replace(weight=-cell.weight) for cell in cells[1]]
        rows.append((text, first, second, estimate([*cells[0], *minus])))
    return rows


def ended(method: Standing, variant: str, tasks: Iterable[str], motions: set[tuple[int, int]]) -> list[Cell]:
    """Which of the unsolved episodes have in their last quarter, in 90 % of its steps, one of these motions.

    A motion is the pair (turn, drive) of an action's parts. Tasks count by their unsolved episodes.
    """
    flags: dict[str, dict[tuple[int, int], float]] = defaultdict(dict)
    for episode in method.entry.counted:
        if episode.variant == variant and episode.task in tasks and episode.score < 1:
            parts = [(action.turn, action.drive) for action in map(ACTIONS.__getitem__, actions_of(episode.actions))]
            last = parts[-(len(parts) // 4) :]
            same = max(sum(part == motion for part in last) for motion in motions)
            flags[episode.task][episode.run, episode.seed] = float(same >= 0.9 * len(last))
    total = sum(map(len, flags.values()))
    cells = []
    for task, by_episode in flags.items():
        runs, seeds = (sorted({key[place] for key in by_episode}) for place in (0, 1))
        scores = np.array([[by_episode.get((run, seed), np.nan) for seed in seeds] for run in runs])
        cells.append(Cell(scores, len(by_episode) / total, (method.name, task), (method.name, variant, task)))
    return cells


if __name__ == "__main__":
    from tools.scores import compared_with_the_paper

    print(claims(compared_with_the_paper()))
