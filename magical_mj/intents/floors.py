"""Shortcuts: policies that know the relations of an intent, but choose the blocks by a rule that is not the intent's.

They are privileged: they read the intent, its demonstrations and the simulation. A test set is only valid if they fail
on it. If a policy is not better than they are, it need not have understood which blocks are meant.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from magical_mj.intents.intent import Intent
from magical_mj.intents.names import has_intent, task_intent
from magical_mj.intents.plans import plan, planned
from magical_mj.intents.readings import moved_blocks
from magical_mj.intents.relations import Conjunct
from magical_mj.intents.scenes import keeps
from magical_mj.scene import Scene
from magical_mj.tasks.planning import REACHABLE, Noise, Point, Subgoal, scene_after
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import SettingsError

if TYPE_CHECKING:
    from magical_mj.policies.interface import Episode

CIRCLE: Final = 4
"""The action that drives forward and turns left."""
BUDGET: Final = 16
"""Simulated steps of planning per step of an episode. After them, no new plan is started."""
CANDIDATES: Final = 4
"""The number of manoeuvres that are tried in one situation."""


@dataclass(frozen=True)
class Misread(Intent):
    """The relations of an intent about other blocks than those that it selects.

    Attributes:
        chosen: for each conjunct the blocks.
    """

    chosen: tuple[tuple[int, ...], ...] = ()

    def parts(self, initial: Scene, final: Scene) -> list[list[bool]]:
        """For each conjunct, whether it holds for each of the chosen blocks."""
        pairs = zip(self.conjuncts, self.chosen, strict=True)
        return [conjunct.parts(blocks, initial, final) for conjunct, blocks in pairs]

    def blocks(self, initial: Scene) -> list[tuple[int, ...]]:
        """For each conjunct, the chosen blocks."""
        del initial
        return list(self.chosen)


@dataclass(frozen=True)
class Shown:
    """What one demonstration of an intent shows: a demo scene, the end of a plan, and which blocks each relation moves.

    Attributes:
        moved: for each conjunct that asks for a change, the moved blocks.
    """

    initial: Scene
    final: Scene
    conjuncts: tuple[Conjunct, ...]
    moved: tuple[tuple[int, ...], ...]


@lru_cache(maxsize=256)
def shown(intent: Intent, demo: Scene) -> Shown:
    """What a demonstration in a demo scene shows."""
    initial, final = planned(intent, demo)
    moved = moved_blocks(initial, final)
    every = zip(intent.conjuncts, intent.blocks(demo), intent.parts(demo, demo), strict=True)
    kept = [
        (conjunct, tuple(index for index in blocks if index in moved))
        for conjunct, blocks, before in every
        if not (keeps(conjunct) and all(before))
    ]
    asking = [(conjunct, blocks) for conjunct, blocks in kept if blocks or not conjunct.definition.of_blocks]
    return Shown(initial, final, tuple(one for one, _ in asking), tuple(blocks for _, blocks in asking))


Rule = Callable[[Shown, Scene], Sequence[tuple[int, ...]]]
"""(a demonstration, an initial scene) -> for each conjunct of the demonstration the blocks."""


def _all(demonstration: Shown, initial: Scene) -> Sequence[tuple[int, ...]]:
    return [tuple(range(len(initial.blocks)))] * len(demonstration.moved)


def _nearest(demonstration: Shown, initial: Scene) -> Sequence[tuple[int, ...]]:
    """As many as demonstrated, those nearest to the robot: first those of the first relation."""
    order = iter(_by_distance(initial, (initial.robot.x, initial.robot.y)))
    return [tuple(index for index, _ in zip(order, moved, strict=False)) for moved in demonstration.moved]


def _same_places(demonstration: Shown, initial: Scene) -> Sequence[tuple[int, ...]]:
    """Those nearest to where a demonstrated block started."""
    starts = [[demonstration.initial.blocks[index].pose[:2] for index in moved] for moved in demonstration.moved]
    return [tuple({_by_distance(initial, place)[0] for place in places}) for places in starts]


def _alike(attribute: str, demonstration: Shown, initial: Scene) -> Sequence[tuple[int, ...]]:
    """Those with the colour, or the shape, of a demonstrated block."""
    models = [{getattr(demonstration.initial.blocks[index], attribute) for index in m} for m in demonstration.moved]
    blocks = list(enumerate(initial.blocks))
    return [tuple(index for index, block in blocks if getattr(block, attribute) in values) for values in models]


def _by_distance(scene: Scene, place: Point) -> list[int]:
    return sorted(range(len(scene.blocks)), key=lambda index: math.dist(scene.blocks[index].pose[:2], place))


def _misread(rule: Rule, demonstration: Shown, initial: Scene) -> Misread:
    """The demonstrated relations about the blocks of a rule; of all relations that can have them."""
    chosen = []
    for conjunct, blocks in zip(demonstration.conjuncts, rule(demonstration, initial), strict=True):
        if conjunct.relation == "exactly" and len(blocks) != conjunct.number:
            conjunct = Conjunct("in", argument="region")
        if conjunct.definition.of_blocks:
            blocks = tuple(conjunct.judged(blocks, initial))
            if len(blocks) < max(conjunct.definition.least, 1):
                continue
        chosen.append((replace(conjunct, any_of=False), blocks))
    return Misread(tuple(one for one, _ in chosen), tuple(blocks for _, blocks in chosen))


def _of_rule(rule: Rule, intent: Intent, demo: Scene, initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    return plan(_misread(rule, shown(intent, demo), initial), initial, now, noise)


def _same_ends(intent: Intent, demo: Scene, initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Fills the places where demonstrated blocks ended with the nearest blocks."""
    del noise
    demonstration, free = shown(intent, demo), set(range(len(initial.blocks)))
    todo = []
    for index in sorted({index for moved in demonstration.moved for index in moved}):
        place = demonstration.final.blocks[index].pose[:2]
        nearest = next((other for other in _by_distance(initial, place) if other in free), None)
        if nearest is not None:
            free.discard(nearest)
            todo.append(Subgoal(nearest, place, 0.07))
    robots = [one for one in demonstration.conjuncts if not one.definition.of_blocks]
    left = [one for one in todo if one.left(now)]
    return left or ([Subgoal(None, demonstration.final.robot.pose[:2], 0.04)] if robots else [])


def _random_places(intent: Intent, demo: Scene, initial: Scene, now: Scene, noise: Noise) -> list[Subgoal]:
    """Brings the blocks that the intent wants to move to random places."""
    del demo, noise
    _, final = planned(intent, initial)
    rng = np.random.default_rng(zlib.crc32(repr(initial.blocks).encode()))
    places = {index: tuple(rng.uniform(-REACHABLE, REACHABLE, 2).tolist()) for index in moved_blocks(initial, final)}
    todo = [Subgoal(index, place, 0.07) for index, place in places.items()]
    robots = [one for one in intent.conjuncts if not one.definition.of_blocks]
    drive = [Subgoal(None, tuple(rng.uniform(-0.7, 0.7, 2).tolist()), 0.04)] if robots else []
    return [one for one in todo if one.left(now)] or drive


Todo = Callable[[Intent, Scene, Scene, Scene, Noise], list[Subgoal]]
"""(intent, demo scene, initial scene, current scene, noise) -> the remaining subgoals."""


class Shortcut:
    """A policy that plans in a copy of the simulation, towards the subgoals of a rule."""

    uses_simulation = True

    def __init__(self, name: str, todo: Todo) -> None:
        self.__name__ = f"shortcut {name}"  # its name in results
        self.todo = todo

    def end(self, intent: Intent, demo: Scene, initial: Scene) -> Scene:
        """The scene after its subgoals, without simulation."""
        noise = Noise(np.random.Generator(np.random.PCG64(0)), 0.0)
        after = scene_after(initial, self.todo(intent, demo, initial, initial, noise))
        return scene_after(after, self.todo(intent, demo, initial, after, noise))

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        from magical_mj.experts.driving import Lookahead  # imported late: they load the simulator
        from magical_mj.experts.planner import PlanFollower, Planner

        env = episode.env
        if env is None or env.horizon is None or env.task is None or not has_intent(env.task):
            raise SettingsError(
                "shortcuts need the simulation of an intent, or of a task that has one, and cannot play in vector "
                "environments"
            )
        intent, initial = task_intent(env.task), env.initial_scene
        todo = partial(self.todo, intent, task_spec(env.task).demo, initial)
        planner = partial(
            Planner,
            lambda scene: 0.0 if todo(scene, Noise(np.random.default_rng(0), 0.0)) else 1.0,
            lambda scene, noise, _: tuple(todo(scene, noise)),
            Lookahead(env),
            tries=CANDIDATES,
            steady=True,
        )
        self._next = PlanFollower(env, env.horizon, planner, episode.rng, BUDGET)

    def __call__(self, _: Any) -> int:
        """The next action. It ignores observations."""
        return self._next()


class Circling:
    """Drives in a circle: always the same action."""

    uses_observations = False

    def __init__(self) -> None:
        self.__name__ = "shortcut circling"

    def end(self, intent: Intent, demo: Scene, initial: Scene) -> Scene:
        """The initial scene: without simulation, the robot touches no block."""
        del intent, demo
        return initial

    def __call__(self, _: Any) -> int:
        """The action."""
        return CIRCLE


RULES: Final[Mapping[str, Rule]] = MappingProxyType(
    {
        "demonstrated colours": partial(_alike, "colour"),
        "demonstrated shapes": partial(_alike, "shape"),
        "demonstrated places": _same_places,
        "nearest blocks": _nearest,
        "all blocks": _all,
    }
)
"""Name of a shortcut -> the blocks that it chooses."""
shortcuts: Final[Mapping[str, Shortcut | Circling]] = MappingProxyType(
    {name: Shortcut(name, partial(_of_rule, rule)) for name, rule in RULES.items()}
    | {"demonstrated ends": Shortcut("demonstrated ends", _same_ends)}
    | {"random places": Shortcut("random places", _random_places)}
    | {"circling": Circling()}
)
"""Name -> a policy for `magical_mj.evaluate`."""
