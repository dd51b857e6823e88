"""The figures and comparisons in the text of docs/results.md are those of the entries in results/ and of the paper."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from demonstration_statistics import STATISTICS

from magical_mj import TASKS, VARIANTS, demos, sample_scene
from magical_mj.evaluation.reports.statistics import rank_correlation
from magical_mj.leaderboard.standings import Standing, own_standings, published

ROOT = Path(__file__).parent.parent
TEXT = " ".join(
    line
    for line in (ROOT / "docs" / "results.md").read_text("utf-8").splitlines()
    if not line.startswith(("|", "#", "![", "<!--"))
)
PROSE = " ".join(re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", TEXT).replace("**", "").split())
MEMORY, DISTRACTION, GENERALISATION = (
    ("Demo", "Jitter", "Dynamics"),
    ("Colour", "Shape"),
    ("Layout", "CountPlus", "All"),
)


@cache
def methods() -> Mapping[str, Standing]:
    """Our entries by their folders' names, and the paper's methods by their names with a dagger."""
    return own_standings(ROOT / "results") | {f"{standing.name}†": standing for standing in published()}


def mean(name: str, *variants: str, tasks: Iterable[str] = TASKS, without: str = "") -> float:
    """The mean over the environments of these variants and tasks."""
    chosen = set(tasks) - {without}
    means = methods()[name].means
    return float(np.mean([means[pair].mean() for pair in means if pair[1] in variants and pair[0] in chosen]))


def lost(name: str, variant: str) -> float:
    """The part of Demo's score that a method loses, over the seven tasks that have both Colour and Shape."""
    tasks = [task for task in TASKS if (task, "Shape") in methods()["noop"].means]
    assert len(tasks) == 7
    return 1 - mean(name, variant, tasks=tasks) / mean(name, "Demo", tasks=tasks)


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


def best(names: Iterable[str], *variants: str) -> float:
    """The highest mean of these methods."""
    return max(mean(name, *variants) for name in names)


def together(variants: Iterable[str]) -> float:
    """The lowest correlation of two variants' means, over the complete methods from pictures and from states."""
    names = [name for name, method in methods().items() if method.everywhere and method.block in ("pictures", "states")]
    return np.corrcoef([[mean(name, variant) for name in names] for variant in variants]).min()


def imitating(block: str) -> list[str]:
    """Our methods of a block that were evaluated in all environments, without those that use more than states."""
    return [
        name
        for name, method in methods().items()
        if method.block == block
        and method.kind != "published"
        and method.everywhere
        and "score in training" not in method.privileges
    ]


PIXELS, STATES, OURS, DRAWN = "pixels-bc-quick", "state-bc", "state-relational", "pixels-redraw-quick"
GAIL, CLONED, AL = "GAIL (ST)†", "BC (ST)†", "AL (ST)†"
CORNER, REGION, COLOUR, SHAPE = ["MoveToCorner"], ["MoveToRegion"], ["ClusterColour"], ["ClusterShape"]


@cache
def statements() -> list[str]:
    """The sentences with figures that the page must contain, without emphasis and links."""
    rest = {"without": "MoveToRegion"}
    plain = methods()["pixels-gail-no-augmentation-quick"].means["MoveToRegion", "Demo"]
    needed = {task: mean("replay", "Colour", tasks=[task]) for task in ("FixColour", "ClusterColour")}
    found: list[tuple[str, *tuple[float, ...]]] = [
        ("at least # in memory, # in distraction", together(MEMORY), together(DISTRACTION)),
        ("and # in generalisation.", together(GENERALISATION)),
        ("That of Demo and Layout is #.", together(("Demo", "Layout"))),
        ("BC from pictures scores # in the memory group", mean(PIXELS, *MEMORY)),
        ("in the memory group, and BC from states #.", mean(STATES, *MEMORY)),
        ("The best of ours from pictures scores #", best(imitating("pictures"), *GENERALISATION)),
        ("the best from states #", best(imitating("states"), *GENERALISATION)),
        ("and the paper's best, GAIL, #.", mean(GAIL, *GENERALISATION)),
        ("It scores # in the generalisation group", mean(OURS, *GENERALISATION)),
        ("and # without MoveToRegion.", mean(OURS, *GENERALISATION, **rest)),
        ("shows the same assumptions in pictures and scores #.", mean(DRAWN, *GENERALISATION)),
        ("it scores # there and", mean(DRAWN, "Layout", tasks=REGION)),
        ("# in the other tasks, where BC scores #", mean(DRAWN, "Layout", **rest), mean(PIXELS, "Layout", **rest)),
        ("the paper's GAIL # and `relational` #.", mean(GAIL, "Layout", **rest), mean(OURS, "Layout", **rest)),
        ("# in Layout with 25 demonstrations and # with 10.", mean("state-bc-25", "Layout"), mean(STATES, "Layout")),
        ("BC for all tasks scores #.", mean("state-bc-multi", "Layout")),
        ('"Goals and planning" scores # in the generalisation group', mean("state-goals", *GENERALISATION)),
        ("Doing nothing scores # in ClusterShape's Demo", mean("noop", "Demo", tasks=SHAPE)),
        ("# in MakeLine's CountPlus and All", mean("noop", "CountPlus", "All", tasks=["MakeLine"])),
        ("# in ClusterColour's All", mean("noop", "All", tasks=COLOUR)),
        ("both Cluster tasks, # and #,", mean(PIXELS, "All", tasks=COLOUR), mean(PIXELS, "All", tasks=SHAPE)),
        ("BC from pictures scores # in All", mean(PIXELS, "All")),
        ("and # without MoveToCorner, as in Layout.", mean(PIXELS, "All", without="MoveToCorner")),
        ("as in Layout.", mean(PIXELS, "Layout")),
        ("Layout, Diffusion Policy scores # and", mean("diffusion", "Layout", tasks=REGION)),
        ("and #, and BC", mean("diffusion-state", "Layout", tasks=REGION)),
        ("and BC # and #.", mean(PIXELS, "Layout", tasks=REGION), mean(STATES, "Layout", tasks=REGION)),
        (
            "BC from pictures loses %% of its Demo score in Colour and %% in",
            lost(PIXELS, "Colour"),
            lost(PIXELS, "Shape"),
        ),
        ("its BC loses %% and %%.", lost(CLONED, "Colour"), lost(CLONED, "Shape")),
        ("(# in FixColour, # in ClusterColour)", *needed.values()),
        ("solves %% of these scenes and %% of the others", *same_block(PIXELS)[1:]),
        ("BC from states %% and %%", *same_block(STATES)[1:]),
        ("`relational` %% and %%.", *same_block(OURS)[1:]),
        ("table has # there and # in MoveToRegion.", mean(AL, "Demo", tasks=CORNER), mean(AL, "Demo", tasks=REGION)),
        ("our three runs from pictures score #, # and # in MoveToRegion's Demo", *plain),
        ("where runs with them score #.", mean("pixels-gail-quick", "Demo", tasks=REGION)),
        ("for BC from pictures (#) and from states (#)", order(PIXELS, CLONED), order(STATES, CLONED)),
        ("and for GAIL from states (#).", order("state-gail", GAIL)),
        ("GAIL with one policy for all tasks (#)", order("state-gail-multi", "GAIL (MT)†")),
        ("and for AL (#).", order("state-al", AL)),
        ("for WGAIL-GP from states (#)", order("state-wgail-gp", "WGAIL-GP (ST)†")),
        ("training of GAIL from pictures (#)", order("pixels-gail-quick", GAIL)),
        *((f"# in {variant}", mean("replay", variant)) for variant in VARIANTS[:-1]),
        ("and # in All. No method", mean("replay", "All")),
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
    assert best(paper, *GENERALISATION) == mean("GAIL (ST)†", *GENERALISATION)
    ranks = {task: mean("state-relational", *GENERALISATION, tasks=[task]) for task in TASKS if task != "MoveToCorner"}
    assert max(ranks, key=lambda task: ranks[task]) == "MoveToRegion"
    gains = {task: mean(DRAWN, "Layout", tasks=[task]) - mean(PIXELS, "Layout", tasks=[task]) for task in ranks}
    assert gains["MoveToRegion"] > sum(gains.values()) / 2
    assert mean("pixels-point-quick", "Layout") <= mean(PIXELS, "Layout", tasks=["MoveToRegion", "FixColour"])
    floor, cloned = ({task: mean(name, "All", tasks=[task]) for task in TASKS} for name in ("noop", PIXELS))
    assert all(abs(floor[task] - cloned[task]) < 0.005 for task in ("ClusterColour", "ClusterShape"))
    for variant in ("Jitter", "Colour", "Dynamics"):
        assert mean("noop", variant, tasks=["ClusterShape"]) == mean("noop", "Demo", tasks=["ClusterShape"])
    learnt = [task for task in TASKS if mean("pixels-gail-quick", "Demo", tasks=[task]) > 0.2]
    assert sorted(learnt) == ["FixColour", "MoveToRegion"]
    learners = imitating("pictures") + imitating("states")
    assert best(learners, "Colour") < mean("replay", "Colour")
    needs_colours = [task for task in TASKS if mean("replay", "Colour", tasks=[task]) < 0.7]
    assert sorted(needs_colours) == ["ClusterColour", "FixColour"]


def test_the_demonstrations_page_has_the_scores_of_behavioural_cloning() -> None:
    page = " ".join((ROOT / "docs" / "demonstrations.md").read_text("utf-8").split())
    assert f"scores {mean(STATES, 'Demo'):.2f} in Demo and {mean(STATES, 'Jitter'):.2f} in Jitter with ours" in page


def test_the_demonstrations_page_has_the_statistics_of_the_demonstrations() -> None:
    page = (ROOT / "docs" / "demonstrations.md").read_text("utf-8")
    table = page.partition("| | ours | people |")[2].split("\n\n")[0].splitlines()[2:]
    shipped = [demos.load(task) for task in TASKS]
    for line, statistic in zip(table, STATISTICS.values(), strict=True):
        shown = line.split("|")[2].strip()
        decimals = len(shown.partition(".")[2])
        assert f"{np.mean([statistic(of_task) for of_task in shipped]):.{decimals}f}" == shown, line
