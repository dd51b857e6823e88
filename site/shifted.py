"""The scenes of the page for playing in addition to the 60 environments: with shifts, and with other bodies."""

from __future__ import annotations

from contextlib import closing
from typing import Any, Final

import numpy as np

from magical_mj import demos
from magical_mj.assets.mjcf import numbers, parsed
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.experts import expert_of
from magical_mj.policies.interface import letters_of
from magical_mj.scene import Scene
from magical_mj.scene.bodies import GRIPPER
from magical_mj.shifts import SHIFTS
from magical_mj.shifts.episode import draw_shifts
from magical_mj.shifts.physical import Clutter
from magical_mj.shifts.registry import shift_class
from magical_mj.shifts.shift import HISTORY, Shift
from magical_mj.tasks.registry import Pair, sample_scene, task_spec
from magical_mj.web.page_data import DEMONSTRATIONS, scene_data

SWEPT: Final = "SweepToTop"
SUITE: Final[tuple[Pair, ...]] = tuple((SWEPT, variant) for variant in task_spec(SWEPT).variants)
"""The environments of the page in addition to the 60."""
PLACED: Final = ("pose", "clutter")
"""The shifts that change which objects a scene has, and their poses. The page has scenes with one of them."""
CHANGED: Final = ("latency", "slip", "friction")
"""The shifts that change numbers of the model, or the actions. The page combines them with any scene."""
PHYSICAL: Final = (*PLACED, *CHANGED)
"""The shifts that the page can simulate, because they do not change pictures. They are applied in this order."""
EXCLUSIVE: Final = (PLACED, *(("body", axis) for axis in PHYSICAL if axis != "friction"))
"""The pairs of shifts that the page cannot combine. The effects in `changes` are those on the gripper."""
STRENGTHS: Final = range(1, 6)
SEEDS: Final = range(4)
FEWER_SEEDS: Final = range(2)
"""The seeds with shifts in variants other than Demo."""
DIGITS: Final = 5  # digits of speeds in JSON


def offered(task: str, variant: str) -> dict[str, list[str]]:
    """The shifts that can be applied to an environment: axis -> strengths, or names of bodies."""
    del variant
    bodies = [body for body in task_spec(task).bodies if body != GRIPPER]
    axes = [axis for axis in PHYSICAL if task != SWEPT and SHIFTS[axis].supports(task) is None]
    return {axis: [str(strength) for strength in STRENGTHS] for axis in axes} | ({"body": bodies} if bodies else {})


def changes(task: str, variant: str) -> dict[int, dict[str, Any]]:
    """The effects of the shifts in `CHANGED` on the scenes of an environment.

    Returns:
        Seed -> shift, such as "slip:2" -> its effects: `dynamics`, the changed dynamics of the scene; `attributes`,
        element of the model -> its changed attributes; and `taken`, as in `described`.
    """
    found: dict[int, dict[str, Any]] = {}
    rules, horizon = task_spec(task), task_spec(task).horizon("paper")
    for seed in _seeds(variant):
        scene, found[seed] = sample_scene(task, variant, seed), {}
        before = _attributes(scene)
        for axis in (axis for axis in offered(task, variant) if axis in CHANGED):
            for strength in STRENGTHS:
                shift = shift_class(axis)(draw_shifts({axis: strength}, seed)[axis])
                after, effects = shift.scene(scene, rules), {}
                if after != scene:
                    effects["dynamics"] = _differences(scene_data(scene)["dynamics"], scene_data(after)["dynamics"])
                    effects["attributes"] = {
                        element: changed
                        for element, attributes in _attributes(after).items()
                        if (changed := _differences(before[element], attributes))
                    }
                if type(shift).action is not Shift.action:
                    effects["taken"] = [_taken(shift, step) for step in range(horizon)]
                found[seed][f"{axis}:{strength}"] = effects
    return found


def _seeds(variant: str) -> range:
    return SEEDS if variant == "Demo" else FEWER_SEEDS


def _attributes(scene: Scene) -> dict[str, dict[str, str]]:
    """The attributes of the named elements of a scene's model, with the controls of its actions as exported."""
    rows = controls(scene.robot.body, scene.dynamics.veer)
    found = {f"{one.tag} {one.get('name')}": dict(one.attrib) for one in parsed(scene_mjcf(scene)).iter()}
    return found | {"numeric controls": {"data": " ".join(numbers(*row) for row in rows)}}


def _differences(before: dict[str, Any], after: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in after.items() if before.get(name) != value}


def scenes(task: str, variant: str, shifts: list[str]) -> tuple[dict[str, Any], list[str]]:
    """The page's data of an environment with each of these shifts, and the MJCF model of each scene."""
    entries, models = [], []
    for shift in shifts:
        is_fixed = variant == "Demo" and (not shift or shift.startswith("body:"))
        for seed in _seeds(variant)[: 1 if is_fixed else None]:
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
            taken = [[_taken(shift, step) for step in range(engine.horizon or 0)]]
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
