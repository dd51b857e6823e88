"""The scenes of the page for playing in addition to the 60 environments: with shifts, and with other bodies."""

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
"""The environments of the page in addition to the 60."""
PHYSICAL: Final = ("pose", "clutter", "slip", "friction", "latency")
"""The shifts that the page can simulate, because they do not change pictures."""
STRENGTHS: Final = range(1, 6)
SEEDS: Final = range(4)
DIGITS: Final = 5  # digits of speeds in JSON


def offered(task: str, variant: str) -> dict[str, list[str]]:
    """The shifts that can be applied to an environment, such as "clutter:3", by axis. Bodies are an axis as well."""
    names = [f"body:{body}" for body in task_spec(task).bodies if body != GRIPPER]
    if task == SWEPT:
        return {"body": names}
    if variant != "Demo":
        return {}
    axes = [axis for axis in PHYSICAL if SHIFTS[axis].supports(task) is None]
    found = {axis: [f"{axis}:{strength}" for strength in STRENGTHS] for axis in axes}
    return found | ({"body": names} if names else {})


def all_offered() -> dict[Pair, list[str]]:
    """The shifts of each environment as a list."""
    return {pair: [one for names in offered(*pair).values() for one in names] for pair in (*ENVIRONMENTS, *SUITE)}


def scenes(task: str, variant: str, shifts: list[str]) -> tuple[dict[str, Any], list[str]]:
    """The page's data of an environment with each of these shifts, and the MJCF model of each scene."""
    entries, models = [], []
    for shift in shifts:
        is_fixed = variant == "Demo" and (not shift or shift.startswith("body:"))
        for seed in SEEDS[: 1 if is_fixed else None]:
            with closing(Engine(task, variant, seed=seed, shifts=shift or None)) as engine:
                models.append(mjcf_text(engine, rounded=False))
                entries.append({"seed": seed, "shifts": shift, **described(engine), "expert": _expert(engine, seed)})
    shipped = demos.load(task)[:DEMONSTRATIONS] if variant == "Demo" and task != SWEPT else []
    horizon = task_spec(task).horizon("paper")  # that of the gripper. Each entry has its own
    demonstrations = [letters_of(demo.actions) for demo in shipped]
    return {"horizon": horizon, "demonstrations": demonstrations, "scenes": entries}, models


def described(engine: Engine) -> dict[str, Any]:
    """The page's data of an episode before it starts: its scene with stains, its horizon, and `_taken`."""
    scene, taken = scene_data(engine.initial_scene), None
    for name, values in engine.draws.items():
        shift = shift_class(name)(values)
        if type(shift).action is not Shift.action:
            taken = [_taken(shift, step) for step in range(engine.horizon or 0)]
        if isinstance(shift, Clutter):
            scene["stains"] = np.round(list(shift.stains()), DIGITS).tolist()
    return {"scene": scene, "horizon": engine.horizon} | ({"taken": taken} if taken else {})


def _expert(engine: Engine, seed: int) -> list[list[float]]:
    """The actions of the expert in tasks with speeds. Empty for other tasks."""
    if not engine.setup.speeds:
        return []
    expert, actions, over = expert_of(engine, SWEPT, seed), [], False
    while not over:
        actions.append(expert())
        over = engine.step(actions[-1])
    return np.round(actions, DIGITS).tolist()


def _taken(shift: Shift, step: int) -> int:
    """The action that a shift executes in a step: the delay of its command in steps, or -1 - n for the action n."""
    commands = tuple(range(HISTORY))
    first, second = (shift.action(tuple(one + more for one in commands), step) for more in (0, 1))
    return -1 - first if first == second else HISTORY - 1 - first
