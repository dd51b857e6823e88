"""A file decides nothing about which code runs."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from magical_mj import demos
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.scores import episodes_in
from magical_mj.learners import plan_experiment
from magical_mj.protocol import PROTOCOL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import imports
from magical_mj.utils.errors import DemonstrationError, UntrustedNameError
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


def study() -> Path:
    """The file of an experiment on their task."""
    Path("study.toml").write_text(f'methods = ["bc"]\ntasks = ["{TASK}"]\nseeds = [0]\n')
    return Path("study.toml")


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
    study()
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
    assert shell("report", "run", "--videos", "--trusted", "others.tasks:SPEC")[0] == 2
    assert not theirs.exists()
    code, _, _ = shell("report", "run", "--videos", "--trusted", f"others.tasks:SPEC,{TASK}")
    assert (code, theirs.exists()) == (0, True)
    assert list(Path("run/report").glob("*.mp4"))
    assert [run.settings.tasks for run in plan_experiment(study(), "out", trusted=[TASK])] == [(TASK,)]


def test_a_name_typed_in_one_call_is_not_allowed_in_the_next(theirs: Path) -> None:
    assert task_spec(TASK).name == "Theirs"
    assert theirs.exists()
    (row,) = episodes_in(evaluation())
    assert obstacle(row, trusted=[TASK]) is None
    with pytest.raises(UntrustedNameError, match=f"--trusted {TASK}"):
        obstacle(row)
    with pytest.raises(UntrustedNameError):
        plan_experiment(study(), "out")


def test_installed_packages_are_not_searched_for_in_the_working_folder(theirs: Path) -> None:
    with pytest.raises(ImportError):
        imports.resolve_installed(TASK)
    assert not theirs.exists()
    assert imports.resolve(TASK).name == "Theirs"


def test_recordings_choose_no_code(theirs: Path) -> None:
    recording = {"protocol": PROTOCOL, "task": TASK, "variant": "Demo", "seed": 0, "actions": [0]}
    with pytest.raises(DemonstrationError, match=r"not a complete recording: .*task"):
        demos.from_recording(json.dumps(recording))
    assert not theirs.exists()
