"""SweepInOrder: sweep the red, the blue and the yellow piece of debris to the top, in this order.

x-magical's task SweepToTop with subtasks, and a wrapper that defines rewards. Start your own task from this file.

Goal
    All pieces are in the zone along the top wall, and each entered it before the next one.

What varies
    The same as in SweepToTop, except the colours, which define the order.

Score
    The share of the pieces that count: those in the zone at the end that entered it before all later ones.

Remaining distance
    For each piece that does not count: 0.3 plus its distance below y = 0.88. The result is the sum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces

from magical_mj.scene import Scene
from magical_mj.scene.constants import Colour
from magical_mj.tasks.rules import WRONG, coloured, require
from magical_mj.tasks.spec import Rules
from magical_mj.xmagical.sweep_to_top import ARRIVED, arrived
from magical_mj.xmagical.sweep_to_top import SPEC as SWEEP_TO_TOP

ORDER: Final[tuple[Colour, ...]] = ("red", "blue", "yellow")


def check(scene: Scene) -> None:
    """Raises an `InvalidSceneError` unless there is one piece of each colour."""
    SWEEP_TO_TOP.check(scene)
    colours = [block.colour for block in scene.blocks]
    require(sorted(colours) == sorted(ORDER), "SweepInOrder", f"one block of each of {ORDER}, but this has {colours}")


def counting(scenes: Sequence[Scene]) -> list[bool]:
    """For each piece in order, whether it is in the zone now and entered it before all later ones."""
    colours = [block.colour for block in scenes[0].blocks]
    pieces = [colours.index(colour) for colour in ORDER]
    inside = np.array([arrived(scene)[pieces] for scene in scenes])  # (scenes, 3)
    never = len(scenes)
    first = [int(column.argmax()) if column.any() else never for column in inside.T]
    return [bool(inside[-1, number]) and first[number] < min([*first[number + 1 :], never]) for number in range(3)]


def score(scenes: Sequence[Scene], rules: Rules = "paper") -> float:
    """The share of the pieces that count."""
    return sum(counting(scenes)) / len(ORDER)


def distance(scenes: Sequence[Scene], rules: Rules = "paper") -> float:
    """The sum over the pieces that do not count: see above."""
    heights = {block.colour: block.y for block in scenes[-1].blocks}
    pairs = zip(ORDER, counting(scenes), strict=True)
    return sum(WRONG + max(ARRIVED - heights[colour], 0.0) for colour, counts in pairs if not counts)


SPEC: Final = replace(
    SWEEP_TO_TOP,
    name="SweepInOrder",
    summary="push the red, the blue and the yellow debris into the zone at the top, in this order",
    demo=coloured(SWEEP_TO_TOP.demo, ORDER),
    check=check,
    score=score,
    distance=distance,
    trajectory=True,
    colour=None,
)
"""SweepToTop with another score, which depends on the scenes of all steps."""


class Subtasks(gymnasium.Wrapper[Any, Any, Any, Any], gymnasium.utils.RecordConstructorArgs):
    """Adds the current subtask to states, and rewards subtasks: an example of your own rewards.

    The observation gets four more entries, a one-hot code of the number of pieces that count. `info["subtask"]` is this
    number. If it changes in a step, the reward is the change. Otherwise the reward is the motion of the next piece
    towards the zone (world units).

    Args:
        env: an environment of SweepInOrder with the preset State.
    """

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        super().__init__(env)
        space = env.observation_space
        assert isinstance(space, spaces.Box)
        low, high = np.append(space.low, np.zeros(4)), np.append(space.high, np.ones(4))
        self.observation_space = spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)

    @property
    def _engine(self) -> Any:
        return self.get_wrapper_attr("engine")

    def _now(self) -> tuple[int, float]:
        """The number of pieces that count, and the y of the first piece that does not count."""
        done = counting(self._engine.scored_scenes)
        heights = {block.colour: block.y for block in self._engine.scene.blocks}
        following = ORDER[done.index(False)] if False in done else ORDER[-1]
        return sum(done), heights[following]

    def _seen(self, observation: Any, done: int) -> Any:
        return np.concatenate([observation, np.eye(4, dtype=np.float32)[done]])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode."""
        observation, info = super().reset(seed=seed, options=options)
        self._before = self._now()
        return self._seen(observation, self._before[0]), info | {"subtask": self._before[0]}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """One action."""
        observation, _, terminated, truncated, info = super().step(action)
        (done_before, height_before), (done, height) = self._before, self._now()
        self._before = done, height
        reward = float(done - done_before) if done != done_before else height - height_before
        return self._seen(observation, done), reward, terminated, truncated, info | {"subtask": done}
