"""The tables of baselines in docs/intents.md, and the sentences about them, are those of the two files."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from magical_mj.evaluation.reports.statistics import mean_interval
from magical_mj.intents import parse
from magical_mj.intents.sets import tasks_in
from tools.intent_baselines import (
    BASELINES,
    GOALS,
    INTENTS,
    PAGE,
    TESTS,
    VARIANTS,
    baselines,
    misread,
    misreading,
    over_intents,
    readings,
    stored,
)
from tools.tables import filled

TEXT = PAGE.read_text("utf-8")
PROSE = " ".join(TEXT.replace("**", "").split())
MEANS, READINGS = stored(), readings()
ONE, RANDOM, CONTRASTING, CLONED = "goals-1", "goals-4", "goals-4-contrasting", "cloned-1"
MANY = "sentence-policy", "demonstrations-policy-1", "demonstrations-policy-4"


def score(name: str, *groups: str) -> float:
    chosen = [mean for mean in MEANS if mean.baseline == name and mean.set in (groups or TESTS)]
    return float(over_intents(chosen).mean())


def in_variant(name: str, variant: str) -> float:
    return float(over_intents(mean for mean in MEANS if (mean.baseline, mean.variant) == (name, variant)).mean())


def gain(name: str, other: str) -> tuple[float, float, float]:
    """The mean difference of one row from another over the same intents, and its interval."""
    rows = [
        [over_intents(m for m in MEANS if (m.baseline, m.set) == (one, group)) for group in TESTS]
        for one in (name, other)
    ]
    differences = [first - second for first, second in zip(*rows, strict=True)]
    return (float(np.mean(differences)), *mean_interval(differences))


def right(name: str) -> int:
    return Counter(misreading(reading) for reading in READINGS if reading.baseline == name)["the intent"]


def statements() -> list[str]:
    random, contrasting = gain(RANDOM, ONE), gain(CONTRASTING, RANDOM)
    return [
        f"From one scene, intent inference scores {score(ONE):.2f}, from four random ones {score(RANDOM):.2f}",
        f"and from four contrasting ones {score(CONTRASTING):.2f}.",
        f"Four random scenes gain {random[0]:.2f} ({random[1]:.2f} to {random[2]:.2f}) over one,",
        f"and contrasting ones {contrasting[0]:.2f} ({contrasting[1]:.2f} to {contrasting[2]:.2f}) over random ones.",
        f"Of 30 intents, {right(ONE)} are inferred from one scene, {right(RANDOM)} from four random ones",
        f"and {right(CONTRASTING)} from four contrasting ones.",
        f"In the set long, it scores {score(ONE, 'long'):.2f}, {score(RANDOM, 'long'):.2f}",
        f"and {score(CONTRASTING, 'long'):.2f}.",
        "BC anew for each intent scores {:.2f} in Demo, {:.2f} in Layout and {:.2f} in All".format(
            *(in_variant(CLONED, variant) for variant in VARIANTS)
        ),
        "The policy for many intents scores {:.2f} with the sentence, {:.2f} with demonstrations in one scene and "
        "{:.2f} in four.".format(*map(score, MANY)),
        f"Random actions score {score('random'):.2f}.",
        "whose intents it was trained on, it scores {:.2f}, {:.2f} and {:.2f}.".format(
            *(score(name, "seen") for name in MANY)
        ),
        f"The expert scores {score('expert'):.2f}.",
    ]


@pytest.mark.parametrize("statement", statements())
def test_the_sentences_have_the_figures_of_the_files(statement: str) -> None:
    assert statement in PROSE


@pytest.mark.parametrize("name", [RANDOM, CONTRASTING])
def test_relations_are_left_out(name: str) -> None:
    wrong = Counter(misreading(reading) for reading in READINGS if reading.baseline == name)
    del wrong["the intent"]
    assert wrong.most_common(1)[0][0] == "fewer relations"


def test_the_page_has_the_tables_of_the_files() -> None:
    tables = {"baselines": baselines(MEANS), "misread": misread(READINGS)}
    assert filled(TEXT, tables, "python -m tools.intent_baselines") == TEXT


def test_the_files_have_whole_rows() -> None:
    for name in {mean.baseline for mean in MEANS}:
        own = [mean for mean in MEANS if mean.baseline == name]
        assert len({mean[:-1] for mean in own}) == len(own) == BASELINES[name].intents * len(TESTS) * len(VARIANTS)
        assert all(0.0 <= mean.score <= 1.0 for mean in own)
    inferring = [name for name, baseline in BASELINES.items() if baseline.policy == GOALS]
    assert Counter(reading.baseline for reading in READINGS) == dict.fromkeys(inferring, INTENTS * len(TESTS))
    assert all(reading.intent == str(tasks_in(reading.set)[reading.number].intent) for reading in READINGS)
    assert all(str(parse(reading.inferred)) == reading.inferred for reading in READINGS)
