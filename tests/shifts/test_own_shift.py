"""Shifts in a package of its own, as docs/adding-a-shift.md describes them: installed, and used as a user would."""

from __future__ import annotations

import re
from pathlib import Path

from tests.helpers.commands import code_block, example, installed, python_beside

PAGE = (Path(__file__).parents[2] / "docs" / "adding-a-shift.md").read_text()
EXAMPLE = example("fog")
USE = """
import gymnasium, pickle
import numpy as np
import magical_mj
from magical_mj.shifts import SHIFTS, expand_shifts, parse_shifts, shift_label

assert "fog" not in SHIFTS and not any("fog" in each for each in expand_shifts("all"))
assert parse_shifts("fog:Fog:3,camera:1") == parse_shifts("fog:3,camera:1") == {"camera": 1, "fog": 3}
assert shift_label({"fog:Magnet": 2}) == "magnet:2"
assert len(expand_shifts("fog")) == 5

plain, foggy = (magical_mj.Engine("FindDupe", seed=7, shifts=each, renderer="software") for each in (None, "fog:5"))
assert foggy.get_state().simulation.tobytes() == plain.get_state().simulation.tobytes()
assert (foggy.render("ego", 96) != plain.render("ego", 96)).mean() > 0.5

env = gymnasium.make("magical_mj/FindDupe-Demo-State-v0", shifts="magnet:5")
env.reset(seed=7)
pulled = magical_mj.Engine("FindDupe", seed=7, shifts="magnet:5")
for action in [1, 1, 1, 10, 10, 10] * 5:
    plain.step(action)
    pulled.step(action)
    env.step(action)
assert np.hypot(*pulled.model.opt.gravity[:2]) == 2 and not plain.model.opt.gravity.any()
assert pulled.scene != plain.scene
assert env.unwrapped.scene == pickle.loads(pickle.dumps(pulled)).scene == pulled.scene
pulled.set_state(plain.get_state())
assert not pulled.model.opt.gravity.any()
"""


def test_the_page_shows_parts_of_the_example() -> None:
    assert code_block(PAGE, "python", "import numpy") in (EXAMPLE / "fog.py").read_text()
    assert code_block(PAGE, "toml", "[project.entry") in (EXAMPLE / "pyproject.toml").read_text()


def test_each_has_at_most_40_lines() -> None:
    classes = re.split(r"^(?=class )", (EXAMPLE / "fog.py").read_text(), flags=re.MULTILINE)[1:]
    assert len(classes) == 2
    assert all(len(text.splitlines()) <= 40 for text in classes)


def test_they_are_installed_and_used(tmp_path: Path) -> None:
    code = code_block(PAGE, "python", "import magical_mj") + USE
    done = python_beside(installed(EXAMPLE, tmp_path), tmp_path, "-c", code)
    assert done.returncode == 0, done.stderr
