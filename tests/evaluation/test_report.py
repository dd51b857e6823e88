"""Reports: golden tables, what is missing is said, and what does not go together is refused.

To write the golden files anew: ``python tests/evaluation/test_report.py`` from the repository's root.
"""

from __future__ import annotations

import csv
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest
from matplotlib.text import Text
from PIL import Image

from magical_mj.evaluation.reports import figures, results, tables
from magical_mj.evaluation.reports.figures import bars, heat_map
from magical_mj.evaluation.reports.report import extremes, report
from magical_mj.evaluation.reports.results import published_results
from magical_mj.evaluation.scores import SCORES
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS
from magical_mj.utils.errors import EvaluationError
from tests.helpers.evaluations import example, write

GOLDEN: Final = Path(__file__).parents[1] / "data" / "evaluation"
TABLES: Final = (
    "report.md",
    "variants.csv",
    "environments.csv",
    "variants.tex",
    "interquartile.tex",
    "environments.tex",
)


@pytest.fixture(scope="module", autouse=True)
def _benchmark_of_the_paper() -> Iterator[None]:
    """Reports name what is missing of the benchmark; the golden ones are about the paper's tasks, which come first."""
    paper = tuple(published_results()["task"].unique())
    assert set(TASKS[: len(paper)]) == set(paper)
    with pytest.MonkeyPatch.context() as patch:
        for module in (results, tables, figures):
            patch.setattr(module, "ENVIRONMENTS", tuple(pair for pair in ENVIRONMENTS if pair[0] in paper))
        for module in (results, tables):
            patch.setattr(module, "TASKS", TASKS[: len(paper)])
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the example, with nothing but scores.jsonl to go by."""
    folder = tmp_path_factory.mktemp("report")
    return report([write(folder / "scores", example())], folder / "out").parent


@pytest.mark.parametrize("name", TABLES)
def test_tables_are_the_golden_ones(made: Path, name: str) -> None:
    assert (made / name).read_text() == (GOLDEN / name).read_text()


def test_the_order_of_rows_does_not_matter(tmp_path: Path, made: Path) -> None:
    page = report([write(tmp_path / "scores", example()[::-1])], tmp_path / "out")
    assert page.read_text() == (made / "report.md").read_text()


def test_folders_add_up(tmp_path: Path, made: Path) -> None:
    scores = example()
    folders = [
        write(tmp_path / name, [score for score in scores if (score.policy, score.run) == key])
        for name, key in {"a": ("BC_4 & more", 0), "b": ("BC_4 & more", 1), "c": ("noop", 0)}.items()
    ]
    assert report(folders, tmp_path / "out").read_text() == (made / "report.md").read_text()


def test_missing_environments_are_said_and_marked(made: Path) -> None:
    page = (made / "report.md").read_text()
    assert "BC_4 & more: incomplete in All: without MoveToRegion, MatchRegions, MakeLine, " in page
    assert "(1/8)" in page
    assert "missing" in page
    assert "not evaluated in Layout, Colour, Shape, CountPlus, Dynamics" in page
    assert "failed episodes, which count as 0: 1; the first reason: ValueError: 50% of {it} is_missing" in page
    with (made / "variants.csv").open() as file:
        rows = {(row["policy"], row["variant"]): row for row in csv.DictReader(file)}
    assert rows["BC_4 & more", "All"]["tasks"] == "1"
    assert rows["BC_4 & more", "All"]["missing"].startswith("MoveToRegion, ")


def test_unfinished_evaluations_say_so(tmp_path: Path) -> None:
    page = report([write(tmp_path, example()[:-2])], tmp_path / "out").read_text()
    assert "Unfinished: noop, run 0, MoveToRegion All has 2 of 4 episodes" in page


@pytest.fixture(scope="module")
def published(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the example beside the paper's results."""
    folder = tmp_path_factory.mktemp("published")
    return report([write(folder / "scores", example())], folder / "out", with_published=True).parent


def test_published_results_are_marked(published: Path) -> None:
    page = (published / "report.md").read_text()
    assert "| BC (ST)† | 0.64 ± 0.29 | 0.56 ± 0.27 |" in page
    assert "scored by the rules 'released', and all others by the rules 'paper'" in page
    tables = (published / "environments.tex").read_text()
    assert tables.count(r"\begin{table}") == tables.count(r"\end{table}") > 1
    with (published / "environments.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["published"] == "True"]
    assert len(rows) == 660
    assert {row["rules"] for row in rows} == {"released"}


def test_figures_are_drawn(made: Path) -> None:
    for name in ("bars", "heat_map"):
        with Image.open(made / f"{name}.png") as picture:
            assert picture.width > 800
            assert len(picture.convert("RGB").resize((400, 200)).getcolors(80_000)) > 20
        assert (made / f"{name}.pdf").read_bytes().startswith(b"%PDF")


def test_figures_mark_what_is_published_and_what_is_incomplete(tmp_path: Path) -> None:
    """In the bars and in the heat map, as in the tables."""
    found = results.results([write(tmp_path, example())], with_published=True)
    for figure in (bars(found), heat_map(found)):
        drawn = [text.get_text() for text in figure.findobj(Text)]
        assert any(text.replace("\n", " ") == "GAIL (ST)†" for text in drawn)
        assert "BC_4 & more" in drawn
    drawn = [text.get_text() for text in bars(found).findobj(Text)]
    assert drawn.count("(1/8)") == 1
    assert any("hatched: mean over only some of the tasks" in text for text in drawn)


def test_figures_show_names_with_dollars_as_they_are(tmp_path: Path) -> None:
    """Between two of them, matplotlib expects a formula."""
    name = r"$\frac{$"
    rows = [replace(score, policy=name) for score in example() if score.policy == "noop"]
    folder = report([write(tmp_path / "scores", rows)], tmp_path / "out").parent
    assert name in (folder / "report.md").read_text()
    assert (folder / "bars.png").stat().st_size


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
@pytest.mark.parametrize("which", ["made", "published"])
def test_latex_compiles(which: str, request: pytest.FixtureRequest) -> None:
    out: Path = request.getfixturevalue(which)
    inputs = "".join(rf"\input{{{name}}}" for name in TABLES if name.endswith(".tex"))
    (out / "paper.tex").write_text(
        rf"\documentclass{{article}}\usepackage{{booktabs}}\begin{{document}}{inputs}\end{{document}}"
    )
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "paper.tex"]
    result = subprocess.run(command, cwd=out, capture_output=True, text=True, errors="replace", check=False)
    assert result.returncode == 0, result.stdout
    assert "Overfull" not in result.stdout


def test_other_peoples_files_are_not_replaced(tmp_path: Path) -> None:
    scores = write(tmp_path / "scores", example())
    for name in ("report.md", "bars.png", "variants.tex"):
        out = tmp_path / name.partition(".")[0]
        out.mkdir()
        (out / name).write_text("mine")
        with pytest.raises(EvaluationError, match=rf"{name} is not of an earlier report: move it"):
            report([scores], out)
        assert [path.read_text() for path in out.iterdir()] == ["mine"]
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.md").write_text("# Evaluation of my own\n")
    with pytest.raises(EvaluationError, match=r"report.md is not of an earlier report"):
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


# what does not go together


def test_empty_and_missing_folders_are_explained(tmp_path: Path) -> None:
    with pytest.raises(EvaluationError, match=r"holds no scores\.jsonl; magical-mj evaluate"):
        report([tmp_path], tmp_path / "out")
    (tmp_path / SCORES).write_text("")
    with pytest.raises(EvaluationError, match="no finished episode"):
        report([tmp_path], tmp_path / "out")
    with pytest.raises(EvaluationError, match="give at least one folder"):
        report([], tmp_path / "out")
    write(tmp_path, [replace(example()[0], variant="Foo")])
    with pytest.raises(EvaluationError, match="holds results in the variant 'Foo'; there are: Demo, "):
        report([tmp_path], tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_papers_methods_keep_their_names(tmp_path: Path) -> None:
    folder = write(tmp_path / "scores", [replace(score, policy="BC (ST)") for score in example()[:4]])
    with pytest.raises(EvaluationError, match=r"the paper has methods named 'BC \(ST\)' as well: evaluate yours under"):
        report([folder], tmp_path / "out", with_published=True)
    assert "| BC (ST) |" in report([folder], tmp_path / "out").read_text()


def test_mixed_rules_are_refused(tmp_path: Path) -> None:
    paper, released = (
        write(tmp_path / rules, [replace(score, run=run + score.run, rules=rules) for score in example()])
        for run, rules in ((0, "paper"), (2, "released"))
    )
    with pytest.raises(EvaluationError, match=r"different rules: paper in .*, released in "):
        report([paper, released], tmp_path / "out")


def test_mixed_presets_are_refused_unless_wanted(tmp_path: Path) -> None:
    other = [replace(score, policy="allo", preset="LoRes4A") for score in example() if score.policy != "noop"]
    folders = [write(tmp_path / "a", example()), write(tmp_path / "b", other)]
    with pytest.raises(EvaluationError, match=r"different preset: LoRes4E in .*, LoRes4A in .* --mixed-presets"):
        report(folders, tmp_path / "out")
    assert "`LoRes4E`, `LoRes4A`" in report(folders, tmp_path / "out", mixed_presets=True).read_text()


def test_an_episode_counts_once(tmp_path: Path) -> None:
    folders = [write(tmp_path / name, example()) for name in "ab"]
    with pytest.raises(EvaluationError, match="both hold run 0 of BC_4 & more"):
        report(folders, tmp_path / "out")


def test_different_versions_are_noted(tmp_path: Path) -> None:
    scores = example()
    scores[0] = replace(scores[0], mujoco="3.18.0")
    assert (
        "different versions of MuJoCo: 3.17.0, 3.18.0" in report([write(tmp_path, scores)], tmp_path / "o").read_text()
    )


def test_links_are_links_whatever_the_name_of_the_file(tmp_path: Path) -> None:
    page = report([write(tmp_path / "scores", example())], tmp_path / "out", links={"a video": "best-BC (ST).mp4"})
    assert "- [a video](best-BC%20%28ST%29.mp4)" in page.read_text()


def test_names_in_any_script(tmp_path: Path) -> None:
    """Letters that the figures' font lacks are no reason for warnings, which tests turn into errors."""
    scores = [replace(score, policy="我的方法") for score in example() if score.policy == "noop"]
    assert "我的方法" in report([write(tmp_path, scores)], tmp_path / "out").read_text()


def test_extremes_are_the_best_and_the_worst_of_each_task() -> None:
    chosen = [(which, score.policy, score.task, score.score) for which, score in extremes(example())]
    assert ("best", "noop", "MoveToCorner", 0.25) in chosen
    assert ("worst", "noop", "MoveToCorner", 0.0) in chosen
    assert len(chosen) == len(set(chosen)) == 8


if __name__ == "__main__":
    for table in TABLES:
        made_here = report([write(Path("out/golden/scores"), example())], "out/golden").parent
        shutil.copy(made_here / table, GOLDEN / table)
