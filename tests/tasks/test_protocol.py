"""What a protocol number promises has not changed since the number was given.

If this fails and you did not mean to change anything, you changed the order of some draws, the placement, a score or a
setting of the physics. If you did mean to, see `regenerate_protocol`.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest

import magical_mj
from magical_mj.protocol import DEMONSTRATIONS, MUJOCO, PROTOCOL, SOLVED
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS
from tests.helpers import regenerate_protocol as fingerprints

GOLDEN = fingerprints.golden()


def test_the_only_scene_that_starts_solved_is_on_the_card() -> None:
    solved = {
        ("MakeLine", variant, seed)
        for variant in ("Layout", "CountPlus", "All")
        for seed in range(100)
        if magical_mj.score("MakeLine", scene := magical_mj.sample_scene("MakeLine", variant, seed), scene) == 1.0
    }
    assert solved == SOLVED == {("MakeLine", "CountPlus", 13), ("MakeLine", "All", 13)}
    card = (Path(__file__).parents[2] / "docs" / "benchmark-card.md").read_text()
    assert "In MakeLine CountPlus and All, the scene of seed 13 starts with score 1" in card


def test_the_numbers_are_those_of_the_data_file_and_of_the_page() -> None:
    assert GOLDEN["numbers"] == {"protocol": PROTOCOL, "demonstrations": DEMONSTRATIONS}
    page = (Path(__file__).parents[2] / "docs" / "protocol.md").read_text()
    for title, newest in (("Protocols", PROTOCOL), ("Demonstrations", DEMONSTRATIONS)):
        (rows,) = re.findall(rf"## {title}\n(.*?)(?:\n## |\Z)", page, re.DOTALL)
        numbers = re.findall(r"^\| (\d+) \|", rows, re.MULTILINE)
        assert numbers == [str(number) for number in range(1, newest + 1)]


@pytest.mark.parametrize("task", TASKS)
def test_the_environments_and_their_scenes_of_seeds_0_to_99_are_the_same(task: str) -> None:
    scenes = {f"{name}-{variant}": fingerprints.scenes(name, variant) for name, variant in ENVIRONMENTS if name == task}
    assert scenes == {name: digest for name, digest in GOLDEN["scenes"].items() if name.startswith(f"{task}-")}


@pytest.mark.parametrize("task", TASKS)
@pytest.mark.parametrize("part", [fingerprints.horizons, fingerprints.scores, fingerprints.physics])
def test_horizons_scores_and_physics_are_the_same(part: Callable[[str], object], task: str) -> None:
    assert part(task) == GOLDEN[part.__name__][task]


def test_mujoco_is_of_the_same_series() -> None:
    assert mujoco.__version__.partition(".")[0] in MUJOCO


@pytest.mark.parametrize("task", TASKS)
def test_the_shipped_demonstrations_are_the_same(task: str) -> None:
    assert fingerprints.demonstrations(task) == GOLDEN["demonstrations"][task]


def test_the_fingerprint_of_the_physics_notices_physics_and_nothing_else() -> None:
    env = magical_mj.Engine("FindDupe", "Demo")
    env.reset()
    model, before = env.model, fingerprints.physics("FindDupe")
    assert before == fingerprints.physics("FindDupe")
    same = fingerprints.model_digest(model)
    model.geom_rgba[:] = 0.5
    model.geom_group[:] = 0
    assert fingerprints.model_digest(model) == same
    touching = int(model.geom_contype.nonzero()[0][0])
    for array, row in (
        (model.pair_friction, 0),
        (model.dof_frictionloss, 0),
        (model.actuator_gear, 0),
        (model.geom_solref, touching),
    ):
        values = array[row].copy()
        array[row] += 1e-3
        assert fingerprints.model_digest(model) != same
        array[row] = values
    assert fingerprints.model_digest(model) == same
    env.close()
