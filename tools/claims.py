"""The paper's claims about its methods, compared with the same figures of ours, by the same rules."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from magical_mj import ENVIRONMENTS, TASKS
from magical_mj.leaderboard.standings import Standing
from magical_mj.policies.interface import actions_of
from magical_mj.scene.actions import ACTIONS
from tools.pages import table

COMPARED: Final = ("BC (ST)", "BC (MT)", "GAIL (ST)", "GAIL (MT)", "WGAIL-GP (ST)", "AL (ST)")
"""The paper's methods with its default settings."""
ABLATIONS: Final = ("BC (ST)", "BC (ST, no trans./rot. aug.)", "BC (ST, no aug.)", "BC (ST, allo.)")
"""The paper's BC and its ablations. Ours, with --quick, have the same names."""
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
"""The paper's methods -> ours that are compared with its claims: five or three runs in all environments, by the same
rules."""
DIFFERENT: Final = 0.02
"""Two figures that differ by less are called equal."""


class Claim(NamedTuple):
    """What the paper says of two figures, and the figures, whose order the claim gives."""

    text: str
    first: float
    second: float
    said: str = "more"

    @property
    def holds(self) -> bool:
        """Whether the figures have the order that is claimed."""
        difference = self.first - self.second
        return self.said == ("equal" if abs(difference) < DIFFERENT else "more" if difference > 0 else "less")


def claims(methods: Mapping[str, Standing], paper: Iterable[Standing]) -> str:
    """The paper's claims, each with two of its figures and the same two of ours, by where they hold."""
    papers = {method.name: method for method in paper}
    papers[CLONED] = papers["BC (ST)"]
    ours = {name: methods[our_name] for name, our_name in OURS.items()}
    verdicts = {
        (True, True): "in both",
        (True, False): "only in the paper",
        (False, True): "only here",
        (False, False): "in neither",
    }
    rows: dict[str, list[Sequence[str]]] = {verdict: [] for verdict in verdicts.values()}
    for theirs, here in zip(_claimed(papers), _claimed(ours), strict=True):
        figures = (f"{claim.first:.2f}, {claim.second:.2f}" for claim in (theirs, here))
        rows[verdicts[theirs.holds, here.holds]].append((theirs.text, *figures))
    for claim in _seen(ours):
        rows[verdicts[True, claim.holds]].append((claim.text, "", f"{claim.first:.2f}, {claim.second:.2f}"))
    groups = [row for verdict, group in rows.items() if group for row in ((f"**Holds {verdict}**", "", ""), *group)]
    return table(("The paper's claim", "Its numbers", "Ours"), groups)


def _claimed(methods: Mapping[str, Standing]) -> list[Claim]:
    """The claims with figures."""
    cloned, bc, bc_all, from_above, unmoved, plain = (
        methods[name] for name in (CLONED, "BC (ST)", "BC (MT)", "BC (ST, allo.)", ABLATIONS[1], ABLATIONS[2])
    )
    gail, gail_all, wgail, al = (methods[name] for name in COMPARED[2:])
    both = [task for task in TASKS if (task, "Shape") in ENVIRONMENTS]
    lost = {name: 1 - _mean(bc, (name,), both) / _mean(bc, ("Demo",), both) for name in ("Colour", "Shape")}
    al_demo = {task: _mean(al, ("Demo",), (task,)) for task in TASKS}
    jitter = [_mean(method, ("Jitter",)) for method in (bc, unmoved, plain)]

    def best(*without: str) -> float:
        return max(score for task, score in al_demo.items() if task not in without)

    def pair(claim: str, variant: str, large: Standing, small: Standing, task: str = "", said: str = "more") -> Claim:
        tasks, where = ((task,), f"{variant}, {task}") if task else (TASKS, variant)
        return Claim(f"{claim} ({where})", _mean(large, (variant,), tasks), _mean(small, (variant,), tasks), said)

    return [
        Claim("BC loses more of Demo's score in Colour than in Shape (seven tasks)", lost["Colour"], lost["Shape"]),
        pair("GAIL > BC", "Demo", gail, cloned),
        pair("GAIL > BC", "Layout", gail, cloned),
        pair("BC > GAIL", "Colour", cloned, gail),
        pair("GAIL > WGAIL-GP", "Demo", gail, wgail),
        Claim("AL solves only MoveToCorner (Demo; the best other task)", al_demo["MoveToCorner"], best("MoveToCorner")),
        Claim("AL solves only MoveToRegion (Demo; the best other task)", al_demo["MoveToRegion"], best("MoveToRegion")),
        pair("BC ST > MT", "Demo", bc, bc_all),
        pair("GAIL ST > MT", "Demo", gail, gail_all),
        pair("BC MT > ST", "Demo", bc_all, bc, "FixColour"),
        *(pair("BC ST > MT", "Colour", bc, bc_all, task) for task in ("MoveToCorner", "MatchRegions", "FindDupe")),
        pair("BC ego > allo", "Layout", bc, from_above),
        pair("BC > without augmentations", "Jitter", bc, plain),
        Claim(
            "Translation and rotation give most of that (Jitter: their gain, the others')",
            jitter[0] - jitter[1],
            jitter[1] - jitter[2],
        ),
        pair("BC > without translation and rotation", "Colour", bc, unmoved, "FindDupe"),
        pair("Colour jitter and noise alone change little", "Colour", unmoved, plain, said="equal"),
    ]


def _seen(methods: Mapping[str, Standing]) -> list[Claim]:
    """The claims about what policies do, for which the paper has no figures."""
    bc, from_above = methods["BC (ST)"], methods["BC (ST, allo.)"]
    turning = [
        max(ended(method, "Layout", ("MoveToRegion",), {(turn, 0)}) for turn in (1, 2)) for method in (from_above, bc)
    ]
    return [
        Claim(
            "BC freezes in new colours (episodes that end without movement: Colour, Demo)",
            ended(bc, "Colour", TASKS, {(0, 0)}),
            ended(bc, "Demo", TASKS, {(0, 0)}),
        ),
        Claim(
            "BC allo spins in MoveToRegion's Layout (episodes that end turning in place; ego)",
            turning[0],
            turning[1],
        ),
    ]


def ended(method: Standing, variant: str, tasks: Iterable[str], motions: set[tuple[int, int]]) -> float:
    """The share of episodes below the full score whose last quarter has, in 90 % of its steps, these motions.

    A motion is the pair (turn, drive) of an action's parts.
    """
    flags = []
    for episode in method.entry.counted:
        if episode.variant == variant and episode.task in tasks:
            parts = [(action.turn, action.drive) for action in map(ACTIONS.__getitem__, actions_of(episode.actions))]
            last = parts[-(len(parts) // 4) :]
            flags.append(episode.score < 1 and sum(part in motions for part in last) >= 0.9 * len(last))
    return sum(flags) / len(flags)


def _mean(method: Standing, variants: Sequence[str], tasks: Sequence[str] = TASKS) -> float:
    """The mean over the environments of these variants and tasks; over all tasks, the paper's as it is printed."""
    if tasks == TASKS and len(variants) == 1:
        return method.scores[variants[0]].value
    return method.mean((task, variant) for task, variant in ENVIRONMENTS if task in tasks and variant in variants).value
