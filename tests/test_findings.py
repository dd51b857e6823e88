"""The figures and comparisons in the text of docs/results.md are those of the entries in results/ and of the paper."""

from __future__ import annotations

import random
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from demonstration_statistics import STATISTICS

from magical_mj import TASKS, demos, sample_scene
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.statistics import rank_correlation
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.leaderboard.standings import ABOVE, GROUPS, Standing, published
from magical_mj.scene import constants as c
from tools import released
from tools.claims import OURS
from tools.demonstration_sets import lost
from tools.scores import by_released_rules, own_methods

pytestmark = pytest.mark.xdist_group("results")  # which are read once

ROOT = Path(__file__).parent.parent
TEXT = " ".join(
    line
    for line in (ROOT / "docs" / "results.md").read_text("utf-8").splitlines()
    if not line.startswith(("|", "#", "![", "<!--"))
)
PROSE = " ".join(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", TEXT).replace("**", "").replace("`", "").split())
RELEASED = " by released rules"
REPLAYED = 0.7
"""From this mean score on, replaying a demonstration counts as enough in an environment."""
VERDICTS = {"in both", "only in the paper", "only here", "in neither"}


@cache
def methods() -> Mapping[str, Standing]:
    """Our entries by their folders' names, also by the released rules, and the paper's with a dagger."""
    own, rescored = own_methods(), {method.name: method for method in by_released_rules()}
    same = {f"{folder}{RELEASED}": rescored[entry.name] for folder, entry in own.items() if entry.name in rescored}
    return own | same | {f"{standing.name}†": standing for standing in published()}


def mean(name: str, *variants: str, tasks: Iterable[str] = TASKS, without: str = "") -> float:
    """The mean over the environments of these variants and tasks."""
    chosen = set(tasks) - {without}
    means = methods()[name].means
    return float(np.mean([means[pair].mean() for pair in means if pair[1] in variants and pair[0] in chosen]))


def score(name: str, column: str = ABOVE) -> float:
    """One of a method's scores on the leaderboard."""
    return methods()[name].scores[column].value


def same_block(name: str) -> tuple[int, float, float]:
    """In FixColour's Colour: scenes whose wrong block is that of the demonstrations; the scores there and elsewhere."""

    def wrong(variant: str, seed: int) -> list[bool]:
        scene = sample_scene("FixColour", variant, seed)
        return [block.colour != region.colour for block, region in zip(scene.blocks, scene.regions, strict=True)]

    same = np.array([wrong("Colour", seed) == wrong("Demo", 0) for seed in range(100)])
    runs = np.array(list(methods()[name].episodes["FixColour", "Colour"].values()))
    return int(same.sum()), runs[:, same].mean(), runs[:, ~same].mean()


def order(name: str, paper: str) -> float:
    """The rank correlation with the paper's method."""
    return rank_correlation(methods()[name].means, methods()[paper].means)


def imitating(block: str) -> list[str]:
    """Our methods of a block that were evaluated in all environments."""
    return [name for name, method in methods().items() if method.block == block and method.everywhere]


PIXELS, STATES, RELATIONAL, DRAWN = "pixels-bc-quick", "state-bc", "state-relational", "pixels-redraw-quick"
GAIL, CLONED, AL = "GAIL (ST)†", "BC (ST)†", "AL (ST)†"
REGION = ["MoveToRegion"]


@cache
def statements() -> list[str]:
    """The sentences with figures that the page must contain, without emphasis and links."""
    rest = {"without": "MoveToRegion"}
    needed = {task: mean("replay", "Colour", tasks=[task]) for task in ("FixColour", "ClusterColour")}
    blind = [mean("replay", "Colour", tasks=[task]) for task in TASKS if task not in needed]
    fair, full = f"{PIXELS}{RELEASED}", methods()["pixels-bc"].means
    same = [f"{name}{RELEASED}" for name in ("state-gail", "state-wgail-gp", "state-al")]
    agreement = [order(fair, CLONED), order(same[0], GAIL), order(same[1], "WGAIL-GP (ST)†"), order(same[2], AL)]
    found: list[tuple[str, *tuple[float, ...]]] = [
        (
            "In the memory variants, BC scores # from pictures and # from states.",
            score(PIXELS, "Memory"),
            score(STATES, "Memory"),
        ),
        (
            "(the entry pixels-bc) differs from quick by up to # in the 14 environments.",
            max(abs(float(runs.mean() - methods()[PIXELS].means[pair].mean())) for pair, runs in full.items()),
        ),
        (
            "In Demo, two runs with 80,000 steps score #, and one policy for all tasks, with 240,000 steps, #.",
            mean("pixels-gail-quick", "Demo"),
            mean("pixels-gail-multi-quick", "Demo"),
        ),
        ("the best from pictures has #,", max(map(score, imitating("pictures")))),
        ("the best from states # (AIRL, not in the table).", max(map(score, imitating("states")))),
        ("The paper's best, GAIL, has # by its own rules of scores.", score(GAIL)),
        ("only if its score in the demo scene holds, and has # above doing nothing.", score(RELATIONAL)),
        ("draws such scenes as pictures, and has #.", score(DRAWN)),
        ("MoveToRegion's Layout it scores #,", mean(DRAWN, "Layout", tasks=REGION)),
        (
            "in the Layout of the other tasks #, where BC scores #.",
            mean(DRAWN, "Layout", **rest),
            mean(PIXELS, "Layout", **rest),
        ),
        ("BC has # with 25 demonstrations and # with 10.", score("state-bc-25"), score(STATES)),
        ("goals has # above doing nothing.", score("state-goals")),
        ("scores # in All and # in Layout,", score(PIXELS, "All"), score(PIXELS, "Layout")),
        ("Without this task, it scores # in All.", mean(PIXELS, "All", without="MoveToCorner")),
        (
            "BC scores # from pictures and # from states, and Diffusion Policy # and #.",
            mean(PIXELS, "Layout", tasks=REGION),
            mean(STATES, "Layout", tasks=REGION),
            mean("diffusion", "Layout", tasks=REGION),
            mean("diffusion-state", "Layout", tasks=REGION),
        ),
        ("In these tasks it scores # in Colour,", min(blind)),
        ("Only FixColour and ClusterColour (# and #) require", *needed.values()),
        ("solves %% of these scenes and %% of the others", *same_block(PIXELS)[1:]),
        ("BC from states %% and %%", *same_block(STATES)[1:]),
        ("relational %% and %%.", *same_block(RELATIONAL)[1:]),
        ("is # for BC from pictures, # for GAIL from states, # for WGAIL-GP and # for AL.", *agreement),
    ]
    return [filled(text, *figures) for text, *figures in found]


def filled(text: str, *figures: float) -> str:
    """The text with a figure for each # (two decimals) and %% (per cent)."""
    remaining = iter(figures)
    written = {"#": lambda: f"{next(remaining):.2f}", "%%": lambda: f"{100 * next(remaining):.0f} %"}
    return re.sub("#|%%", lambda found: written[found[0]](), text)


def test_statements_have_the_figures_of_the_entries() -> None:
    assert [statement for statement in statements() if statement not in PROSE] == []


def test_no_other_sentence_has_a_score() -> None:
    text = re.sub(r"arXiv:[\d.]+", "", PROSE)
    bound = [range(found.start(), found.end()) for said in statements() for found in re.finditer(re.escape(said), text)]
    figures = re.finditer(r"\d\.\d\d|\d+ %(?! intervals)", text)
    loose = [found for found in figures if not any(found.start() in part for part in bound)]
    assert [text[found.start() - 40 : found.end() + 20] for found in loose] == []


def test_comparisons_hold() -> None:
    assert same_block(PIXELS)[0] == 34
    assert "In 34 of the 100 Colour scenes, " in PROSE
    paper = [name for name in methods() if name.endswith("†")]
    assert max(paper, key=score) == GAIL
    assert max(imitating("states"), key=score) == "state-airl"
    assert [runs.shape for runs in methods()["pixels-bc"].means.values()] == [(1,)] * 14
    layouts = [task for task in TASKS if task != "MoveToCorner"]
    gains = {task: mean(DRAWN, "Layout", tasks=[task]) - mean(PIXELS, "Layout", tasks=[task]) for task in layouts}
    assert gains["MoveToRegion"] > sum(gains.values()) / 2
    assert mean("pixels-point-quick", "Layout") <= mean(PIXELS, "Layout", tasks=["MoveToRegion", "FixColour"])
    learners = imitating("pictures") + imitating("states")
    solved = {
        name: [
            task
            for task in TASKS
            if (task, name) in methods()["replay"].means and mean("replay", name, tasks=[task]) >= REPLAYED
        ]
        for name in GROUPS["Distraction"]
    }
    assert sorted({*TASKS} - {*solved["Colour"]}) == ["ClusterColour", "FixColour"]
    assert len(solved["Shape"]) == 2
    for name in learners:
        assert mean(name, "Colour", tasks=solved["Colour"]) < mean("replay", "Colour", tasks=solved["Colour"])
    claims = (ROOT / "docs" / "results.md").read_text("utf-8").partition("| Its numbers |")[2].partition("<!--")[0]
    verdict, verdicts = "", dict[str, str]()
    for line in claims.splitlines()[2:]:
        claim = line.split("|")[1].strip()
        if heading := re.fullmatch(r"\*\*Holds (.*)\*\*", claim):
            verdict = heading[1]
        else:
            verdicts[claim] = verdict
    assert len(verdicts) == 20
    assert {*verdicts.values()} <= VERDICTS
    only = {claim.split()[3]: verdict for claim, verdict in verdicts.items() if claim.startswith("AL solves only")}
    assert only == {"MoveToCorner": "in neither", "MoveToRegion": "in both"}
    assert {verdict for claim, verdict in verdicts.items() if claim.startswith("GAIL > BC")} == {"only in the paper"}
    assert sum(verdict == "in both" for verdict in verdicts.values()) > len(verdicts) / 2


def test_the_range_of_jitter_is_named_where_one_moves_from_the_original() -> None:
    page = " ".join((ROOT / "docs" / "moving.md").read_text("utf-8").split())
    share = 100 * c.JITTER_POSITION / 2
    assert f"up to {c.JITTER_POSITION:g} on each axis of the arena, which is 2 wide: {share:g} %" in page
    assert f"up to {c.JITTER_ANGLE:.3f} rad" in page
    assert f"regions' sides by up to {c.JITTER_REGION_SIZE:g}" in page


def test_the_demonstrations_page_has_the_scores_of_behavioural_cloning() -> None:
    page = " ".join((ROOT / "docs" / "demonstrations.md").read_text("utf-8").split())
    assert f"scores {mean(STATES, 'Demo'):.2f} in Demo and {mean(STATES, 'Jitter'):.2f} in Jitter with ours" in page


def test_the_demonstrations_page_says_how_much_set_2_costs() -> None:
    page = " ".join((ROOT / "docs" / "demonstrations.md").read_text("utf-8").split())
    states, pictures = lost(STATES, TASKS)[1], lost("pixels-bc-quick", TASKS)[1]
    assert f"BC loses {states:.0%} of its score from states and {pictures:.0%} from" in page.replace(" %", "%")
    losses = {task: lost("state-gail", [task])[0] for task in TASKS}
    worst, *others = sorted(losses.values(), reverse=True)
    assert losses["MatchRegions"] == worst
    assert (
        f"loses {lost('state-gail', TASKS)[1]:.0%}: {worst:.2f} in MatchRegions (one run), and at most"
        in page.replace(" %", "%")
    )
    assert f"at most {others[0]:.2f} in each other task." in page


def test_the_demonstrations_page_has_the_statistics_of_the_demonstrations() -> None:
    page = (ROOT / "docs" / "demonstrations.md").read_text("utf-8")
    table = page.partition("| | set 1 | set 2 | people |")[2].split("\n\n")[0].splitlines()[2:]
    shipped = {number: [demos.load(task, set=number) for task in TASKS] for number in (1, 2)}
    for line, statistic in zip(table, STATISTICS.values(), strict=True):
        for number, of_tasks in shipped.items():
            shown = line.split("|")[1 + number].strip()
            decimals = len(shown.partition(".")[2])
            assert f"{np.mean([statistic(of_task) for of_task in of_tasks]):.{decimals}f}" == shown, line


def test_scores_by_the_released_rules_follow_from_the_actions() -> None:
    """Of each entry that has them, a few episodes: replayed, those that differ, and others."""
    chosen: list[tuple[str, EpisodeResult]] = []
    by_rules: dict[str, dict[str, float]] = {}
    for name, own in own_methods().items():
        if entry := released.by_released_rules(own.entry, ROOT / "results" / name):
            by_rules[name] = {episode.title: episode.score for episode in entry.episodes}
            same = {episode.title: episode.score for episode in own.entry.episodes}
            differing = [title for title, score in by_rules[name].items() if score != same[title]]
            drawn = random.Random(name).sample(differing, 2) + random.Random(name).sample(list(by_rules[name]), 1)
            chosen += [(name, episode) for episode in own.entry.episodes if episode.title in drawn]
    assert len(by_rules) >= len(set(OURS.values()))
    for name, episode, problem in replay(chosen, rules="released", jobs=1):
        assert problem is None
        assert episode.score == pytest.approx(by_rules[name][episode.title], abs=1e-6)
