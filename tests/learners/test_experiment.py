"""Experiments: many runs into one report."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tarfile
import time
from pathlib import Path
from typing import Any

import pytest

import magical_mj
from magical_mj.cli import console
from magical_mj.cli.app import run
from magical_mj.evaluation.folder import SETTINGS
from magical_mj.evaluation.reports.results import published_results
from magical_mj.evaluation.scores import SCORES
from magical_mj.learners import checkpoint, plan_experiment, run_experiment
from magical_mj.learners.experiment import agreement
from magical_mj.learners.policy import POLICY
from magical_mj.learners.run_folder import CHECKPOINT, METRICS
from magical_mj.utils.errors import MagicalError, SettingsError, UnknownNameError
from magical_mj.utils.files import read_toml

ROOT = Path(__file__).parents[2]
FULL_SIZE = ROOT / "tools" / "full_size"
EXPERIMENTS = sorted([*ROOT.glob("results/*/experiment.toml"), *FULL_SIZE.glob("*.toml")])
EXPERIMENT = """
methods = ["bc"]
tasks = ["MoveToRegion", "FixColour"]
seeds = [0, 1]
quick = false
[settings]
preset = "State"
evaluations = 0
checkpoints = 1
demonstrations = 2
bc.batches = 4
bc.batch_size = 4
network.hidden = 8
[evaluation]
variants = "Demo"
episodes = 2
"""


@pytest.mark.slow
def test_an_experiment_ends_in_a_report_and_goes_on(tmp_path: Path) -> None:
    """Two processes; done again, with one run damaged, only that is trained anew."""
    file = tmp_path / "experiment.toml"
    file.write_text(text := EXPERIMENT.replace('"MoveToRegion", "FixColour"', '"FixColour"'))
    out = tmp_path / "lr=0.1, twice"
    lines = list(run_experiment(plan_experiment(str(file), str(out)), str(out), jobs=2))
    assert len(lines) == 3
    assert sorted(line.partition(":")[0] for line in lines[:2]) == ["bc-FixColour-0", "bc-FixColour-1"]
    page = Path(lines[2]).read_text()
    assert "BC (ST, State), ours" in page
    assert "GAIL (ST)†" in page
    before = (out / "runs" / "bc-FixColour-1" / POLICY).read_bytes()
    for path in (out / "runs" / "bc-FixColour-1").glob("*.safetensors"):
        path.unlink()
    updates: list[tuple[str, int]] = []
    again = list(
        run_experiment(
            plan_experiment(file, out), out, watch=lambda name, progress: updates.append((name, progress.update))
        )
    )
    assert updates == [("bc-FixColour-1", update) for update in range(1, 5)]
    assert [line.split(":")[0] for line in again[:2] if ": trained;" in line] == ["bc-FixColour-1"]
    assert sum("was trained before" in line for line in again) == 1
    assert (out / "runs" / "bc-FixColour-1" / POLICY).read_bytes() == before  # in another process
    moved = out.rename(tmp_path / "moved")
    assert all("was trained before" in run.play() for run in plan_experiment(file, moved))
    file.write_text(text.replace("[0, 1]", "[2, 0, 1]").replace("episodes = 2", 'rules = "released"\nepisodes = 2'))
    with pytest.raises(SettingsError, match=r"rules was .paper. and is .released."):
        next(run_experiment(plan_experiment(file, moved), moved))
    assert not (moved / "runs" / "bc-FixColour-2").exists()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('["bc"]', '["bd"]', "unknown method"),
        ('["bc"]', "[]", "must give methods"),
        ("seeds = [0, 1]", "", "must give seeds"),
        ("quick = false", "quik = true", "quick"),
        ("FixColour", "FixColor", "FixColour"),
        ("bc.batches = 4", "bc.batch = 4", "bc.batches"),
        ('"Demo"', '"Demos"', "Demo"),
        ("episodes = 2", "runs = 2", "episodes"),
        ("quick = false", 'quick = "no"', "quick"),
        ('["bc"]', '["bc", "bc"]', "methods contains an entry twice"),
        ("seeds = [0, 1]", "seeds = [2_000_000_000]", "at most"),
        ('"FixColour"', '"MoveToRegion"', "tasks contains an entry twice"),
        ("bc.batches = 4", "seed = 4", "seed has its own option"),
        ('variants = "Demo"', 'variants = "Shape"', "MoveToRegion"),  # which FixColour has
    ],
)
def test_wrong_experiments_are_refused(old: str, new: str, says: str, tmp_path: Path) -> None:
    file = tmp_path / "experiment.toml"
    file.write_text(EXPERIMENT.replace(old, new))
    with pytest.raises((SettingsError, UnknownNameError), match=says):
        plan_experiment(file, tmp_path / "out")
    with pytest.raises(SettingsError, match="cannot be read"):
        plan_experiment(tmp_path / "none.toml", tmp_path / "out")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({'["bc"]': '["bc", "goals"]', 'preset = "State"\n': ""}, "goals are inferred from states"),
        ({"demonstrations = 2": "demonstrations = 26"}, "there are 25"),
        ({"evaluations = 0": 'evaluations = 0\ndevice = "abacus"'}, "has no device 'abacus'"),
        ({}, "report.md does not belong to an earlier report"),
    ],
)
def test_wrong_experiments_fail_before_the_first_run(change: dict[str, str], says: str, tmp_path: Path) -> None:
    text, out = EXPERIMENT, tmp_path / "out"
    for old, new in change.items():
        text = text.replace(old, new)
    (tmp_path / "e.toml").write_text(text)
    if not change:
        (out / "report").mkdir(parents=True)
        (out / "report" / "report.md").write_text("mine")
    with pytest.raises(MagicalError, match=says):
        next(run_experiment(plan_experiment(tmp_path / "e.toml", out), out))
    assert not (out / "runs").exists()


def test_an_experiment_tells_how_far_its_runs_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """Where there is no terminal, also of runs in other processes, and of evaluations."""
    for name in ("FIRST", "MINUTE"):
        monkeypatch.setattr(console, name, 0.01)
    monkeypatch.setattr("magical_mj.learners.cli.train.PAUSE", 0.02)
    file = tmp_path / "e.toml"
    file.write_text(EXPERIMENT.replace("seeds = [0, 1]", "seeds = [0]").replace(', "FixColour"', ""))
    assert run(["experiment", str(file), "--out", str(tmp_path / "out"), "--jobs", "1"]) == 0
    printed = capfd.readouterr().out
    assert re.search(r"experiment 0/1 runs bc-MoveToRegion-0: \d of 2 episodes evaluated|bc-\S+: \d updates", printed)


def test_how_far_a_run_is_is_read_from_its_files(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text(EXPERIMENT)
    run = plan_experiment(tmp_path / "e.toml", tmp_path / "out")[0]
    assert run.standing(since=0) == ""  # nothing has begun
    run.trained.mkdir(parents=True)
    (run.trained / METRICS).write_text("update,seconds\n")
    assert run.standing(since=0) == "bc-MoveToRegion-0: 0 updates"
    (run.trained / METRICS).write_text("update,seconds\n2,0.1\n3,0.2\n")
    assert run.standing(since=0) == "bc-MoveToRegion-0: 3 updates"
    assert run.standing(since=time.time() + 60) == ""  # it was another process, long ago
    run.scores.mkdir(parents=True)
    os.utime(run.trained / METRICS, (1, 1))
    for count, line in ((0, "0 of 2 episodes evaluated"), (1, "1 of 2 episodes evaluated")):
        (run.scores / SCORES).write_text("{}\n" * count)
        assert run.standing(since=0) == f"bc-MoveToRegion-0: {line}"
    (run.scores / SCORES).write_text("{}\n" * 2)
    assert run.standing(since=0) == ""  # it is finished


def test_the_order_of_environments_is_compared_with_the_papers(tmp_path: Path) -> None:
    """Scores that are the paper's own have the rank correlation 1; scores that are all alike have none."""
    (tmp_path / "e.toml").write_text('methods = ["bc"]\ntasks = ["FindDupe"]\nseeds = [0]')
    planned = plan_experiment(tmp_path / "e.toml", tmp_path / "out")
    out = planned[0].scores
    magical_mj.evaluate({planned[0].method: "noop"}, tasks="FindDupe", episodes=1, jobs=1, out=out)
    assert list(agreement(planned)) == []
    published = published_results().query("policy == 'BC (ST)' and task == 'FindDupe'")
    paper = dict(zip(published["variant"], published["mean"], strict=True))
    rows = [json.loads(line) for line in (out / "scores.jsonl").read_text().splitlines()]
    (out / "scores.jsonl").write_text(
        "".join(json.dumps({**row, "score": paper[row["variant"]]}) + "\n" for row in rows)
    )
    (line,) = agreement(planned)
    assert "the paper's BC (ST): rank correlation 1.00 over 8 environments, 1.00 over the means of 8 variants" in line


def test_changed_settings_show_in_the_methods_name(tmp_path: Path) -> None:
    file = tmp_path / "experiment.toml"
    file.write_text(EXPERIMENT)
    changed = "demonstrations 2, bc.batches 4, bc.batch_size 4, network.hidden 8"
    assert {run.method for run in plan_experiment(file, tmp_path)} == {f"BC (ST, State), ours, {changed}"}


@pytest.mark.parametrize("file", EXPERIMENTS, ids=lambda file: str(file.relative_to(ROOT)))
def test_the_packages_experiments_can_be_run(file: Path, tmp_path: Path) -> None:
    """Each says how, and plans as many runs as it has methods, groups of tasks and seeds."""
    assert f"magical-mj experiment {file.relative_to(ROOT)} --out runs/" in file.read_text()
    planned, table = plan_experiment(file, tmp_path), read_toml(file)
    tasks = magical_mj.TASKS if table["tasks"] == "all" else table["tasks"]
    groups = 1 if table.get("multi_task") else len(tasks)
    assert len({run.name for run in planned}) == len(planned) == len(table["methods"]) * groups * len(table["seeds"])


SMALL = """tasks = ["MoveToRegion"]
seeds = [0]
[settings]
device = "cpu"
preset = "State"
evaluations = 0
checkpoints = 2
demonstrations = 2
network.hidden = 8
bc.batches = 1000
bc.batch_size = 4
[evaluation]
variants = "Demo"
episodes = 1
"""


@pytest.mark.weekly
def test_trainings_of_the_papers_size_continue_where_they_stopped(tmp_path: Path) -> None:
    """The script's own loop, with small sizes. It is stopped, and called again."""
    (tmp_path / "pixels-bc.toml").write_text(f'methods = ["bc"]\n{SMALL}')
    script = shutil.copy(FULL_SIZE / "accelerator.sh", tmp_path)
    path = {"PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])}
    how: dict[str, Any] = {"cwd": tmp_path, "env": os.environ | path}
    command = ["bash", script, "500", "1", "runs", "pixels-bc"]
    first = subprocess.Popen(command, start_new_session=True, stdout=subprocess.PIPE, text=True, **how)
    run = tmp_path / "runs" / "pixels-bc" / "runs" / "bc-MoveToRegion-0"
    while not (run / METRICS).exists() or (run / METRICS).read_text().count("\n") < 3:
        assert first.poll() is None
        time.sleep(0.05)
    first.terminate()  # the shell only; Ctrl-C does the same
    assert "stopped; the same command continues" in first.communicate()[0]
    assert first.returncode == 128 + signal.SIGTERM
    assert checkpoint.read(run / CHECKPOINT)["update"] > 0
    second = subprocess.run(command, capture_output=True, text=True, check=True, **how)
    assert second.stdout.count("bc-MoveToRegion-0: trained;") == 1
    with tarfile.open(tmp_path / "runs" / "evaluations.tar.gz") as archive:
        names = {Path(name) for name in archive.getnames()}
    assert names == {Path("pixels-bc", "evaluations", run.name, file) for file in (SCORES, SETTINGS)}


def test_the_papers_sizes_leave_no_table_out() -> None:
    text = (FULL_SIZE / "accelerator.sh").read_text().partition("|| set --")[2].partition("mkdir")[0]
    assert sorted(re.findall(r"pixels-[\w-]+", text)) == sorted(file.stem for file in FULL_SIZE.glob("*.toml"))
