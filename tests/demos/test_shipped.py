"""The demonstrations that come with the package: 25 of each task, all different, all replaying."""

from __future__ import annotations

import pytest

import magical_mj
from magical_mj import TASKS, demos
from magical_mj.demos.recording import REST
from magical_mj.tasks.registry import task_spec


@pytest.mark.parametrize("task", TASKS)
def test_25_demonstrations_of_each_task_are_shipped_and_differ(task: str) -> None:
    shipped = demos.load(task)
    assert len(shipped) == 25
    assert {(d.task, d.variant, d.demonstrator, d.score) for d in shipped} == {(task, "Demo", "expert", 1.0)}
    assert all(d.scene == magical_mj.sample_scene(task, "Demo", d.scene_seed) for d in shipped)
    assert max(len(d.actions) for d in shipped) <= task_spec(task).horizon()
    assert all(len(d.actions) == task_spec(task).horizon() or not d.actions[-REST:].any() for d in shipped)
    assert len({d.actions.tobytes() for d in shipped}) == 25
    assert demos.diversity(demo for demo in shipped).ways > 0.05


@pytest.mark.slow
@pytest.mark.parametrize("task", TASKS)
def test_all_shipped_demonstrations_replay(task: str) -> None:
    assert all(demos.verify(demo).good for demo in demos.load(task))
