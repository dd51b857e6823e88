"""What pages show runs, and their numbers are those of the registry. `make readme` runs the README itself."""

from __future__ import annotations

import pkgutil
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from typer import Context
from typer.core import TyperGroup
from typer.main import get_command

import magical_mj
from magical_mj.cli.app import app, run
from magical_mj.evaluation.scores import read
from magical_mj.protocol import SEEDS

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "README.md").read_text("utf-8")
PAGES = "".join(
    (ROOT / "docs" / f"{name}.md").read_text("utf-8")
    for name in ("first-episode", "environments", "demonstrations", "learners", "rewards", "shifts")
)
PYTHON = re.findall(r"```python\n(.*?)```", PAGES, re.DOTALL)


@pytest.mark.parametrize("code", PYTHON, ids=range(len(PYTHON)))
def test_python_block_runs(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "__main__" in code:
        Path("script.py").write_text(code)
        subprocess.run([sys.executable, "script.py"], check=True)
    else:
        exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_the_tutorial_trains_and_evaluates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its commands run in their order, and BC has the scores that it shows, up to rounding on other processors."""
    page = (ROOT / "docs" / "train-and-evaluate.md").read_text("utf-8")
    monkeypatch.chdir(tmp_path)
    commands = re.findall(r"^\$ magical-mj (.*)$", page, re.MULTILINE)
    assert [command.split()[0] for command in commands] == ["train", "evaluate", "report"]
    for command in commands:
        assert run(shlex.split(command)) == 0
    means = pd.DataFrame(read(Path("scores/bc"))).groupby(["policy", "variant"])["score"].mean()
    for policy, *shown in re.findall(r"^ +(BC|random) +(0\.\d+) +(0\.\d+)$", page, re.MULTILINE):
        assert means[policy].tolist() == pytest.approx([float(score) for score in shown], abs=0.15)
    assert "| BC |" in Path("report/report.md").read_text("utf-8")


def test_commands_in_the_text_lack_nothing() -> None:
    """Of what is named with arguments, on all pages; it is not run, since much of it takes folders of the reader's."""
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *ROOT.glob("docs/*.md"), *ROOT.glob("site/pages/*.md")]
    texts = [re.sub(r"^```.*?^```", "", page.read_text("utf-8"), flags=re.MULTILINE | re.DOTALL) for page in pages]
    found = [shlex.split(command) for text in texts for command in re.findall(r"`magical-mj\s([^`]+)`", text)]
    assert len(found) > 20
    root = get_command(app)
    for words in found:
        command, name, rest = root, "magical-mj", words
        while isinstance(command, TyperGroup) and rest:
            name, command, rest = command.resolve_command(Context(command), rest)
        assert command is not None
        if rest:
            command.make_context(name or "", rest)  # an error says what is missing


def test_the_expert_is_as_good_as_said() -> None:
    page = (ROOT / "docs" / "experts.md").read_text("utf-8")
    full = re.search(r"^(\d+) of (\d+) episodes have the full score", page, re.MULTILINE)
    each = re.search(r"^(\d+) episodes in each environment", page, re.MULTILINE)
    assert full
    assert each
    assert int(full[2]) == int(each[1]) * len(magical_mj.ENVIRONMENTS)
    said = f"{int(full[1]):,} of {int(full[2]):,} episodes end with the full score, {each[1]} in each environment"
    assert said in " ".join(TEXT.split())


def test_the_numbers_of_tasks_and_environments_are_those_of_the_registry() -> None:
    said = f": {len(magical_mj.TASKS)} tasks, {len(magical_mj.ENVIRONMENTS)} environments, for "
    assert said in " ".join(TEXT.split())


def test_the_length_of_an_evaluation_is_that_of_the_protocol() -> None:
    episodes = len(magical_mj.ENVIRONMENTS) * SEEDS
    steps = SEEDS * sum(magical_mj.Engine(*pair).horizon or 0 for pair in magical_mj.ENVIRONMENTS)
    page = " ".join((ROOT / "docs" / "faq.md").read_text("utf-8").split())
    assert f"A run has {episodes:,} episodes ({SEEDS} in each of {len(magical_mj.ENVIRONMENTS)} environments)" in page
    assert f"or {steps:,} steps" in page


def test_links_and_make_targets_exist() -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", TEXT):
        assert (ROOT / target).exists(), target
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in re.findall(r"(?<![\w-])make (\w+)", TEXT):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), target


def test_names_in_the_text_exist() -> None:
    pages = [
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("site/pages/*.md"),
        *ROOT.glob("magical_mj/**/*.py"),
    ]
    entry_points = {"magical_mj.methods", "magical_mj.policy_folders", "magical_mj.task_languages", "magical_mj.tasks"}
    found = {
        name for page in pages for name in re.findall(r"`(magical_mj(?:\.\w+)+)", page.read_text("utf-8"))
    } - entry_points
    assert len(found) > 30
    for name in found:
        assert pkgutil.resolve_name(name) is not None
