"""The scenes on which the page to play has more than the 60 environments: shifted ones, and other bodies' tasks."""

from __future__ import annotations

from contextlib import closing
from typing import Any, Final

import numpy as np

from magical_mj import demos
from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.policies.expert import expert_of
from magical_mj.policies.interface import letters_of
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.physical import Clutter
from magical_mj.shifts.registry import shift_class
from magical_mj.shifts.shift import HISTORY, Shift
from magical_mj.tasks.registry import ENVIRONMENTS, Pair, task_spec
from magical_mj.variants import variants_of
from magical_mj.web.page_data import DEMONSTRATIONS, scene_data

SWEPT: Final = "SweepToTop"
SUITE: Final[tuple[Pair, ...]] = tuple((SWEPT, variant) for variant in variants_of(task_spec(SWEPT)))
"""What the page plays besides the 60 environments."""
PHYSICAL: Final = ("pose", "clutter", "slip", "friction", "latency")
"""The shifts that change what happens, and so can be played without the renderer."""
STRENGTHS: Final = range(1, 6)
SEEDS: Final = range(4)
DIGITS: Final = 5  # of speeds, which JSON has


def offered(task: str, variant: str) -> dict[str, list[str]]:
    """The shifts with which an environment can be played, such as "clutter:3", by their axes: bodies are one, too."""
    names = [f"body:{body}" for body in task_spec(task).bodies if body != GRIPPER]
    if task == SWEPT:
        return {"body": names}
    if variant != "Demo":
        return {}
    axes = [axis for axis in PHYSICAL if SHIFTS[axis].supports(task) is None]
    found = {axis: [f"{axis}:{strength}" for strength in STRENGTHS] for axis in axes}
    return found | ({"body": names} if names else {})


def all_offered() -> dict[Pair, list[str]]:
    """The same of every environment, in one list each."""
    return {pair: [one for names in offered(*pair).values() for one in names] for pair in (*ENVIRONMENTS, *SUITE)}


def scenes(task: str, variant: str, shifts: list[str]) -> tuple[dict[str, Any], list[str]]:
    """The page's data of an environment with each of some shifts, and the model of each scene, as MJCF."""
    entries, models = [], []
    for shift in shifts:
        is_fixed = variant == "Demo" and (not shift or shift.startswith("body:"))
        for seed in SEEDS[: 1 if is_fixed else None]:
            with closing(Engine(task, variant, seed=seed, shifts=shift or None)) as engine:
                models.append(mjcf_text(engine, rounded=False))
                entries.append({"seed": seed, "shifts": shift, **described(engine), "expert": _expert(engine, seed)})
    shipped = demos.load(task)[:DEMONSTRATIONS] if variant == "Demo" and task != SWEPT else []
    horizon = task_spec(task).horizon("paper")  # of the gripper; entries say their own
    demonstrations = [letters_of(demo.actions) for demo in shipped]
    return {"horizon": horizon, "demonstrations": demonstrations, "scenes": entries}, models


def described(engine: Engine) -> dict[str, Any]:
    """What the page is told of an episode that has not begun: its scene with stains, its horizon, and `_taken`."""
    scene, taken = scene_data(engine.initial_scene), None
    for name, values in engine.draws.items():
        shift = shift_class(name)(values)
        if type(shift).action is not Shift.action:
            taken = [_taken(shift, step) for step in range(engine.horizon or 0)]
        if isinstance(shift, Clutter):
            scene["stains"] = np.round(list(shift.stains()), DIGITS).tolist()
    return {"scene": scene, "horizon": engine.horizon} | ({"taken": taken} if taken else {})


def _expert(engine: Engine, seed: int) -> list[list[float]]:
    """What the expert of speeds does; of shifts, experts do not know."""
    if not engine.setup.speeds:
        return []
    expert, actions, over = expert_of(engine, SWEPT, seed), [], False
    while not over:
        actions.append(expert())
        over = engine.step(actions[-1])
    return np.round(actions, DIGITS).tolist()


def _taken(shift: Shift, step: int) -> int:
    """What is done in a step: the command of so many steps before, or, as -1 less its number, always one action."""
    commands = tuple(range(HISTORY))
    first, second = (shift.action(tuple(one + more for one in commands), step) for more in (0, 1))
    return -1 - first if first == second else HISTORY - 1 - first
