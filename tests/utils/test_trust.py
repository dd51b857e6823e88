"""A file decides nothing about which code runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from magical_mj.evaluation.scores import SETTINGS
from magical_mj.utils import imports
from magical_mj.utils.errors import UntrustedNameError
from tests.helpers.commands import Shell
from tests.helpers.evaluations import TEMPLATE, write

TASK = "somebody.payload:SPEC"
PAYLOAD = """
from dataclasses import replace
from pathlib import Path
Path("ran").touch()
from magical_mj.tasks.move_to_region import SPEC as OURS
SPEC = replace(OURS, name="Theirs")
"""


@pytest.fixture(autouse=True)
def theirs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A working folder with a module that tells when it runs."""
    (tmp_path / "somebody").mkdir()
    (tmp_path / "somebody" / "payload.py").write_text(PAYLOAD)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    yield tmp_path / "ran"
    for name in [name for name in sys.modules if name.partition(".")[0] == "somebody"]:
        del sys.modules[name]


def evaluation(**fields: str) -> Path:
    """A folder with an episode of their task, or with other fields, in which nothing is done."""
    row = replace(TEMPLATE, steps=40, actions="a" * 40, **(fields or {"task": TASK}))
    folder = write(Path("run"), [row])
    settings = {"policies": [{"name": row.policy, "run": 0}], "environments": [f"{row.task}-Demo"], "episodes": 1}
    (folder / SETTINGS).write_text(json.dumps(settings | {"shifts": [row.shift], "wrap": row.wrap, "body": row.body}))
    return folder


@pytest.mark.parametrize(
    "command",
    [
        *("report run", "report run --videos", "verify run", "leaderboard run", "compare run run", "submit run"),
        "experiment study.toml --out out",
        "train bc --tasks MoveToRegion --out trained --resume",
        "evaluate --policy expert --tasks MoveToRegion --episodes 1 --out run --resume",
    ],
)
def test_no_command_runs_code_that_a_file_names(shell: Shell, command: str, theirs: Path) -> None:
    evaluation()
    Path("study.toml").write_text(f'methods = ["bc"]\ntasks = ["{TASK}"]\nseeds = [0]\n')
    Path("trained").mkdir()
    Path("trained/config.toml").write_text(f'method = "bc"\ntasks = ["{TASK}"]\n')
    code, _, error = shell(*command.split())
    assert not theirs.exists()
    if command.split(maxsplit=1)[0] in ("experiment", "train") or "--videos" in command:
        assert code == 2
        assert TASK in error
        assert "trust" in error


@pytest.mark.parametrize("field", ["shift", "wrap", "body", "policy", "preset", "rules"])
def test_no_other_field_of_an_episode_runs_code(shell: Shell, field: str, theirs: Path) -> None:
    evaluation(**{field: f"{TASK}:3" if field == "shift" else TASK})
    played = ("--policy", "noop", "--tasks", "MoveToRegion", "--episodes", "1", "--jobs", "1")
    for command in ("report run --videos", "verify run --jobs 1", "compare run run", "submit run --out e.json.xz"):
        shell(*command.split())
    shell("evaluate", *played, "--out", "run", "--resume")
    assert not theirs.exists()


def test_trusted_files_and_typed_names_run_it(shell: Shell, theirs: Path) -> None:
    evaluation()
    code, _, _ = shell("report", "run", "--videos", "--trust")
    assert (code, theirs.exists()) == (0, True)
    assert list(Path("run/report").glob("*.mp4"))


def test_installed_packages_are_not_searched_for_in_the_working_folder(theirs: Path) -> None:
    with pytest.raises(ImportError):
        imports.resolve_installed(TASK)
    assert not theirs.exists()
    assert imports.resolve(TASK).name == "Theirs"


def test_a_name_from_a_file_must_be_typed_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(imports, "_TRUST", imports._Trust())
    imports.check_named("FindDupe", "a file")
    with pytest.raises(UntrustedNameError, match=TASK):
        imports.check_named(TASK, "a file")
    imports.trust(TASK)
    imports.check_named(TASK, "a file")
    with imports.command_line(["--tasks=FindDupe,mine:SPEC"]):
        imports.check_named("mine:SPEC", "a file")
        with pytest.raises(UntrustedNameError):
            imports.resolve(TASK)
    imports.check_named(TASK, "a file")
