"""`magical-mj bench`: that it measures what it says, not how fast anything is."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from magical_mj.cli import main
from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import preset_named
from magical_mj.speed.bare import BareLoop
from magical_mj.speed.measure import RESETS, measure
from magical_mj.speed.yardstick import Yardstick
from tests.helpers.commands import Shell

SHORT = ("bench", "--tasks", "MoveToRegion", "--variants", "Demo,All", "--presets", "State", "--steps", "30")


def test_whole_episodes_are_measured() -> None:
    made = measure("MoveToRegion", "Jitter", "State", 60)
    assert made.steps == 80
    assert made.rate == pytest.approx(80 / made.seconds)
    assert made.ratio == pytest.approx(made.bare_seconds / made.seconds)


@pytest.mark.parametrize(
    ("task", "variant", "cause"), [("FixColour", "Layout", "rewritten"), ("MakeLine", "All", "compiled")]
)
def test_resets_are_split_by_what_they_do(task: str, variant: str, cause: str) -> None:
    made = measure(task, variant, "State", 1)
    assert sum(map(len, made.resets.values())) == RESETS
    assert len(made.resets[cause]) > RESETS / 2
    if variant == "Layout":
        assert made.reset_quantile("compiled", 0.5) is None
    assert 0 < made.reset_quantile(cause, 0.5) <= made.reset_quantile(cause, 0.95)


@pytest.mark.parametrize("name", ["LoRes4E", "LoResStack", "State"])
def test_the_bare_loop_takes_the_same_steps(name: str) -> None:
    env = MagicalEnv("MatchRegions", "All", name)
    env.reset(seed=1)
    bare = BareLoop(env.scene, preset_named(name))
    for action in (1, 1, 4, 13):
        bare.run([action])
        env.step(action)
    np.testing.assert_allclose(bare.simulation.data.qpos, env.dm_env.physics.data.qpos, atol=1e-9)
    bare.close()


def test_a_broken_gym_pusht_spoils_no_measurement(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Installed, but a package that it needs is missing."""
    (tmp_path / "gym_pusht.py").write_text("import a_package_that_is_not_there\n")
    monkeypatch.syspath_prepend(tmp_path)
    yardstick = Yardstick()
    yardstick.run()
    assert yardstick.rate is None
    assert "a_package_that_is_not_there" in str(yardstick.problem)


def test_without_gym_pusht_there_is_no_yardstick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.speed.yardstick.find_spec", lambda name: None)
    yardstick = Yardstick()
    yardstick.run()
    assert yardstick.rate is None


def test_bench_prints_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SHORT) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:2] == ["Environment", "Preset"]
    assert [line.split()[:3] for line in lines[1:3]] == [["MoveToRegion", name, "State"] for name in ("Demo", "All")]
    assert "cores" in lines[3]


def test_bench_prints_markdown(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SHORT, "--markdown"]) == 0
    table = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(table) == 4
    assert len({line.count("|") for line in table}) == 1


def test_bench_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*SHORT, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["machine"]["cores"] >= 1
    assert facts["memory_mb"] > 10
    for made, variant in zip(facts["environments"], ("Demo", "All"), strict=True):
        assert (made["task"], made["variant"], made["preset"], made["steps"]) == ("MoveToRegion", variant, "State", 40)
        np.testing.assert_allclose(made["ratio"], made["rate"] / made["bare_rate"])
        assert made["resets"]["rewritten"]["count"] == RESETS


def test_bench_prints_a_profile() -> None:
    """In a process of its own: CPython 3.11 can spin for ever if it profiles after a thread was interrupted."""
    command = [sys.executable, "-m", "magical_mj", *SHORT, "--profile"]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=120)
    assert "tottime" in result.stdout


@pytest.mark.parametrize(("option", "name"), [("--tasks", "FindDup"), ("--variants", "Al"), ("--presets", "LoRes5E")])
def test_bench_names_what_it_does_not_know(option: str, name: str, shell: Shell) -> None:
    assert name in shell.fails(2, "bench", option, name)
