"""Tables and numbers of pages are those of the results."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from magical_mj import ENVIRONMENTS
from tools import question_floors, tables
from tools.attribution import refuted
from tools.pages import filled
from tools.scores import own_methods

ROOT = Path(__file__).parents[2]


@pytest.mark.xdist_group("results")
def test_tables_are_up_to_date() -> None:
    assert len(tables.PAGES) == 12
    for page, of_page in tables.PAGES.items():
        text = (ROOT / page).read_text("utf-8")
        assert filled(text, of_page()) == text, f"run `make docs`: {page}"


@pytest.mark.xdist_group("results")
def test_the_scores_in_the_introduction_are_those_of_the_entry() -> None:
    means = own_methods()["pixels-bc-quick"].means
    tasks = [task for task, variant in means if variant == "Layout"]
    assert len(tasks) == 7
    demo, layout = (np.mean([means[task, variant].mean() for task in tasks]) for variant in ("Demo", "Layout"))
    said = f"scores {demo:.2f} in the scene of the demonstrations, and {layout:.2f} if all poses are new."
    assert said in " ".join((ROOT / "README.md").read_text("utf-8").split())


def test_the_page_of_questions_has_the_measured_floors() -> None:
    page = question_floors.PAGE.read_text("utf-8")
    assert filled(page, {"floors": question_floors.floors()}, question_floors.COMMAND) == page
    logic = [row for row in question_floors.rows() if row["kind"] == "logic"]
    assert len(logic) == 6
    for row in logic:
        assert float(row["exact inference"]) >= 0.97
        assert max(float(row["same place"]), float(row["nearest"])) <= 0.3


def test_the_benchmark_card_says_what_test_scenes_can_tell() -> None:
    _, block, _ = (
        (ROOT / "docs" / "benchmark-card.md").read_text("utf-8").split("identifiability")
    )  # between its markers
    lines = [line.strip("| ").split("|") for line in block.splitlines() if line.startswith("| ")]
    cells = [tuple(map(str.strip, line)) for line in lines]
    chosen, others = ("MatchRegions", "FindDupe", "FixColour"), ("ClusterColour", "ClusterShape")
    rows = {
        f"{task} {variant}": values for task, names, *values in cells if task in chosen for variant in names.split(", ")
    }
    places = {task: values for task, *values in cells if task in others}
    assert set(rows) == {f"{task} {variant}" for task, variant in ENVIRONMENTS if task in chosen and variant != "Demo"}
    for task in ("MatchRegions", "FindDupe"):
        assert {
            float(rows[f"{task} {variant}"][0]) for variant in ("Jitter", "Layout", "Colour", "Shape", "Dynamics")
        } == {0}
    assert [
        rows[f"{task} {variant}"][0] for task in ("MatchRegions", "FindDupe") for variant in ("CountPlus", "All")
    ] == [
        "0.58",
        "0.58",
        "0.85",
        "0.85",
    ]
    assert (rows["FixColour Colour"][0], rows["FixColour All"][0]) == ("0.66", "0.84")
    for task, variant in (("FixColour", "Colour"), ("FindDupe", "All")):
        values = refuted(task, variant, range(100))
        assert ["" if value is None else f"{value:.2f}" for value in values] == rows[f"{task} {variant}"]
    for task in others:  # Colour is the third test variant
        assert f"{refuted(task, 'Colour', range(100))[-1]:.2f}" == places[task][2]
