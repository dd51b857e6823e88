"""Reports: golden tables, notes about missing results, and errors for incompatible ones. Comparisons by hand.

To regenerate the golden files: ``python tests/evaluation/test_report.py`` from the repository's root.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest
from matplotlib.text import Text
from PIL import Image

import magical_mj
from magical_mj.engine import Engine
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.reports import report as page
from magical_mj.evaluation.reports import results, tables
from magical_mj.evaluation.reports.floors import new_place_floors, refuting_seeds
from magical_mj.evaluation.reports.report import bars, extremes, heat_map, report
from magical_mj.evaluation.reports.results import choose, compare, published_results
from magical_mj.evaluation.reports.section import Inputs
from magical_mj.evaluation.reports.tables import NONE
from magical_mj.evaluation.scores import SCORES, EpisodeResult
from magical_mj.evaluation.settings import EvaluationSettings
from magical_mj.policies.interface import letters_of
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, Pair
from magical_mj.utils.errors import EvaluationError, SettingsError
from tests.helpers.commands import Shell
from tests.helpers.evaluations import TEMPLATE, example, write

GOLDEN: Final = Path(__file__).parents[1] / "data" / "evaluation"
TABLES: Final = (
    "report.md",
    "variants.csv",
    "environments.csv",
)


@pytest.fixture(scope="module", autouse=True)
def _benchmark_of_the_paper() -> Iterator[None]:
    """Reports name missing environments. The golden reports cover the paper's tasks, which come first."""
    paper = tuple(published_results()["task"].unique())
    assert set(TASKS[: len(paper)]) == set(paper)
    with pytest.MonkeyPatch.context() as patch:
        for module in (results, tables, page):
            patch.setattr(module, "ENVIRONMENTS", tuple(pair for pair in ENVIRONMENTS if pair[0] in paper))
        for module in (results, tables):
            patch.setattr(module, "TASKS", TASKS[: len(paper)])
        yield


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the example from scores.jsonl alone."""
    folder = tmp_path_factory.mktemp("report")
    return report([write(folder / "scores", example())], folder / "out").parent


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_the_golden_ones(out: Path, name: str) -> None:
    assert (out / name).read_text() == (GOLDEN / name).read_text()


def test_the_order_of_rows_does_not_matter(tmp_path: Path, out: Path) -> None:
    page = report([write(tmp_path / "scores", example()[::-1])], tmp_path / "out")
    assert page.read_text() == (out / "report.md").read_text()


def test_folders_add_up(tmp_path: Path, out: Path) -> None:
    scores = example()
    folders = [
        write(tmp_path / name, [score for score in scores if (score.policy, score.run) == key])
        for name, key in {"a": ("BC_4 & more", 0), "b": ("BC_4 & more", 1), "c": ("noop", 0)}.items()
    ]
    assert report(folders, tmp_path / "out").read_text() == (out / "report.md").read_text()


def test_folders_that_share_episodes_count_them_once(tmp_path: Path, out: Path) -> None:
    folders = [write(tmp_path / name, rows) for name, rows in (("a", example()[:30]), ("b", example()[20:]))]
    assert report(folders, tmp_path / "out").read_text() == (out / "report.md").read_text()


def test_missing_environments_are_said_and_marked(out: Path) -> None:
    page = (out / "report.md").read_text()
    assert "BC_4 & more: incomplete in All: without MoveToRegion, MatchRegions, MakeLine, " in page
    assert "(1/8)" in page
    assert "missing" in page
    assert "not evaluated in Layout, Colour, Shape, CountPlus, Dynamics" in page
    assert "failed episodes, which count as 0: 1; the first reason: ValueError: 50% of {it} is_missing" in page
    with (out / "variants.csv").open() as file:
        rows = {(row["policy"], row["variant"]): row for row in csv.DictReader(file)}
    assert rows["BC_4 & more", "All"]["tasks"] == "1"
    assert rows["BC_4 & more", "All"]["missing"].startswith("MoveToRegion, ")


def test_the_page_says_what_readers_must_know(tmp_path: Path) -> None:
    """An unfinished evaluation, different versions, and links to files with unusual names."""
    scores = example()[:-2]
    scores[0] = replace(scores[0], mujoco="3.18.0")
    folder = write(tmp_path / "scores", scores)
    page = report([folder], tmp_path / "out", links={"a video": "best-BC (ST).mp4"}).read_text()
    assert "Unfinished: noop, run 0, MoveToRegion All has 2 of 4 episodes" in page
    assert "different versions of MuJoCo: 3.17.0, 3.18.0" in page
    assert "- [a video](best-BC%20%28ST%29.mp4)" in page


def noop_report(folder: Path, **settings: Any) -> str:
    """The page of an evaluation of noop."""
    asked = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 2, "jobs": 1, **settings}
    magical_mj.evaluate("noop", out=folder, **asked)
    return report([folder], folder / "report").read_text()


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        (
            {"split": "dev", "first_seed": 7, "time_limit": 60, "like": "FindDupe"},
            (
                "the split dev; first seed 7 of the split; 2 episodes in each environment instead of 100; "
                "policies receive the task name FindDupe; a time limit of 60.0 s"
            ),
        ),
        (
            {"wrap": "gymnasium.wrappers:RecordEpisodeStatistics"},
            "2 episodes in each environment instead of 100; the wrapper gymnasium.wrappers:RecordEpisodeStatistics",
        ),
    ],
)
def test_reports_say_how_they_differ_from_the_protocol(tmp_path: Path, settings: dict[str, Any], said: str) -> None:
    """Once on the page, and with every figure. Complete evaluations have no note about missing episodes."""
    page = noop_report(tmp_path, **settings)
    assert page.count(f"Not by the official protocol: {said}") == 1
    assert "Unfinished" not in page
    with (tmp_path / "report" / "environments.csv").open() as file:
        assert {row["split"] for row in csv.DictReader(file)} == {settings.get("split", "test")}
    (mark,) = (text for text in heat_map(results.results([tmp_path])).findobj(Text) if "official" in text.get_text())
    assert said[:14] in mark.get_text().replace("\n", " ")


def test_reports_by_the_protocol_have_no_mark(tmp_path: Path) -> None:
    folder = write(tmp_path / "scores", [replace(TEMPLATE, seed=seed) for seed in range(100)])
    page = report([folder], tmp_path / "out").read_text()
    assert "official" not in page
    assert "split `test`, seeds 0 to 99; " in page


def test_planned_episodes_that_are_missing_are_noted(tmp_path: Path) -> None:
    """For each policy, run, environment and shift, according to the plan of the evaluation."""
    page = noop_report(tmp_path, episodes=4, shifts="camera:1-2,light:2", first_seed=3)
    assert "Unfinished" not in page
    assert "split `test`, seeds 3 to 6; shifts: camera:1-2, light:2; " in page
    path = tmp_path / SCORES
    rows = path.read_text().splitlines(keepends=True)
    shifted = [row for row in rows if "camera:1" in row]
    for left, note in (
        (rows, ""),
        (shifted[:1], "camera:1 has 1 of 4 episodes."),
        ([], "camera:1 has 0 of 4 episodes."),
    ):
        path.write_text("".join([row for row in rows if row not in shifted] + [row for row in left if row in shifted]))
        page = report([tmp_path], tmp_path / "report").read_text()
        assert ("Unfinished: noop, run 0, MoveToRegion Demo " + note in page) == bool(note)


def test_parts_of_a_run_in_several_folders_are_complete(tmp_path: Path) -> None:
    asked = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 2, "jobs": 1}
    for first in (0, 2):
        magical_mj.evaluate("noop", out=tmp_path / str(first), first_seed=first, **asked)
    page = report([tmp_path / "0", tmp_path / "2"], tmp_path / "out").read_text()
    assert "Unfinished" not in page
    assert "4 episodes in each environment instead of 100" in page


def test_only_variants_that_the_tasks_have_are_missed(tmp_path: Path) -> None:
    page = report([write(tmp_path / "scores", [replace(TEMPLATE, task="MoveToRegion")])], tmp_path / "out").read_text()
    assert "not evaluated in Jitter, Layout, Colour, Dynamics, All." in page


def test_one_training_is_not_two_runs(tmp_path: Path) -> None:
    rows = [replace(TEMPLATE, policy="BC", run=run) for run in (0, 1)]
    folder = write(tmp_path / "scores", rows)
    settings = EvaluationSettings(tasks="FindDupe", variants="Demo", episodes=1).recorded()
    same = [{"name": "BC", "run": run, "origin": "runs/a", "sha256": "c0ffee" * 8} for run in (0, 1)]
    (folder / SETTINGS).write_text(json.dumps({**settings, "policies": same}))
    with pytest.raises(EvaluationError, match=r"the runs 0, 1 of BC have equal policies \(sha256 c0ffee"):
        report([folder], tmp_path / "out")
    (folder / SETTINGS).write_text(json.dumps({**settings, "policies": [same[0], {**same[1], "sha256": "dec0de"}]}))
    report([folder], tmp_path / "out")


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the example with the paper's results."""
    folder = tmp_path_factory.mktemp("published")
    return report([write(folder / "scores", example())], folder / "out", with_published=True).parent


def test_published_results_are_marked(published: Path) -> None:
    page = (published / "report.md").read_text()
    assert "| BC (ST)† | 0.64 ± 0.29 | 0.56 ± 0.27 |" in page
    assert "scored by the rules 'released', and all others by the rules 'paper'" in page
    with (published / "environments.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["published"] == "True"]
    assert len(rows) == 660
    assert {row["rules"] for row in rows} == {"released"}


def test_figures_are_drawn(out: Path) -> None:
    for name in ("bars", "heat_map"):
        with Image.open(out / f"{name}.png") as picture:
            assert picture.width > 800
            assert len(picture.convert("RGB").resize((400, 200)).getcolors(80_000) or ()) > 20
        assert (out / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_figures_mark_what_is_published_and_what_is_incomplete(tmp_path: Path) -> None:
    """In the bars and in the heat map, as in the tables."""
    data = results.results([write(tmp_path, example())], with_published=True)
    for figure in (bars(data), heat_map(data)):
        drawn = [text.get_text() for text in figure.findobj(Text)]
        assert any(text.replace("\n", " ") == "GAIL (ST)†" for text in drawn)
        assert "BC_4 & more" in drawn
    drawn = [text.get_text() for text in bars(data).findobj(Text)]
    assert drawn.count("(1/8)") == 1
    assert any("hatched: mean over only some of the tasks" in text for text in drawn)


def test_names_are_shown_as_they_are(tmp_path: Path) -> None:
    """Matplotlib would read text between dollars as a formula. Letters that its font lacks cause no warnings."""
    name = r"$\frac{$ 我的方法"
    rows = [replace(score, policy=name) for score in example() if score.policy == "noop"]
    page = report([write(tmp_path / "scores", rows)], tmp_path / "out")
    assert name in page.read_text()
    assert (page.parent / "bars.png").stat().st_size


def test_other_peoples_files_are_not_replaced(tmp_path: Path) -> None:
    scores = write(tmp_path / "scores", example())
    for name in ("report.md", "bars.png", "variants.csv"):
        folder = tmp_path / name.partition(".")[0]
        folder.mkdir()
        (folder / name).write_text("mine")
        with pytest.raises(EvaluationError, match=rf"{name} does not belong to an earlier report: move it"):
            report([scores], folder)
        assert [path.read_text() for path in folder.iterdir()] == ["mine"]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.md").write_text("# Evaluation of my own\n")
    with pytest.raises(EvaluationError, match=r"report.md does not belong to an earlier report"):
        report([scores], tmp_path / "out")


def test_a_report_that_was_interrupted_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scores = write(tmp_path / "scores", example())
    with monkeypatch.context() as patch:
        patch.setattr("magical_mj.evaluation.reports.report.heat_map", lambda _: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            report([scores], tmp_path / "out")
    assert not (tmp_path / "out" / "heat_map.png").exists()
    report([scores], tmp_path / "out")
    assert (tmp_path / "out" / "heat_map.png").exists()


def test_empty_and_missing_folders_are_explained(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"holds no scores\.jsonl; magical-mj evaluate"):
        report([tmp_path], tmp_path / "out")
    with pytest.raises(EvaluationError, match=r"gone does not exist; magical-mj evaluate --out \S*gone makes one"):
        report([tmp_path / "gone"], tmp_path / "out")
    (tmp_path / SCORES).write_text("")
    with pytest.raises(EvaluationError, match="no finished episode"):
        report([tmp_path], tmp_path / "out")
    with pytest.raises(EvaluationError, match="give at least one folder"):
        report([], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_papers_methods_keep_their_names(tmp_path: Path) -> None:
    folder = write(tmp_path / "scores", [replace(score, policy="BC (ST)") for score in example()[:4]])
    with pytest.raises(EvaluationError, match=r"the paper has methods named 'BC \(ST\)' as well: evaluate yours under"):
        report([folder], tmp_path / "out", with_published=True)
    assert "| BC (ST) |" in report([folder], tmp_path / "out").read_text()


def test_folders_that_contradict_each_other_are_refused(tmp_path: Path) -> None:
    scores = write(tmp_path / "scores", example())
    again = write(tmp_path / "again", [*example()[:3], replace(example()[3], score=1.0, failure=None)])
    rules = write(tmp_path / "rules", [replace(score, run=2 + score.run, rules="released") for score in example()])
    other = [replace(score, policy="allo", preset="LoRes4A") for score in example() if score.policy != "noop"]
    presets = write(tmp_path / "presets", other)
    for folder, problem in {
        again: "both hold run 0 of BC_4 & more",
        rules: r"different rules: paper in .*, released in ",
        presets: r"different preset: LoRes4E in .*, LoRes4A in .* --mixed-presets",
    }.items():
        with pytest.raises(EvaluationError, match=problem):
            report([scores, folder], tmp_path / "out")
    assert "`LoRes4E`, `LoRes4A`" in report([scores, presets], tmp_path / "out", mixed_presets=True).read_text()


def test_stored_episodes_are_scored_by_the_other_rules(tmp_path: Path, shell: Shell) -> None:
    """The scores are those of an evaluation by the other rules, after fewer steps if these end earlier."""
    settings = {"tasks": "ClusterShape,MoveToCorner", "variants": "Demo,Layout", "episodes": 2, "jobs": 1}
    for rules in ("paper", "released"):
        magical_mj.evaluate("noop,random", out=tmp_path / rules, rules=rules, **settings)
    done = list[tuple[int, int]]()
    rescored, played = (
        results.gather([tmp_path / name], rules="released", jobs=1, watch=lambda *numbers: done.append(numbers))
        for name in ("paper", "released")
    )
    assert done == [(number, 12) for number in range(1, 13)]  # of the first folder only
    assert rescored.drop(columns="folder").equals(played.drop(columns="folder"))
    assert not rescored["score"].equals(results.gather([tmp_path / "paper"])["score"])
    folder = tmp_path / "paper"
    assert shell("report", folder, "--rules", "released", "--jobs", 1, "--out", tmp_path / "out")[0] == 0
    assert "--jobs has an effect only with --explain or --intents or --success or --rules" in shell.fails(
        2, "report", folder, "--jobs", 1
    )
    page = (tmp_path / "out" / "report.md").read_text()
    assert "scores by the rules `released`" in page
    path = tmp_path / "paper" / SCORES
    path.write_text(path.read_text().replace('"score": 0.25', '"score": 0.75'))
    with pytest.raises(EvaluationError, match="cannot be scored by the rules 'released': run 0, ClusterShape"):
        results.gather([tmp_path / "paper"], rules="released")


def test_success_at_any_time_is_found_by_a_replay(tmp_path: Path, shell: Shell) -> None:
    """Of a policy that stays in the region, one that reaches it and drives on, and in a scene that begins solved."""
    there = magical_mj.demos.load("MoveToRegion")[0].actions
    back, noop = 2, 0
    episodes, first = list[EpisodeResult](), dict[str, list[float]]()
    for name, task, seed, actions in (
        ("stays", "MoveToRegion", 0, there),
        ("drives on", "MoveToRegion", 0, [*there[:25], *[back] * 15]),
        ("noop", "MakeLine", 13, [noop] * 180),
    ):
        variant = "All" if task == "MakeLine" else "Demo"
        with closing(Engine(task, variant, seed=seed)) as engine:
            scores = [engine.score()]
            for action in actions:
                engine.step(int(action))
                scores.append(engine.score())
        first[name] = [scores[-1], scores.index(1.0)]
        where = {"policy": name, "task": task, "variant": variant, "seed": seed, "score": scores[-1]}
        episodes.append(replace(TEMPLATE, **where, steps=len(actions), actions=letters_of(actions)))
    assert first["stays"][0] == 1.0 > first["drives on"][0]
    assert first["noop"] == [1.0, 0]
    folder = write(tmp_path / "scores", episodes)
    assert shell("report", folder, "--success", "--jobs", 1, "--out", tmp_path / "out")[0] == 0
    with (tmp_path / "out" / "success" / "success.csv").open() as file:
        found = {row["policy"]: [float(row["score"]), float(row["steps_to_success"])] for row in csv.DictReader(file)}
    assert found == first
    page = (tmp_path / "out" / "success" / "success.md").read_text()
    assert f"| MoveToRegion Demo | 1 | 0.00 | 1.00 | {first['drives on'][1]} |" in page


def test_extremes_are_the_best_and_the_worst_of_each_task() -> None:
    chosen = [(which, score.policy, score.task, score.score) for which, score in extremes(example())]
    assert ("best", "noop", "MoveToCorner", 0.25) in chosen
    assert ("worst", "noop", "MoveToCorner", 0.0) in chosen
    assert len(chosen) == len(set(chosen)) == 8
    methods = [replace(TEMPLATE, given=f"{number} demonstrations") for number in (4, 8)]
    assert extremes(methods) == [("best", one) for one in methods]


def side(folder: Path, values: dict[Pair, list[float]], run: int = 0) -> list[EpisodeResult]:
    return [
        replace(TEMPLATE, policy=folder.name, run=run, task=task, variant=variant, seed=seed, score=value)
        for (task, variant), scores in values.items()
        for seed, value in enumerate(scores)
    ]


def test_comparison_is_paired_by_scene(tmp_path: Path) -> None:
    """By hand: FindDupe differs by 0.5, -0.5, 0.5 and MakeLine by 0, 0.3. A scene of only one policy is left out."""
    a, b = tmp_path / "a", tmp_path / "b"
    write(a, side(a, {("FindDupe", "Demo"): [1.0, 0.0, 0.5, 1.0], ("MakeLine", "Demo"): [0.5, 0.5]}))
    write(b, side(b, {("FindDupe", "Demo"): [0.5, 0.5, 0.0], ("MakeLine", "Demo"): [0.5, 0.2]}))
    demo, every = compare(a, b).to_dict("records")
    assert {**demo, "variant": every["variant"]} == every
    assert demo["variant"] == "Demo"
    assert demo["first"] == pytest.approx((0.5 + 0.5) / 2)
    assert demo["second"] == pytest.approx((1 / 3 + 0.35) / 2)
    assert demo["difference"] == pytest.approx((0.5 / 3 + 0.15) / 2)
    assert demo["low"] < demo["difference"] < demo["high"]
    assert [demo[name] for name in ("better", "worse", "scenes", "environments", "unpaired")] == [3, 1, 5, 2, 1]


def test_comparison_averages_runs_first(tmp_path: Path) -> None:
    a, b = tmp_path / "a", tmp_path / "b"
    runs = [side(a, {("FindDupe", "Demo"): values}, run) for run, values in enumerate(([1.0, 0.0], [0.0, 1.0]))]
    write(a, [*runs[0], *runs[1]])
    write(b, side(b, {("FindDupe", "Demo"): [0.5, 0.25]}))
    row = compare(a, b).iloc[0]
    assert (row["first"], row["second"], row["better"], row["worse"]) == (0.5, 0.375, 1, 0)


def test_means_of_the_same_scores_are_equal(tmp_path: Path) -> None:
    """The order of the runs must not change even their last digit."""
    for name, order in (("a", (1 / 3, 1.0, 1.0)), ("b", (1.0, 1.0, 1 / 3))):
        folder = tmp_path / name
        runs = [side(folder, {("FindDupe", "Demo"): [score]}, run) for run, score in enumerate(order)]
        write(folder, [score for run in runs for score in run])
    assert np.mean([1 / 3, 1, 1]) != np.mean([1, 1, 1 / 3])
    assert tuple(compare(tmp_path / "a", tmp_path / "b").iloc[0][["better", "worse"]]) == (0, 0)


def test_equal_policies_do_not_differ(tmp_path: Path) -> None:
    folder = write(tmp_path, example())
    table = compare(f"{folder}:noop", f"{folder}:noop")
    assert table["difference"].tolist() == pytest.approx([0] * 4)
    assert ((table["low"] < 0) & (table["high"] > 0)).all()  # few scenes say little, even if all are equal


def test_names_of_policies_and_folders_may_hold_colons(tmp_path: Path) -> None:
    folder = write(tmp_path / "at:noon", [replace(score, policy=f"{score.policy}:v2") for score in example()])
    assert choose(f"{folder}:noop:v2")[0] == "noop:v2"
    with pytest.raises(SettingsError, match="name one of them"):
        choose(folder)
    with pytest.raises(EvaluationError, match="gone:noop does not exist"):
        choose("gone:noop")


def test_comparisons_need_names_and_common_scenes(tmp_path: Path) -> None:
    folder = write(tmp_path / "many", example())
    with pytest.raises(SettingsError, match="holds BC_4 & more, noop: name one of them, as in "):
        compare(folder, folder)
    with pytest.raises(SettingsError, match="name one of them"):
        compare(f"{folder}:nobody", folder)
    other = write(tmp_path / "other", [replace(TEMPLATE, seed=99)])
    with pytest.raises(EvaluationError, match="no scene in common"):
        compare(f"{folder}:noop", other)


@pytest.mark.parametrize("different", [{"rules": "released"}, {"worlds": "batched"}])
def test_scores_of_different_kinds_are_not_compared(different: dict[str, Any], tmp_path: Path) -> None:
    """With other rules, or in batched environments."""
    one = write(tmp_path / "one", example())
    other = write(tmp_path / "other", [replace(score, **different) for score in example()])
    with pytest.raises(EvaluationError, match=f"different {next(iter(different))}"):
        compare(f"{one}:noop", f"{other}:noop")


def test_other_bodies_are_reported_together(tmp_path: Path) -> None:
    """The body is a part of the scene, so the scenes of a seed differ."""
    longstick = replace(TEMPLATE, body="longstick", scene="b")
    folders = [write(tmp_path / one.body, [one]) for one in (replace(TEMPLATE, scene="a"), longstick)]
    text = report(folders, tmp_path / "page").read_text()
    assert f"{TEMPLATE.policy} with longstick" in text


def test_a_file_of_scores_instead_of_its_folder_is_explained(tmp_path: Path) -> None:
    folder = write(tmp_path / "one", example())
    with pytest.raises(EvaluationError, match="is a file of an evaluation: give its folder"):
        report([folder / SCORES], tmp_path / "page")


def test_floors_in_new_places_are_by_the_papers_rules(tmp_path: Path) -> None:
    seed = min(refuting_seeds()["FixColour", "Colour"])
    one = replace(TEMPLATE, task="FixColour", variant="Colour", seed=seed, score=0.0, scene=None)
    floor = f"{new_place_floors()['FixColour', 'Colour']:.2f}"
    for rules, shown in (("paper", floor), ("released", NONE)):
        page = report([write(tmp_path / rules, [replace(one, rules=rules)])], tmp_path / f"{rules}-page")
        assert f"| 0.00 | {NONE} | {shown} | 1/" in page.read_text()


def test_sections_count_an_episode_of_two_folders_once(tmp_path: Path) -> None:
    whole = write(tmp_path / "whole", example())
    part = write(tmp_path / "part", example()[:2])
    inputs = Inputs([whole, part], None, (), 1, lambda *_: None)
    assert [episode for _, episode in inputs.episodes()] == example()


def test_scores_in_different_worlds_are_not_compared(tmp_path: Path) -> None:
    """Another protocol draws other scenes from the same seeds. Older files do not record their scenes."""
    one, other, older = (
        write(tmp_path / str(scene), [replace(TEMPLATE, policy=str(scene), scene=scene)]) for scene in ("a", "b", None)
    )
    with pytest.raises(EvaluationError, match="different scenes in FindDupe Demo, seed 0: a in a, b in b"):
        compare(one, other)
    assert compare(one, older)["scenes"].tolist() == [1, 1]
    with pytest.raises(EvaluationError, match=r"different scenes in FindDupe Demo, seed 0: a in .*a, b in .*b;"):
        report([one, older, other], tmp_path / "out")


if __name__ == "__main__":
    for table in TABLES:
        made_here = report([write(Path("out/golden/scores"), example())], "out/golden").parent
        shutil.copy(made_here / table, GOLDEN / table)
