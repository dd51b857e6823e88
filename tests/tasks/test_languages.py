"""Languages of tasks that other packages announce."""

from __future__ import annotations

from pathlib import Path

from tests.helpers.commands import python_beside

MODULE = """
from dataclasses import replace

from magical_mj.tasks.move_to_corner import SPEC


class Shapes:
    def canonical(self, text):
        return text.strip().lower()

    def spec(self, text):
        (block,) = SPEC.demo.blocks
        return replace(SPEC, name=f"Corner{text}", demo=replace(SPEC.demo, blocks=(replace(block, shape=text),)))

    def members(self, text):
        return ("star", "circle") if text == "round" else ()


SHAPES = Shapes()
"""
CODE = """
import magical_mj
from magical_mj.tasks.registry import code_digest, listed_tasks, task_name, task_spec

assert task_name("corner: STAR") == "corner:star"
assert task_spec("corner: STAR") is task_spec("corner:star")
assert listed_tasks("corner:round,FindDupe") == ["corner:star", "corner:circle", "FindDupe"]
assert code_digest("corner:star") != code_digest("corner:circle")
assert magical_mj.sample_scene("corner:circle", "Colour", 1).blocks[0].shape == "circle"
assert magical_mj.env_id("corner:star") == "magical_mj/Cornerstar-Demo-v0"
try:
    task_spec("corner:cube")
except magical_mj.tasks.registry.InvalidSceneError as error:
    print(error)
"""


def test_a_language_of_another_package_names_tasks_too(tmp_path: Path) -> None:
    site = tmp_path / "site"
    facts = site / "corners-1.dist-info"
    facts.mkdir(parents=True)
    (site / "corners.py").write_text(MODULE)
    (facts / "METADATA").write_text("Metadata-Version: 2.1\nName: corners\nVersion: 1\n")
    (facts / "entry_points.txt").write_text("[magical_mj.task_languages]\ncorner = corners:SHAPES\n")
    done = python_beside(site, tmp_path, "-c", CODE)
    assert done.returncode == 0, done.stderr
    assert "it must be one of square, pentagon, star, circle" in done.stdout
