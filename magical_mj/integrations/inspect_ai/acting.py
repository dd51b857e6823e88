"""Acting on an intent: the tools that a model has, and the agent that uses them.

The tools are the manoeuvres of the expert: to bring a block to a position, or to drive there. They are planned in a
copy of the simulation and performed with the 18 actions, within the task's horizon.
"""

from __future__ import annotations

from contextlib import closing
from typing import Final

import numpy as np
from inspect_ai.agent import AgentSubmit, as_solver, react
from inspect_ai.model import Content
from inspect_ai.solver import Generate, Solver, TaskState, solver
from inspect_ai.tool import Tool, ToolError, tool

from magical_mj.engine import Engine
from magical_mj.experts.driving import Lookahead
from magical_mj.experts.planner import Planner
from magical_mj.integrations.inspect_ai.content import contents
from magical_mj.integrations.inspect_ai.scoring import ACTIONS, FINAL
from magical_mj.intents.question import question_of
from magical_mj.intents.question_text import table
from magical_mj.intents.readings import moved_blocks
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Subgoal

REACH: Final = 0.9
"""The greatest |x| and |y| of a position that a tool accepts (world units)."""
NEAR: Final = 0.07
"""A manoeuvre ends at most this far (world units) from its target, as those of plans."""
LONGEST: Final = 120
"""A manoeuvre takes at most this number of actions."""
BUDGET: Final = 1_500
"""After this number of simulated steps, no other plan of a manoeuvre is tried."""
PLANS: Final = 3
"""The number of plans of a manoeuvre, each faster than the one before. The last one is performed."""
DISTURBED: Final = 0.5
"""The value of a plan that also moves other blocks. Without them, it is 1."""
MESSAGES: Final = 60
"""The largest number of messages in an episode, those of the tools included."""


class Hands:
    """Performs manoeuvres in an engine, and keeps the actions.

    Attributes:
        engine: the engine, at the start of an episode.
        actions: the performed actions.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.actions: list[int] = []
        self._rng = np.random.Generator(np.random.PCG64(0))

    @property
    def left(self) -> int:
        """The number of remaining actions."""
        return (self.engine.horizon or 0) - self.engine.steps

    def perform(self, subgoal: Subgoal) -> bool:
        """Performs a manoeuvre that reaches the subgoal, if possible without moving other blocks.

        Returns False, and does nothing, if none was found.
        """
        before = self.engine.scene
        if subgoal.left(before) == 0.0:
            return True
        if self.left <= 0:
            return False

        def score(scene: Scene) -> float:
            stray = set(moved_blocks(before, scene)) - {subgoal.block}
            return 0.0 if subgoal.left(scene) else DISTURBED if stray else 1.0

        planner = Planner(
            score,
            lambda scene, _, __: (subgoal,) if subgoal.left(scene) else (),
            Lookahead(self.engine),
            steady=True,
        )
        best, left = None, min(self.left, LONGEST)
        for _ in range(PLANS):
            plan = planner.plan(left, BUDGET, self._rng)
            if plan.score == 0.0 or (best and plan.score < best.score):
                break
            best, left = plan, len(plan.actions) - plan.rest - 1
        if best is None:
            return False
        for action in best.actions[: len(best.actions) - best.rest]:
            self.engine.step(action)
            self.actions.append(action)
        return True


@solver
def agent(form: str) -> Solver:
    """An agent with the tools move, drive, look and done, which plays an episode in the question's scene."""

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        question = question_of(state.metadata["question"])
        with closing(Engine(question.name, "All", scene=question.scene)) as engine:
            hands = Hands(engine)
            tools = [move(hands), drive(hands), look(hands, form)]
            submit = AgentSubmit(name="done", description="End the episode: the goal is reached, or cannot be.")
            state.message_limit = state.message_limit or MESSAGES
            try:
                return await as_solver(react(prompt=None, tools=tools, submit=submit))(state, generate)
            finally:
                state.store.set(FINAL, engine.scene.to_json())
                state.store.set(ACTIONS, hands.actions)

    return solve


@tool
def move(hands: Hands) -> Tool:
    """A tool that brings a block to a position."""

    async def execute(block: int, x: float, y: float) -> str:
        """Bring a block to a position: drive to it, grip it, carry it, and release it.

        Args:
            block: The number of the block, from 1.
            x: The position to the right, from -0.9 to 0.9.
            y: The position upwards, from -0.9 to 0.9.
        """
        count = len(hands.engine.scene.blocks)
        if not 1 <= block <= count:
            raise ToolError(f"there are the blocks 1 to {count}, not {block}")
        return _report(hands, Subgoal(block - 1, _target(x, y), NEAR), f"block {block}")

    return execute


@tool
def drive(hands: Hands) -> Tool:
    """A tool that drives the robot to a position."""

    async def execute(x: float, y: float) -> str:
        """Drive the robot to a position.

        Args:
            x: The position to the right, from -0.9 to 0.9.
            y: The position upwards, from -0.9 to 0.9.
        """
        return _report(hands, Subgoal(None, _target(x, y), NEAR), "the robot")

    return execute


@tool
def look(hands: Hands, form: str) -> Tool:
    """A tool that shows the scene."""

    async def execute() -> list[Content]:
        """Look at the scene as it is now."""
        return list(contents(hands.engine.scene, form))

    return execute


def _target(x: float, y: float) -> tuple[float, float]:
    if not (abs(x) <= REACH and abs(y) <= REACH):
        raise ToolError(f"x and y are from -{REACH} to {REACH}, not {x} and {y}")
    return x, y


def _report(hands: Hands, subgoal: Subgoal, name: str) -> str:
    """Performs a manoeuvre, and says what happened."""
    engine = hands.engine
    before, steps = engine.scene, engine.steps
    if hands.perform(subgoal):
        what = f"{name} is there after {engine.steps - steps} steps"
    else:
        what = f"{name} could not be moved there in the steps that are left, and nothing was done"
    stray = [str(index + 1) for index in moved_blocks(before, engine.scene) if index != subgoal.block]
    if stray:
        what += f"; on the way, other blocks were pushed: {', '.join(stray)}"
    return f"{what}; {hands.left} steps are left. The scene now:\n{table(engine.scene)}"
