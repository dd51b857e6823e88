"""The figures and comparisons in docs/results.md and results-paper.md are those of the entries and of the paper."""

from __future__ import annotations

import random
import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from demonstration_statistics import STATISTICS

from magical_mj import ENVIRONMENTS, TASKS, VARIANTS, demos, sample_scene
from magical_mj.evaluation.replay import replay
from magical_mj.evaluation.reports.intervals import Estimate, estimate
from magical_mj.evaluation.reports.statistics import rank_correlation
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.leaderboard.standings import ABOVE, COMMON, GROUPS, Standing, difference, published
from magical_mj.scene import constants as c
from tools import fresh_scenes, pretraining
from tools.claims import COMPARABLE, FEW, OURS, claims, compared, verdict
from tools.demonstration_sets import ENTRIES, gained, lost
from tools.scores import by_released_rules, compared_with_the_paper, own_methods
from tools.test_scenes import right_first

pytestmark = pytest.mark.xdist_group("results")  # which are read once

ROOT = Path(__file__).parents[2]
RELEASED = " by released rules"
REPLAYED = 0.7
"""From this mean score on, replaying a demonstration counts as enough in an environment."""


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
    """The rank correlation with the paper's method, over the environments that are compared."""
    first, second = (
        {pair: means for pair, means in methods()[each].means.items() if pair in COMPARABLE} for each in (name, paper)
    )
    return rank_correlation(first, second)


def imitating(block: str) -> list[str]:
    """Our methods of a block that were evaluated in all environments."""
    return [name for name, method in methods().items() if method.block == block and method.everywhere]


PIXELS, STATES, RELATIONAL, DRAWN = "pixels-bc-quick", "state-bc", "state-relational", "pixels-redraw-quick"
GAIL, CLONED, AL = "GAIL (ST)†", "BC (ST)†", "AL (ST)†"
REGION = ["MoveToRegion"]
LOOKING = ["FixColour", "ClusterColour"]
"""The tasks whose Colour requires looking at colours."""
BLIND = [task for task in TASKS if task not in LOOKING]
WITH_LAYOUT = [task for task in TASKS if task != "MoveToCorner"]


def less(first: str, second: str, *variants: str, tasks: Iterable[str] = COMMON) -> Estimate:
    """The difference of two methods' means over the environments that both have played."""
    pairs = [pair for pair in ENVIRONMENTS if pair[0] in tasks and pair[1] in (variants or GROUPS["Generalisation"])]
    return difference(methods()[first], methods()[second], pairs)


@cache
def findings() -> dict[str, list[float | str | Estimate]]:
    """Paragraph of these pages -> its figures, in their order. Differences are decided, or it says "undecided".

    Means have two decimals, shares are texts, and differences have a sign and an interval.
    """
    fair = f"{PIXELS}{RELEASED}"
    same = [f"{name}{RELEASED}" for name in ("state-gail", "state-wgail-gp", "state-al")]
    solved = [f"{100 * share:.0f} %" for name in (PIXELS, STATES, RELATIONAL) for share in same_block(name)[1:]]
    return {
        "Most methods remember.": [score(name, "Memory") for name in (PIXELS, STATES, "replay")],
        "Methods that only imitate hardly generalise.": [
            max(map(score, imitating("pictures"))),
            max(map(score, imitating("states"))),
            less(PIXELS, "replay"),
            less(STATES, "replay"),
        ],
        "They lack intent and skill.": [
            f"{100 * figure.value:.0f} %"
            for figure in (*right_first(PIXELS), right_first("random")[0], right_first(STATES)[0])
            if figure is not None
        ],
        "Is the smaller network the cause?": [
            less("pixels-bc", PIXELS, *VARIANTS, tasks=TASKS),
            less("pixels-bc", PIXELS, "Layout", tasks=TASKS),
        ],
        "Short trainings of GAIL from images learn little.": [
            mean("pixels-gail-quick", "Demo"),
            mean("pixels-gail-multi-quick", "Demo"),
        ],
        "More demonstrations of the scene change little.": [less("state-bc-25", STATES)],
        "Methods with assumptions about tasks score more.": [
            score(RELATIONAL),
            less(DRAWN, PIXELS),
            *(less(DRAWN, PIXELS, tasks=[task]) for task in ("FixColour", "MakeLine", "MatchRegions")),
            mean(DRAWN, "Layout", tasks=REGION),
            mean(PIXELS, "Layout", tasks=REGION),
        ],
        "Does `relational` score less in scenes that nobody had played?": [
            fresh_scenes.compared(fresh_scenes.tasks())[2]
        ],
        "The scenes can be solved.": [score("state-goals")],
        "BC from images scores more in Layout than from states.": [
            less(PIXELS, STATES, "Layout", tasks=WITH_LAYOUT),
            mean("diffusion", "Layout", tasks=REGION),
            mean("diffusion-state", "Layout", tasks=REGION),
        ],
        "In six of the eight tasks, Colour tests distraction, not reasoning.": [
            mean("replay", "Colour", tasks=BLIND),
            max(mean(name, "Colour", tasks=BLIND) for name in imitating("pictures") + imitating("states")),
            *(mean("replay", "Colour", tasks=[task]) for task in LOOKING),
        ],
        "In FixColour, BC learns a position, not a colour.": [*solved],
        "The same environments are hard.": [
            order(fair, CLONED),
            order(same[0], GAIL),
            order(same[1], "WGAIL-GP (ST)†"),
            order(same[2], AL),
            order(f"replay{RELEASED}", CLONED),
            order(f"replay{RELEASED}", GAIL),
        ],
    }


def written(figure: float | str | Estimate) -> str:
    if isinstance(figure, Estimate):
        return "{:+.2f} [{:+.2f}, {:+.2f}]".format(*(round(end, 2) + 0.0 for end in figure))  # no -0.00
    return figure if isinstance(figure, str) else f"{figure:.2f}"


def paragraphs() -> dict[str, str]:
    """The bold beginning of each paragraph of the pages of results -> its text, without links; "" -> all other text."""
    found = {"": ""}
    pages = "".join((ROOT / "docs" / f"{name}.md").read_text("utf-8") for name in ("results", "results-paper"))
    for part in re.split(r"\n(?=- )|\n\n", pages):
        text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", " ".join(part.split()))
        if text.startswith(("|", "#", "![", "<!--")):
            continue
        title = re.match(r"(?:- )?\*\*(.*?)\*\*", text)
        if title:
            found[title[1]] = text
        else:
            found[""] += text
    return found


FIGURE = re.compile(r"[+-]\d\.\d\d \[[+-]\d\.\d\d, [+-]\d\.\d\d\]|\d\.\d\d|\d+ %(?! interval)")


def test_paragraphs_have_the_figures_of_the_entries() -> None:
    for title, figures in findings().items():
        text = paragraphs()[title]
        assert FIGURE.findall(text) == [*map(written, figures)], title
        undecided = not all(figure.decided for figure in figures if isinstance(figure, Estimate))
        assert undecided == bool(re.search("undecided|change little", text, re.IGNORECASE)), title


def test_no_other_paragraph_has_a_figure() -> None:
    others = " ".join(text for title, text in paragraphs().items() if title not in findings())
    assert FIGURE.findall(re.sub(r"arXiv:[\d.]+", "", others)) == []


def test_comparisons_hold() -> None:
    assert same_block(PIXELS)[0] == 34
    assert "In 34 of the 100 Colour scenes, " in paragraphs()["In FixColour, BC learns a position, not a colour."]
    first = {name: right_first(name)[0] or Estimate(np.nan) for name in (PIXELS, STATES, "random")}
    assert first[PIXELS].low > first["random"].high
    assert first[STATES].value < first["random"].value
    assert max(imitating("states"), key=score) == "state-airl"
    gained = [task for task in COMMON if less(DRAWN, PIXELS, tasks=[task]).decided]
    assert sorted(gained) == ["FixColour", "MakeLine", "MatchRegions"]
    assert [runs.shape for runs in methods()["pixels-bc"].means.values()] == [(1,)] * 14
    solved = {
        name: [
            task
            for task in TASKS
            if (task, name) in methods()["replay"].means and mean("replay", name, tasks=[task]) >= REPLAYED
        ]
        for name in GROUPS["Distraction"]
    }
    assert solved["Colour"] == BLIND
    assert len(solved["Shape"]) == 2
    for name in imitating("pictures") + imitating("states"):
        assert less("replay", name, "Colour", tasks=BLIND).low > 0


def test_pretraining_improves_colour_in_one_of_two_tasks() -> None:
    """From states, by seven other tasks, compared with as many batches on the task itself."""
    page = (ROOT / "docs" / "pretraining.md").read_text("utf-8").replace("\n", " ")
    scores = pretraining.stored()
    starts = pretraining.Start("State", "cloning", 7, 3000), pretraining.Start("State", "scratch", 0, 9000)
    for task, decided in (("MatchRegions", True), ("FixColour", False)):
        own = {start: {key: found for key, found in scores[start].items() if key[0] == task} for start in starts}
        cells = [
            cell
            for start, sign in zip(starts, (1, -1), strict=True)
            for cell in pretraining.cells(own, start, "Colour", sign)
        ]
        gain = estimate(cells)
        assert gain.decided == decided
        assert written(gain) in page


def test_the_verdicts_on_the_papers_claims_follow_the_rule() -> None:
    """By hand: intervals above, around and below 0, and two nearly equal scores."""
    verdicts = [verdict(Estimate(0.1, *ends)) for ends in ((0.05, 0.2), (-0.1, 0.2), (-0.3, -0.1), (np.nan, np.nan))]
    assert verdicts == ["Holds", "Undecided", "Fails", "No data"]
    equal = [verdict(Estimate(0.0, *ends), equal=True) for ends in ((-0.04, 0.04), (-0.1, 0.04), (0.01, 0.04))]
    assert equal == ["Holds", "Undecided", "Fails"]
    rows = {row.claim: row.verdict for row in compared(compared_with_the_paper())}
    assert {said for claim, said in rows.items() if claim.startswith("GAIL > BC (")} == {"Undecided", "Fails"}
    counts = [sum(said == kind for said in rows.values()) for kind in ("Holds", "Undecided", "Fails")]
    page = (ROOT / "docs" / "results-paper.md").read_text("utf-8")
    assert "{} hold here, {} are undecided and {} fail".format(*counts) in page.replace("\n", " ")
    assert f"\n{claims(compared_with_the_paper())}" in (ROOT / "docs" / "results-paper.md").read_text("utf-8")


def test_ours_from_pictures_have_the_same_scores_by_both_rules() -> None:
    """The claims compare them with scores by the released rules."""
    for name in (PIXELS, STATES, "state-gail"):
        for task in FEW:
            assert mean(name, *VARIANTS, tasks=[task]) == mean(f"{name}{RELEASED}", *VARIANTS, tasks=[task])


def test_readme_compares_the_tasks_that_have_both_variants() -> None:
    readme = " ".join((ROOT / "README.md").read_text("utf-8").split())
    demo, layout = (mean(PIXELS, variant, tasks=WITH_LAYOUT) for variant in ("Demo", "Layout"))
    assert f"scores {demo:.2f} in the scene of the demonstrations, and {layout:.2f} if all poses are new" in readme


def test_the_range_of_jitter_is_named_where_one_moves_from_the_original() -> None:
    page = " ".join((ROOT / "docs" / "moving.md").read_text("utf-8").split())
    share = 100 * c.JITTER_POSITION / 2
    assert f"up to {c.JITTER_POSITION:g} on each axis of the arena, which is 2 wide: {share:g} %" in page
    assert f"up to {c.JITTER_ANGLE:.3f} rad" in page
    assert f"regions' sides by up to {c.JITTER_REGION_SIZE:g}" in page


def test_the_demonstrations_page_has_the_scores_of_behavioural_cloning() -> None:
    page = " ".join((ROOT / "docs" / "demonstration-sets.md").read_text("utf-8").split())
    assert f"scores {mean(STATES, 'Demo'):.2f} in Demo and {mean(STATES, 'Jitter'):.2f} in Jitter with ours" in page


def test_the_demonstrations_page_says_how_much_set_2_costs() -> None:
    page = " ".join((ROOT / "docs" / "demonstration-sets.md").read_text("utf-8").split())
    states, pictures = lost(STATES, TASKS)[1], lost("pixels-bc-quick", TASKS)[1]
    assert f"BC loses {states:.0%} of its score from states and {pictures:.0%} from" in page.replace(" %", "%")
    decided = {(name, variant): gained(name, variant) for name in ENTRIES for variant in ("Layout", "All")}
    assert [found for found in decided.items() if found[1].decided] == [((STATES, "All"), decided[STATES, "All"])]
    assert f"BC from states loses in All ({written(decided[STATES, 'All'])})" in page
    losses = {task: lost("state-gail", [task])[0] for task in TASKS}
    worst, *others = sorted(losses.values(), reverse=True)
    assert losses["MatchRegions"] == worst
    assert (
        f"loses {lost('state-gail', TASKS)[1]:.0%}. It loses {worst:.2f} in MatchRegions (one run), and at most"
        in page.replace(" %", "%")
    )
    assert f"at most {others[0]:.2f} in each other task." in page


@pytest.mark.weekly
def test_the_demonstrations_page_has_the_statistics_of_the_demonstrations() -> None:
    page = (ROOT / "docs" / "demonstration-sets.md").read_text("utf-8")
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
    others = {method.name: method.entry for method in by_released_rules()}
    for name, own in own_methods().items():
        if entry := others.get(own.name):
            by_rules[name] = {episode.title: episode.score for episode in entry.episodes}
            same = {episode.title: episode.score for episode in own.entry.episodes}
            differing = [title for title, score in by_rules[name].items() if score != same[title]]
            drawn = random.Random(name).sample(differing, 1) + random.Random(name).sample(list(by_rules[name]), 1)
            chosen += [(name, episode) for episode in own.entry.episodes if episode.title in drawn]
    assert len(by_rules) >= len(set(OURS.values()))
    for name, episode, problem in replay(chosen, rules="released", jobs=1):
        assert problem is None
        assert episode.score == pytest.approx(by_rules[name][episode.title], abs=1e-6)
