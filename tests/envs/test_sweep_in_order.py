"""The example examples/sweep_in_order: a task of one's own with x-magical's bodies, subtasks and rewards."""

from __future__ import annotations

import importlib
from typing import Any

import gymnasium
import numpy as np
import pytest

import magical_mj
from tests.helpers.commands import code_block, example

FOLDER = example("sweep_in_order")
TASK = "sweep_in_order:SPEC"


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(FOLDER))
    return importlib.import_module("sweep_in_order")


def test_pieces_count_in_their_order(module: Any) -> None:
    demo = module.SPEC.demo
    places = [(block.x, block.y, 0.0) for block in demo.blocks]

    def after(*pieces: int) -> Any:
        """The scene with these pieces at the top."""
        return demo.moved(blocks=[(x, 0.92 if number in pieces else y, a) for number, (x, y, a) in enumerate(places)])

    for moves, score in (
        ([(0,), (0, 1), (0, 1, 2)], 1.0),
        ([(0,), (0, 1)], 2 / 3),
        (
            [(1,), (0, 1), (0, 1, 2)],
            1 / 3 + 1 / 3,
        ),  # the red one came after the blue one; those before the yellow count
        ([(2,), (1, 2), (0, 1, 2)], 1 / 3),
        ([(0, 1, 2)], 1 / 3),
        ([(0,), ()], 0.0),
    ):
        scenes = [demo, *(after(*pieces) for pieces in moves)]
        assert magical_mj.score_trajectory(TASK, scenes) == pytest.approx(score)
        assert (module.SPEC.remaining(scenes, "paper") == 0.0) == (score == 1.0)


def test_subtasks_are_seen_and_rewarded(module: Any) -> None:
    env = module.Subtasks(
        gymnasium.make(magical_mj.env_id(TASK, "Demo", "State"), body="shortstick", action="speeds", reward="dense")
    )
    observation, info = env.reset(seed=0)
    assert observation in env.observation_space
    assert (observation[-4:].tolist(), info["subtask"]) == ([1, 0, 0, 0], 0)
    scene = env.unwrapped.scene
    red = next(block for block in scene.blocks if block.colour == "red")
    below = scene.moved(robot=(red.x, red.y - 0.25, 0.0))
    env.reset(options={"scene": below})
    rewards, subtasks = [], []
    for _ in range(15):
        observation, reward, _, _, info = env.step(np.array([0.8, 0.0], np.float32))
        rewards.append(reward)
        subtasks.append(info["subtask"])
    assert subtasks[0] == 0
    assert subtasks[-1] == 1
    assert rewards[subtasks.index(1)] == 1.0
    assert observation[-4:].tolist() == [0, 1, 0, 0]
    env.close()


def test_the_page_runs(module: Any) -> None:
    """As after the installation, when the task has its name."""
    for variant in ("Demo", "Layout"):
        magical_mj.env_id(TASK, variant, "State")
    code = code_block((FOLDER / "README.md").read_text(), "python", "import gymnasium")
    exec(compile(code, "README.md", "exec"), names := {})  # type: ignore[var-annotated]
    observations, _ = names["envs"].reset(seed=0)
    assert observations.shape == (8, 189)
    names["envs"].close()
