"""The tables of baselines in docs/intents.md, and the sentences about them, are those of the files."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from magical_mj.evaluation.reports.intervals import Cell, Estimate, estimate
from magical_mj.intents import parse
from magical_mj.intents.names import tasks_in
from tools import intent_baselines, intent_checks, intent_scenes
from tools.intent_baselines import (
    BASELINES,
    GOALS,
    INTENTS,
    PAGE,
    Reading,
    baselines,
    by_set_and_run,
    differences,
    gather,
    kept,
    misreading,
    over_intents,
    readings,
    stored,
)
from tools.intent_scenes import KINDS, SCENES, Outcome
from tools.intents import TESTS, VARIANTS
from tools.pages import ROOT, filled

TEXT = PAGE.read_text("utf-8")
METHOD = (ROOT / "methods" / "intents" / "README.md").read_text("utf-8")
PROSE = " ".join(f"{TEXT} {METHOD}".replace("**", "").split())
MEANS, READINGS, OUTCOMES, CHECKED = stored(), readings(), intent_scenes.stored(), intent_checks.stored()
ONE, RANDOM, CONTRASTING = "goals-1", "goals-4", "goals-4-contrasting"
SENTENCE, SHOWN, SHOWN_RANDOM = "sentence-policy", "demonstrations-policy-1", "demonstrations-policy-4"
SHOWN_CONTRASTING = f"{SHOWN_RANDOM}-contrasting"


def score(name: str, *groups: str) -> float:
    chosen = [m for m in MEANS if m.baseline == name and m.set in (groups or TESTS)]
    return float(over_intents(chosen).mean())


def gain(name: str, other: str) -> Estimate:
    """The mean difference of one row from another over the intents that both played, and its interval."""
    number = min(BASELINES[one].intents for one in (name, other))
    rows = [by_set_and_run(m for m in MEANS if m.baseline == one and m.number < number) for one in (name, other)]
    return less(*([np.stack(runs) for runs in one] for one in rows))


def less(first: list[np.ndarray], second: list[np.ndarray]) -> Estimate:
    """The mean difference over intents, given for each set: shape (runs, intents)."""
    every = (np.concatenate(side, axis=1) for side in (first, second))
    return estimate([Cell(scores, sign, sign, "") for sign, scores in zip((1, -1), every, strict=True)])


def right(name: str) -> int:
    return Counter(misreading(reading) for reading in READINGS if reading.baseline == name)["the intent"]


def in_scenes(number: int, kind: str = "random") -> list[Outcome]:
    return [row for row in OUTCOMES if (row.scenes, row.kind) == (number, kind)]


def scenes_gain(number: int, kind: str, other: int, other_kind: str) -> Estimate:
    """The mean difference in score between numbers and kinds of demo scenes, over the same intents."""
    rows = [in_scenes(number, kind), in_scenes(other, other_kind)]
    first, second = ([np.array([[row.score for row in side if row.set == group]]) for group in TESTS] for side in rows)
    return less(first, second)


def statements() -> list[str]:
    learnt, played = gain(SENTENCE, "random"), gain(CONTRASTING, RANDOM)
    planned = scenes_gain(8, "contrasting", 8, "random")
    inferred = [in_scenes(1), in_scenes(8), in_scenes(8, "contrasting")]
    one, eight, chosen = (f"{np.mean([row.score for row in rows]):.2f}" for rows in inferred)
    first = [f"{score(name):.2f}" for name in ("random", "cloned-1", SENTENCE, ONE, CONTRASTING)]
    half, few = (sum(row.score == row.intended == 1.0 for row in in_scenes(8, kind)) for kind in reversed(KINDS))
    assert 2 * half == len(in_scenes(8))
    return [
        "are {} for random actions, {} for BC from demonstrations in one scene, and {} for a policy".format(*first),
        "in a simulator has {} from one scene and {} from four [contrasting](#scenes) ones.".format(*first[3:]),
        f"plans score {one} from one scene, {eight} from eight random ones and {chosen} from eight contrasting ones.",
        f"Eight contrasting scenes settle half of the intents, eight random ones {few} of {len(in_scenes(8))}.",
        f"With eight scenes, contrasting ones gain {planned[0]:.2f} ({planned[1]:.2f} to {planned[2]:.2f}) over random",
        f"and four demonstrations, they gain {played[0]:.2f} ({played[1]:.2f} to {played[2]:.2f}).",
        f"Of 30 intents, intent inference finds {right(ONE)} from one scene, {right(RANDOM)} from four random ones",
        f"and {right(CONTRASTING)} from four contrasting ones;",
        f"The policy with the sentence scores {score(SENTENCE):.2f},",
        f"Random actions score {score('random'):.2f},",
        f"so it gains {learnt[0]:.2f} ({learnt[1]:.2f} to {learnt[2]:.2f}).",
        *checks(),
    ]


def checks() -> list[str]:
    def figures(*where: str) -> str:
        return "{:.2f} ({:.2f} to {:.2f})".format(*intent_checks.means(CHECKED, *where))

    def own(name: str) -> str:
        return "{:.2f} ({:.2f} to {:.2f})".format(*intent_checks.right(MEANS, name))

    return [
        (
            f"With its own sentence, the policy scores {own(SENTENCE)}, "
            f"and with another one {figures(SENTENCE, 'wrong', 'score')}."
        ),
        (
            f"With demonstrations in four random scenes, it scores {own(SHOWN_RANDOM)}, "
            f"and {figures(SHOWN_RANDOM, 'wrong', 'score')} with those of another intent."
        ),
        (
            f"In Diagnose, {figures(SENTENCE, 'Diagnose', 'other')} of the episodes with the sentence end as "
            f"the rival, and {figures(SHOWN, 'Diagnose', 'other')} of those with one demo scene."
        ),
    ]


@pytest.mark.parametrize("statement", statements())
def test_the_sentences_have_the_figures_of_the_files(statement: str) -> None:
    assert statement in PROSE


def test_several_scenes_do_not_raise_the_scores_of_the_trained_policy() -> None:
    assert score(SHOWN) > max(score(SHOWN_RANDOM), score(SHOWN_CONTRASTING))


@pytest.mark.parametrize("name", [RANDOM, CONTRASTING])
def test_relations_are_left_out(name: str) -> None:
    wrong = Counter(misreading(reading) for reading in READINGS if reading.baseline == name)
    del wrong["the intent"]
    assert wrong.most_common(1)[0][0] == "fewer relations"


def test_the_page_has_the_table_of_the_file() -> None:
    assert filled(TEXT, {"baselines": baselines(MEANS)}, "python -m tools.intent_baselines") == TEXT


def test_checks_have_the_scenes_of_their_intents() -> None:
    for name in intent_checks.NAMES:
        intents = BASELINES[name].intents * len(TESTS)
        for check, how in intent_checks.CHECKS.items():
            own = [row for row in CHECKED if (row.baseline, row.check) == (name, check)]
            assert len({row[:6] for row in own}) == len(own) == intents * len(how["variants"]) * how["episodes"]
    assert all(
        row.score in (0.0, 1.0) and row.score + (row.other or 0.0) <= 1.0 for row in CHECKED if row.check == "Diagnose"
    )


def test_the_file_has_the_means_of_the_stored_episodes() -> None:
    assert [mean._replace(score=float(f"{mean.score:.4g}")) for mean in gather(kept())] == MEANS


def test_stored_episodes_lead_to_their_scores() -> None:
    policies = [one for one in kept() if one.policy == SENTENCE]
    best = max(policies, key=lambda one: (one.score, -one.steps))
    assert best.score == 1.0
    assert differences([best], jobs=1) == []
    (difference,) = differences([replace(best, score=0.5)], jobs=1)
    assert best.title in difference


def test_the_files_have_whole_rows() -> None:
    for name in {mean.baseline for mean in MEANS}:
        own = [mean for mean in MEANS if mean.baseline == name]
        episodes = BASELINES[name].intents * len(TESTS) * len(VARIANTS)
        assert len({mean[:-1] for mean in own}) == len(own) == episodes * len({mean.run for mean in own})
        assert all(0.0 <= mean.score <= 1.0 for mean in own)
    inferring = [name for name, baseline in BASELINES.items() if baseline.policy == GOALS]
    assert Counter(reading.baseline for reading in READINGS) == dict.fromkeys(inferring, INTENTS * len(TESTS))
    assert all(reading.intent == str(tasks_in(reading.set)[reading.number].intent) for reading in READINGS)
    assert all(str(parse(reading.inferred)) == reading.inferred for reading in READINGS)
    kinds = [(1, "random"), *((number, kind) for kind in KINDS for number in SCENES[1:])]
    assert Counter((row.scenes, row.kind) for row in OUTCOMES) == dict.fromkeys(kinds, len(OUTCOMES) // len(kinds))
    assert Counter(row.set for row in OUTCOMES) == dict.fromkeys(TESTS, len(OUTCOMES) // len(TESTS))
    assert all(row.intended + row.misled <= 1.0 for row in OUTCOMES)


def test_a_missing_file_of_readings_is_created(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(intent_baselines, "INFERRED", tmp_path / "inferred.csv")
    assert readings() == []
    added = [Reading("goals-1", "seen", number, "robot in()", "in(all, region)") for number in range(2)]
    for reading in added:
        intent_baselines.add(reading)
    assert readings() == added


@pytest.mark.slow
def test_an_intent_is_settled_by_contrasting_scenes() -> None:
    rows = intent_scenes.outcomes("seen", 0, tasks_in("seen")[0])
    stored_rows = [row for row in OUTCOMES if (row.set, row.number) == ("seen", 0)]
    assert [row[:5] for row in rows] == [row[:5] for row in stored_rows]
    assert [row[5:] for row in rows] == [pytest.approx(row[5:], abs=1e-3) for row in stored_rows]
