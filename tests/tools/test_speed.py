"""`python -m tools.benchmarks`: that it measures what it says, not how fast anything is."""

from __future__ import annotations

import json

import numpy as np
import pytest

from magical_mj.envs.gymnasium_env import MagicalEnv
from magical_mj.envs.presets import preset_named
from tools.benchmarks.__main__ import main
from tools.benchmarks.single import RESETS, BareLoop, Measurement, measure

SHORT = ("--tasks", "MoveToRegion", "--variants", "Demo", "--presets", "State", "--steps", "30")


def test_rates_and_shares() -> None:
    speed = Measurement("FindDupe", "Demo", "State", 80, 0.5, 0.4, {"rewritten": [1.0, 3.0], "compiled": []})
    assert (speed.rate, speed.bare_rate) == (160, 200)
    assert speed.share == pytest.approx(0.8)
    assert (speed.reset_quantile("rewritten", 0.5), speed.reset_quantile("compiled", 0.5)) == (2.0, None)


@pytest.mark.parametrize(
    ("task", "variant", "cause"), [("FixColour", "Layout", "rewritten"), ("MakeLine", "All", "compiled")]
)
def test_whole_episodes_are_measured_and_resets_split_by_what_they_do(task: str, variant: str, cause: str) -> None:
    speed = measure(task, variant, "State", 1)
    assert speed.steps > 1
    assert min(speed.seconds, speed.bare_seconds) > 0
    assert sum(map(len, speed.resets.values())) == RESETS
    assert len(speed.resets[cause]) > RESETS / 2


@pytest.mark.parametrize("name", ["LoRes4E", "State"])
def test_the_bare_loop_takes_the_same_steps(name: str) -> None:
    env = MagicalEnv("MatchRegions", "All", name)
    env.reset(seed=1)
    bare = BareLoop(env.scene, preset_named(name))
    for action in (1, 1, 4, 13):
        bare.run([action])
        env.step(action)
    np.testing.assert_allclose(bare.data.qpos, env.engine.data.qpos, atol=1e-9)
    bare.close()


def test_tables_and_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(SHORT) == 0
    *table, _, machine = capsys.readouterr().out.splitlines()
    assert table[0].startswith("| Environment | Preset |")
    assert table[2].startswith("| MoveToRegion Demo | State |")
    assert len({line.count("|") for line in table}) == 1
    assert "cores" in machine
    assert main([*SHORT, "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["machine"]["cores"] >= 1
    assert facts["memory_mb"] > 10
    (speed,) = facts["environments"]
    assert (speed["task"], speed["variant"], speed["preset"], speed["steps"]) == ("MoveToRegion", "Demo", "State", 40)
    np.testing.assert_allclose(speed["share"], speed["rate"] / speed["bare_rate"])
    assert speed["resets"]["rewritten"]["count"] == RESETS


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("--tasks FindDup", "FindDup"),
        ("--variants Al", "Al"),
        ("--presets LoRes5E", "LoRes5E"),
        ("--num-envs 5", "only with --batched"),
        ("--batched --num-envs 8,0", "must be positive numbers"),
        ("--batched --device cuda:7", "no device 'cuda:7'"),
    ],
)
def test_wrong_use(line: str, hint: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 2
    assert hint in capsys.readouterr().err
