"""Everything but `magical_mj.load` works where neither dm_control nor dm_env is installed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

PROGRAM = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("dm_control", "dm_env", "labmaze", "tree"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Refuse())
import gymnasium, magical_mj
from magical_mj.policies.expert import Expert
from magical_mj.utils.errors import MissingExtraError

env = gymnasium.make("magical_mj/MoveToRegion-TestAll-LoRes4E-v0")
env.reset(seed=0)
ended = False
while not ended:
    *_, ended, info = env.step(env.action_space.sample())
assert 0.0 <= info["eval_score"] <= 1.0

engine = magical_mj.Engine("MoveToRegion", seed=0)
expert = Expert(engine, "MoveToRegion")
while not engine.step(expert()):
    pass
assert engine.score() == 1.0
magical_mj.export_mjcf(engine, "model.xml")
results = magical_mj.evaluate(lambda observation: 1, tasks="MoveToRegion", variants="Demo", episodes=1)
assert len(results) == 1
from magical_mj import *  # names are there, and tell what is missing when they are used
assert not isinstance(engine, magical_mj.Environment)
try:
    load("MoveToRegion")
except MissingExtraError as error:
    assert "dm_control" in str(error) and "MuJoCo 3" in str(error)
else:
    sys.exit("load worked without dm_control")
"""


def test_without_dm_control_and_dm_env(tmp_path: Path) -> None:
    result = subprocess.run([sys.executable, "-c", PROGRAM], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "model.xml").exists()
