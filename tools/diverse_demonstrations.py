"""Makes the second set of demonstrations: 25 of each task, by demonstrators who differ from each other as people do.

    python tools/diverse_demonstrations.py [--tasks MoveToRegion,...]

A demonstrator has a style, drawn from its seed. It handles the blocks in a random order. On its way it makes detours,
approaches blocks from any side, and grips, pushes or pulls them. It sets blocks down half-way, pauses, releases the
accelerator, presses wrong keys and lets blocks go. Then it corrects what happened. Manoeuvres, and the steering that
corrects errors, are those of the expert.

Of many candidates with score 1, the 25 are chosen whose statistics are nearest to people's, and whose orders and sides
of approach differ most. All draws come from fixed seeds. Tasks that are not named keep their demonstrations.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from itertools import count, islice
from typing import Final, NamedTuple

import numpy as np

from magical_mj import TASKS
from magical_mj.actions import NOOP, Action, Drive, Gripper, Turn
from magical_mj.demos import shipped
from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import replayed, strategy
from magical_mj.engine import Engine
from magical_mj.experts.driving import HumanExecution, Lookahead, SavedState
from magical_mj.experts.manoeuvres import Manoeuvre, manoeuvres, obstacles, perform
from magical_mj.experts.navigation import EMPTY, cell_costs, explore
from magical_mj.scene import Scene
from magical_mj.tasks.planning import Noise, Subgoal
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import PlacementError
from tools.pack_demonstrations import pack_rows
from tools.research.demonstration_statistics import STATISTICS

COUNT: Final = 25
CANDIDATES: Final = 34
"""The number of successful demonstrations of each task. The best set of them is chosen."""
ALIKE: Final = 0.1
"""The weight of the shares of different orders and strategies in the choice."""
REST: Final = 50
"""A demonstration ends after this number of no-ops, or with the episode."""
REACH: Final = 90  # actions: the longest path
TRIED: Final = 10  # manoeuvres in one situation
HALF: Final = 0.8  # half side of the square that contains the ends of detours
AROUND: Final = (0.42, 0.9)  # world units: the distance from a block of the end of a detour to it
NEAR: Final = 0.12  # world units: a detour ends this near to its target
LONGEST_SLIP: Final = 4  # actions
PROMPT: Final = 0.7  # the share of demonstrators who stop as soon as the task is solved
LATEST: Final = 1.5  # a manoeuvre is given up after this multiple of its actions in the trial

PEOPLE: Final = {
    #               last action, entropy, switches, closed fingers, path, cells
    "MoveToCorner": (52.80, 0.87, 0.22, 0.40, 3.12, 30.40),
    "MoveToRegion": (15.47, 0.45, 0.12, 0.00, 1.22, 13.12),
    "MatchRegions": (88.73, 1.11, 0.26, 0.32, 5.02, 43.07),
    "MakeLine": (159.80, 1.47, 0.32, 0.46, 7.71, 61.67),
    "FindDupe": (43.87, 0.66, 0.16, 0.18, 2.64, 23.20),
    "FixColour": (21.40, 0.52, 0.13, 0.05, 1.60, 16.93),
    "ClusterColour": (203.93, 1.41, 0.30, 0.37, 10.53, 73.00),
    "ClusterShape": (188.40, 1.28, 0.26, 0.31, 9.07, 65.67),
}
"""Means of people's demonstrations in the original, by tools/research/demonstration_statistics.py."""
MATCHED: Final = (*list(STATISTICS)[1:4], *list(STATISTICS)[5:8])


@dataclass(frozen=True)
class Style:
    """How a demonstrator drives.

    Attributes:
        late: probability of repeating the last action where another is due.
        slow: probability of releasing the accelerator for an action.
        slip: probability of pressing a wrong key, in each action.
        hesitation: pauses before a manoeuvre are shorter, in actions.
        detour: probability of a detour before each subgoal.
        half_way: probability of setting a block down half-way.
        push: probability of pushing a block with open fingers instead of gripping it.
        slack: how many actions longer than the best a chosen manoeuvre may be.
    """

    late: float
    slow: float
    slip: float
    hesitation: int
    detour: float
    half_way: float
    push: float
    slack: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Style:
        """A random style. Many demonstrators are careful, few are not."""
        return cls(
            late=0.2 * rng.random(),
            slow=0.06 * rng.random() ** 2,
            slip=0.02 * rng.random() ** 2,
            hesitation=1 + int(rng.integers(3)),
            detour=rng.random(),
            half_way=0.3 * rng.random() ** 2,
            push=rng.random(),
            slack=12 * rng.random(),
        )


class Person(HumanExecution):
    """Also releases the accelerator, and presses wrong keys for some actions, which may release a block."""

    def __init__(self, rng: np.random.Generator, style: Style) -> None:
        super().__init__(rng, style.late, style.hesitation)
        self._draw, self._style = rng, style
        self._wrong: list[Action] = []

    def __call__(self, last: Action | None, wanted: Action) -> Action:
        """The executed action, given the last one and the wanted one."""
        if self._wrong:
            return self._wrong.pop()
        if self._draw.random() < self._style.slip:
            gripper = Gripper.OPEN if self._draw.random() < 0.4 else wanted.gripper
            turn, drive = Turn(int(self._draw.integers(3))), Drive(int(self._draw.integers(3)))
            self._wrong = [Action(gripper, turn, drive)] * int(self._draw.integers(1, LONGEST_SLIP))
            return self._wrong[0]
        if self._draw.random() < self._style.slow:
            return Action(wanted.gripper, wanted.turn, Drive.NONE)
        return super().__call__(last, wanted)


class Option(NamedTuple):
    """A manoeuvre that was tried, its number of actions, and whether it reached its subgoal."""

    manoeuvre: Manoeuvre
    cost: int
    reached: bool


class Demonstrator:
    """A demonstrator in the demo scene of a task, with the style of a seed."""

    def __init__(self, engine: Engine, task: str, seed: int) -> None:
        self._spec, self._steps = task_spec(task), task_spec(task).horizon()
        self._rng = np.random.default_rng([zlib.crc32(task.encode()), seed])
        self._style = Style.drawn(self._rng)
        self._person, self._noise = Person(self._rng, self._style), Noise(self._rng, 1.5)
        self._ahead = Lookahead(engine)
        self._hands = self._ahead.body
        self._prompt = self._rng.random() < PROMPT
        self._actions: list[int] = []

    def play(self) -> list[int]:
        """The actions until the task is solved, or none if it is not solved in time."""
        while self._left > 0 and not self._solved():
            try:
                todo = list(self._spec.subgoals(self._scenes, self._noise))
            except PlacementError:  # blocks were left where nothing has space
                return []
            before = self._left
            for number in self._rng.permutation(len(todo)).tolist():
                if not self._solved():
                    self._reach(todo[number])
            if self._left == before:  # solved, but moving; or nothing was possible
                self._wait(1)
        return self._actions if self._solved() else []

    @property
    def _left(self) -> int:
        return self._steps - len(self._actions)

    @property
    def _scenes(self) -> tuple[Scene, ...]:
        return self._ahead.scenes_to(self._ahead.scene())

    def _solved(self) -> bool:
        """Whether the task is solved, and stays so without further actions."""
        here, score = self._ahead.state, self._spec.checked_score(self._scenes, "paper")
        if score == 1.0:
            for _ in range(8):
                self._ahead.act(Gripper.OPEN)
            score = self._spec.checked_score(self._scenes, "paper")
            self._ahead.restore(here)
        return score == 1.0

    def _keep(self, steps: int | None = None) -> None:
        """Keeps the latest actions, or only this number of them."""
        trace, states = self._ahead.trace[:steps], self._ahead.states[:steps]
        self._actions += trace
        self._ahead.restore(states[-1] if states else self._ahead.state)

    def _steps_to_success(self) -> int | None:
        """How many of the latest actions solve the task, so that it stays solved. None if they do not."""
        ahead, trace, states = self._ahead, self._ahead.trace, self._ahead.states
        end, found = ahead.state, None
        for number, state in enumerate(states, start=1):
            ahead.restore(state)
            if self._spec.checked_score(self._scenes, "paper") == 1.0 and self._solved():
                found = number
                break
        ahead.restore(end)
        ahead.trace, ahead.states = trace, states
        return found

    def _wait(self, steps: int) -> None:
        for _ in range(min(steps, self._left)):
            self._ahead.act(Gripper.OPEN)
        self._keep()

    def _reach(self, subgoal: Subgoal) -> None:
        """Reaches a subgoal, with detours and stops, and corrects up to two misses."""
        if self._rng.random() < self._style.detour:
            self._go(Subgoal(None, self._detour(subgoal), NEAR))
        if subgoal.block is not None and self._rng.random() < self._style.half_way:
            self._go(replace(subgoal, target=self._half_way(subgoal)))
        for _ in range(3):
            if self._left > 0 and subgoal.left(self._ahead.scene()):
                self._go(subgoal)

    def _detour(self, subgoal: Subgoal) -> tuple[float, float]:
        """A point on a random side of the block, or anywhere if the subgoal has none."""
        scene = self._ahead.scene()
        x, y = self._rng.uniform(-HALF, HALF, 2).tolist()
        if subgoal.block is not None:
            block, side = scene.blocks[subgoal.block], self._rng.uniform(0, 2 * math.pi)
            away = self._rng.uniform(*AROUND)
            x, y = block.x + away * math.cos(side), block.y + away * math.sin(side)
        elif self._rng.random() < 0.7:  # not far from the straight line
            share, robot = self._rng.uniform(0.3, 0.8), scene.robot
            x, y = (
                here + share * (there - here) + float(self._rng.normal(0, 0.3))
                for here, there in ((robot.x, subgoal.target[0]), (robot.y, subgoal.target[1]))
            )
        return min(max(x, -HALF), HALF), min(max(y, -HALF), HALF)

    def _half_way(self, subgoal: Subgoal) -> tuple[float, float]:
        block = self._ahead.scene().blocks[subgoal.block or 0]
        share = self._rng.uniform(0.3, 0.8)
        x, y = (
            here + share * (there - here) + float(self._rng.normal(0, 0.1))
            for here, there in ((block.x, subgoal.target[0]), (block.y, subgoal.target[1]))
        )
        return min(max(x, -HALF), HALF), min(max(y, -HALF), HALF)

    def _go(self, subgoal: Subgoal) -> None:
        """Chooses one of the manoeuvres that are not much longer than the best one, and performs it."""
        if self._left <= 0:
            return
        here, hands, options = self._ahead.state, [self._hands], list[Option]()
        if subgoal.block is not None and self._rng.random() < self._style.push:
            hands.insert(0, replace(self._hands, fingers=False))  # the expert pushes blocks with such bodies
        for self._ahead.body in hands:
            options = self._options(here, subgoal)
            if reached := [option for option in options if option.reached]:
                options = reached
                break
        if options:
            least = min(option.cost for option in options)
            good = [option for option in options if option.cost <= least + self._style.slack]
            self._wait(self._person.pause())
            self._ahead.execution = self._person
            option = good[self._rng.integers(len(good))]
            perform(self._ahead, option.manoeuvre, min(self._left, int(LATEST * option.cost) + LONGEST_SLIP))
            self._ahead.execution = None
            self._keep(self._steps_to_success() if self._prompt else None)
        self._ahead.body = self._hands

    def _options(self, here: SavedState, subgoal: Subgoal) -> list[Option]:
        """The most promising manoeuvres."""
        scene = self._ahead.scene()
        costs = cell_costs(obstacles(scene), EMPTY)
        tree = explore(scene.robot.pose, costs, min(self._left, REACH))
        found = manoeuvres(tree, costs, scene, subgoal, self._noise, self._ahead.body)
        found.sort(key=lambda option: option.estimate + self._noise(self._style.slack))
        tried = []
        for manoeuvre in found[:TRIED]:
            perform(self._ahead, manoeuvre, self._left)
            if self._ahead.trace:
                reached = manoeuvre.subgoal.left(self._ahead.scene()) == 0
                tried.append(Option(manoeuvre, len(self._ahead.trace), reached))
            self._ahead.restore(here)
        return tried


def demonstration(task: str, seed: int) -> Demonstration | None:
    """The demonstration of a demonstrator. None if it fails."""
    with closing(Engine(task, "Demo", seed=seed)) as engine:
        actions = Demonstrator(engine, task, seed).play()
    if not actions:
        return None
    demo = replayed(task, "Demo", seed, (actions + [NOOP] * REST)[: task_spec(task).horizon()], "diverse")
    return demo if demo.score == 1.0 else None


class Candidates:
    """Demonstrations of a task, and the statistics of sets of them."""

    def __init__(self, task: str, demos: Sequence[Demonstration]) -> None:
        self.demos, self._wanted = demos, np.array(PEOPLE[task])
        self._plans = [strategy(demo) for demo in demos]
        one_by_one = [[STATISTICS[name]([demo]) for name in MATCHED] for demo in demos]
        self._values = np.array(one_by_one)

    def cost(self, chosen: Sequence[int]) -> float:
        """How much a set differs from people's, less how much its members differ from each other."""
        entropy = STATISTICS[MATCHED[1]]([self.demos[number] for number in chosen])
        means = self._values[list(chosen)].mean(axis=0)
        means[1] = entropy
        plans = [self._plans[number] for number in chosen]
        orders = len({tuple(block for block, _ in plan) for plan in plans}) / len(chosen)
        return float((((means - self._wanted) / (self._wanted + 0.1)) ** 2).sum()) - ALIKE * (
            orders + len(set(plans)) / len(chosen)
        )

    def chosen(self, size: int) -> list[Demonstration]:
        """The best set that exchanging one demonstration after another finds."""
        inside, outside = list(range(size)), list(range(size, len(self.demos)))
        best, improved = self.cost(inside), True
        while improved:
            improved = False
            for place, other in ((place, other) for place in range(size) for other in range(len(outside))):
                inside[place], outside[other] = outside[other], inside[place]
                if (cost := self.cost(inside)) < best - 1e-9:
                    best, improved = cost, True
                else:
                    inside[place], outside[other] = outside[other], inside[place]
        return [self.demos[number] for number in sorted(inside)]


def demonstrations(task: str) -> list[Demonstration]:
    """The 25 demonstrations of a task."""
    found = (demo for seed in count() if (demo := demonstration(task, seed)) is not None)
    return Candidates(task, list(islice(found, CANDIDATES))).chosen(COUNT)


def main() -> None:
    """Makes those of the tasks named."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tasks", default=",".join(TASKS))
    for task in parser.parse_args().tasks.split(","):
        demos = demonstrations(task)
        path = shipped.FILES[2]
        pack_rows(path, [row for row in shipped.stored_rows(path) if row.task != task], demos)
        print(f"{task}: {', '.join(f'{name} {value([*demos]):.2f}' for name, value in STATISTICS.items())}", flush=True)


if __name__ == "__main__":
    main()
