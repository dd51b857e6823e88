"""Intents as tasks: the `TaskSpec` of an intent, and the names ``"intent:TEXT"``.

A text may end with settings of its demo scenes in square brackets: ``"in(colour=red, region) [demos=4, contrasting]"``.
"""

from __future__ import annotations

import hashlib
import itertools
import math
import zlib
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Final

import msgspec
import numpy as np

from magical_mj.intents.contrast import contrasting_scenes, diagnosis, random_scene
from magical_mj.intents.distances import remaining
from magical_mj.intents.draws import Draws, known, remember
from magical_mj.intents.intent import Intent, parse
from magical_mj.intents.plans import cost, plan
from magical_mj.intents.readings import others_moved
from magical_mj.intents.scenes import (
    ALL_RULES,
    INNER_MARGIN,
    accepts,
    colours_rule,
    count_rule,
    demo_scene,
    drawn_scene,
    missing,
    redrawn,
    shapes_rule,
    size_of,
)
from magical_mj.scene import Scene
from magical_mj.tasks.spec import Rules, TaskSpec
from magical_mj.utils.errors import IntentError, InvalidSceneError, short_repr

PREFIX: Final = "intent:"
"""The names of intents' tasks begin with this."""
MOST_DEMOS: Final = 8
LEAST_STEPS: Final = 40
STEPS_PER_COST: Final = 2.5
STARTS: Final = 10
"""The numbers of layouts and of other scenes that determine the horizon, together with the demo scene."""
ROUNDED: Final = 10
FIRST, RANDOM, CONTRASTING = range(3)
"""The kinds of draws of demo scenes: the first one, and further ones."""
MOST_SEED: Final = 2**63 - 1
"""The largest seed of demo scenes: that of episodes in files."""


@dataclass(frozen=True)
class Task:
    """An intent with settings of its demo scenes: `seed` draws them, `demos` is their number."""

    intent: Intent
    seed: int = 0
    demos: int = 1
    contrasting: bool = False

    def __str__(self) -> str:
        """The canonical text. It omits settings with their default values."""
        settings = [f"seed={self.seed}"] * (self.seed != 0) + [f"demos={self.demos}"] * (self.demos != 1)
        settings += ["contrasting"] * self.contrasting
        return f"{self.intent} [{', '.join(settings)}]" if settings else str(self.intent)

    @property
    def name(self) -> str:
        """A name of letters and digits, as files and ids need. It does not depend on the number of demo scenes."""
        text = str(Task(self.intent, self.seed))
        return f"Intent{hashlib.sha256(text.encode()).hexdigest()[:10]}"


def task_of(text: str) -> Task:
    """The task that a text describes. Raises an `IntentError` if the text is invalid."""
    goal, settings = split_settings(text)
    return with_settings(Task(parse(goal)), settings)


def split_settings(text: str) -> tuple[str, str]:
    """A text without its settings, and the settings in square brackets at its end; "" if it has none.

    Texts come from files, so this takes linear time, unlike a regular expression.
    """
    text = text.strip()
    start = text.rfind("[") if text.endswith("]") else len(text)
    return text[:start].rstrip(), text[start:]


def with_settings(task: Task, settings: str) -> Task:
    """The task with settings such as "[seed=1, demos=4, contrasting]". Raises an `IntentError` if they are invalid."""
    counts = [str(number) for number in range(1, MOST_DEMOS + 1)]
    changes: dict[str, Any] = {}
    for part in filter(None, map(str.strip, settings.strip("[]").split(","))):
        name, _, value = (word.strip() for word in part.partition("="))
        if part == "contrasting":
            changes[part] = True
        elif (name == "seed" and _is_seed(value)) or (name == "demos" and value in counts):
            changes[name] = int(value)
        else:
            raise IntentError(
                f"{short_repr(part)} in square brackets should be seed=N from 0 to {MOST_SEED}, demos=N from 1 to "
                f"{MOST_DEMOS}, or contrasting"
            )
    changed = replace(task, **changes)
    if changed.contrasting and changed.demos == 1:
        raise IntentError(f"contrasting is for several demo scenes: give demos=2 to {MOST_DEMOS}, or leave it out")
    return changed


def _is_seed(text: str) -> bool:
    return text.isdecimal() and len(text) <= len(str(MOST_SEED)) and int(text) <= MOST_SEED


def spec_of(task: Task, draws: Draws | None = None) -> TaskSpec:
    """The definition of a task, by default with `draws_of`. Raises an `IntentError` if no scene was found for it."""
    intent, sentence = task.intent, task.intent.sentence
    draws = draws_of(task) if draws is None else draws
    demo = _first(task, draws)
    return TaskSpec(
        name=task.name,
        summary=f"{sentence[0].lower()}{sentence[1:-1]}",  # in the form of other tasks' summaries
        wordings=intent.wordings,
        label=f"{PREFIX}{task}",
        demo=demo,
        further_demos=tuple(Scene.from_json(bytes(scene)) for scene in _further(task, draws)),
        steps=draws.steps,
        score=partial(_score, intent),
        distance=partial(_distance, intent),
        side_effects=partial(_side_effects, intent),
        check=partial(_check, intent),
        accepts=partial(accepts, intent),
        plan=partial(plan, intent),
        colour=partial(colours_rule, intent),
        shape=partial(shapes_rule, intent),
        count=partial(count_rule, intent),
        diagnose=partial(diagnosis, intent),
        region_size=size_of(len(demo.regions)),
        inner_margin=INNER_MARGIN if demo.regions else 0.0,
    )


def draws_of(task: Task) -> Draws:
    """The draws of a task: stored ones, as far as there are any. Others are found and stored.

    Raises:
        IntentError: if no scene was found for the intent.
    """
    draws = known(str(Task(task.intent, task.seed)), partial(_complete, task))
    if draws is None:
        remember(draws := found_draws(task.intent, task.seed))
    if not _complete(task, draws):
        remember(draws := with_further(task, draws))
    return draws


def _complete(task: Task, draws: Draws) -> bool:
    """Whether the draws have all demo scenes."""
    return len(_further(task, draws)) == task.demos - 1


def with_further(task: Task, draws: Draws) -> Draws:
    """The draws with the demo scenes after the first one."""
    intent, first, number = task.intent, _first(task, draws), task.demos - 1
    if task.contrasting:
        rng_of = partial(_rng, intent, task.seed, CONTRASTING)
        found = contrasting_scenes(intent, rng_of, first, number, draws.left_out)
    else:
        found = [_random_demo(task, first, each, draws.left_out) for each in range(number)]
    demos = tuple(msgspec.Raw(scene.to_json()) for scene in found)
    return msgspec.structs.replace(draws, **{"contrasting_demos" if task.contrasting else "random_demos": demos})


def _random_demo(task: Task, first: Scene, number: int, left_out: Container[str]) -> Scene:
    """A random demo scene after the first one, which is none of those left out."""
    scenes = (
        random_scene(task.intent, _rng(task.intent, task.seed, RANDOM, each), first)
        for each in itertools.count(number, MOST_DEMOS)
    )
    return next(scene for scene in scenes if scene.digest() not in left_out)


def _first(task: Task, draws: Draws) -> Scene:
    """The first demo scene."""
    demo = drawn_scene(task.intent, _rng(task.intent, task.seed, FIRST, draws.first))
    if demo is None:
        raise IntentError(f"the stored draw {draws.first} of {draws.task} is wrong: empty the cache folder")
    return demo


def _further(task: Task, draws: Draws) -> Sequence[msgspec.Raw]:
    """The other demo scenes, as far as known."""
    return (draws.contrasting_demos if task.contrasting else draws.random_demos)[: task.demos - 1]


def found_draws(intent: Intent, seed: int) -> Draws:
    """The draw of the first demo scene, and the horizon.

    The horizon is `STEPS_PER_COST` times the largest cost of a plan, in the demo scene and in scenes like Layout's and
    All's.
    """
    first, demo = demo_scene(intent, partial(_rng, intent, seed, FIRST))
    rng = np.random.Generator(np.random.PCG64(0))
    starts = [demo]
    for _ in range(STARTS):
        starts += [redrawn(intent, rng, demo), redrawn(intent, rng, demo, *ALL_RULES)]
    most = max(cost(intent, scene) for scene in starts)
    steps = max(LEAST_STEPS, ROUNDED * math.ceil(STEPS_PER_COST * most / ROUNDED))
    return Draws(str(Task(intent, seed)), steps, first)


def first_demo(intent: Intent, seed: int) -> int:
    """The draw of the first demo scene. Raises an `IntentError` if none is good."""
    return demo_scene(intent, partial(_rng, intent, seed, FIRST))[0]


def _rng(intent: Intent, seed: int, *numbers: int) -> np.random.Generator:
    """The random generator of one draw."""
    return np.random.Generator(np.random.PCG64([zlib.crc32(str(intent).encode()), seed, *numbers]))


def _score(intent: Intent, initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    del rules  # all have the same score
    return intent.score(initial, final)


def _distance(intent: Intent, initial: Scene, final: Scene, rules: Rules = "paper") -> float:
    del rules
    return remaining(intent, initial, final)


def _side_effects(intent: Intent, initial: Scene, final: Scene) -> int:
    return len(others_moved(intent, initial, final))


def _check(intent: Intent, scene: Scene) -> None:
    if why := missing(intent, scene):
        raise InvalidSceneError(f"this is not a scene of the intent {intent}: {why}")
