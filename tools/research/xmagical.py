"""Compares the suite xmagical with measurements of the original: free motion, rest, pushes, scores and draws.

    python -m tools.research.xmagical [tests/data/xmagical_probes.json]

It prints the largest deviation of each kind, and its bound. The measurements are numbers that x-magical (c8d812e,
pymunk 5.6.0) returned; the file describes the columns. Since both simulations are chaotic after the first contact,
random sequences are compared until then.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.assets.contacts import TIMESTEP
from magical_mj.engine import Engine
from magical_mj.scene import Scene
from magical_mj.scene.constants import FINGER_OPEN
from magical_mj.xmagical.sweep_to_top import DEMO, dense_reward, original_scene, score, state_vector

PROBES: Final = Path(__file__).parents[2] / "tests" / "data" / "xmagical_probes.json"
ACTIONS: Final[Mapping[str, tuple[float, float, float]]] = {
    "forward_full": (1, 0, 0),
    "forward_0.5": (0.5, 0, 0),
    "forward_0.1": (0.1, 0, 0),
    "back_full": (-1, 0, 0),
    "turn_1.0000": (0, 1, 0),
    "turn_0.0262": (0, math.radians(1.5), 0),
    "fwd_turn_1_1": (1, 1, 0),
    "fwd10_then_zero": (1, 0, 0),
    "turn10_then_zero": (0, 1, 0),
    "close": (0, 0, 1),
    "half": (0, 0, math.pi / 16),
    "open_neg1": (0, 0, -1),
    "close8_open": (0, 0, 1),
}
PARKED: Final = ((-0.95, 0.9, 0.0), (-0.7, 0.9, 0.0), (-0.95, 0.6, 0.0))
"""The poses of the debris during free motion."""
FREE: Final = 10
"""The number of compared steps of free motion."""


class Deviation(NamedTuple):
    """The largest deviation of one kind, in world units and rad, and its bound."""

    kind: str
    body: str
    position: float
    angle: float
    bounds: tuple[float, float]


def start(
    body: str,
    robot: Sequence[float] = DEMO.robot.pose,
    debris: Sequence[Sequence[float]] | None = None,
    fingers: Sequence[float] = (FINGER_OPEN, -FINGER_OPEN),
) -> Engine:
    """An engine with the robot and the debris at these poses."""
    scene = replace(DEMO, robot=replace(DEMO.robot, body=body, fingers=tuple(fingers)))
    return Engine("SweepToTop", scene=scene.moved(robot, debris), body=body)


def poses(scene: Scene) -> NDArray[np.float64]:
    """x, y, angle of the robot and of the debris. Shape (4, 3)."""
    return np.array([scene.robot.pose, *(block.pose for block in scene.blocks)])


def free_motion(probes: Mapping[str, Any], body: str) -> Iterator[Deviation]:
    """The deviations of driving, turning, stopping and fingers in the first steps."""
    name = body.capitalize()
    for kind, action in ACTIONS.items():
        rows = probes["response"][name].get(kind, [])[: FREE + 4 if "zero" in kind else FREE]
        y = 0.3 if kind == "back_full" else -0.6 if kind.startswith(("forward", "fwd10")) else 0.0
        engine, worst = start(body, (0.0, y, 0.0), PARKED), np.zeros(2)
        for step, row in enumerate(rows):
            command = list(action)
            if "zero" in kind and step >= FREE:
                command = [0, 0, 0]
            elif kind == "close8_open" and step >= 8:
                command = [0, 0, -1]
            engine.step(command[: 3 if body == "gripper" else 2])
            if touches(engine):  # the long stick gets stuck between two walls
                break
            robot = engine.scene.robot
            error = np.abs(np.array([*robot.pose, *robot.fingers][: 3 + len(row[6:])]) - [*row[:3], *row[6:]])
            worst = np.maximum(worst, (error[:2].max(), error[2:].max()))
        if rows:
            yield Deviation(kind, body, float(worst[0]), float(worst[1]), (0.003, 0.01))


def turn_rates(probes: Mapping[str, Any], body: str) -> Deviation:
    """The deviation of the steady turn rate (rad/s) over nine commands."""
    worst = 0.0
    for command, rate in probes["turn_rate"][body.capitalize()]:
        engine = start(body, (0.0, 0.0, 0.0), PARKED)
        angles = []
        for _ in range(2 * FREE):
            engine.step([0, command, 0][: 3 if body == "gripper" else 2])
            angles.append(engine.scene.robot.angle)
        worst = max(worst, abs((angles[-1] - angles[FREE - 1]) / FREE * 8 - rate))
    return Deviation("turn_rate (rad/s)", body, 0.0, worst, (0.003, 0.01))


RESTS: Final = {"shortstick": (1.0509, -1.0509), "mediumstick": (1.0509, -1.0509), "longstick": (1.0509, -1.0509)}
"""y at rest against the top and the bottom wall. `resting` has the values of the gripper, which faces the top."""


def resting(body: str) -> Deviation:
    """The deviation of the robot's rest positions at the walls, with the debris at the sides."""
    top, bottom = RESTS.get(body, (0.7552, -0.9050))
    worst = 0.0
    aside = [(x, 0.0, 0.0) for x in (-0.98, 0.0, 0.98)]
    for y, speed, wall in ((0.3, 1.0, top), (-0.3, -1.0, bottom)):
        engine = start(body, (0.0, y, 0.0), aside)
        for _ in range(25):
            engine.step([speed, 0, 0][: 3 if body == "gripper" else 2])
        worst = max(worst, abs(engine.scene.robot.y - wall))
    return Deviation("rest at walls", body, worst, 0.0, (0.01, 0.01))


def pushes(probes: Mapping[str, Any], body: str) -> tuple[Deviation, Deviation]:
    """The deviations of debris and robot in a straight drive in Demo.

    In the original, the robot penetrates the debris for a step.
    """
    engine, debris, robot = start(body), np.zeros(2), np.zeros(2)
    for row in probes["response"][body.capitalize()]["push_demo_forward"]:
        engine.step([1, 0, 0][: 3 if body == "gripper" else 2])
        error = np.abs(poses(engine.scene) - [row["r"], *row["d"]])
        debris = np.maximum(debris, (error[1:, :2].max(), error[1:, 2].max()))
        robot = np.maximum(robot, (error[0, :2].max(), error[0, 2]))
    return (
        Deviation("push: debris", body, float(debris[0]), float(debris[1]), (0.02, 0.06)),
        Deviation("push: robot", body, float(robot[0]), float(robot[1]), (0.02, 0.06)),
    )


def sequences(probes: Mapping[str, Any], body: str) -> Iterator[Deviation]:
    """The deviations in random sequences, every 5 steps until the robot's first contact."""
    for sequence in probes["random_sequences"][body.capitalize()]:
        begin = sequence["start"]
        engine = start(body, begin["robot"], begin["debris"], begin.get("fingers", (FINGER_OPEN, -FINGER_OPEN)))
        rows, worst = {row["t"]: row for row in sequence["every5"]}, np.zeros(2)
        step = 0
        for step, action in enumerate(sequence["actions"], 1):
            engine.step(action)
            if touches(engine):
                break
            if step in rows:
                error = np.abs(np.array(engine.scene.robot.pose) - rows[step]["robot"])
                worst = np.maximum(worst, (error[:2].max(), error[2]))
        yield Deviation(f"{sequence['kind']}, to step {step}", body, float(worst[0]), float(worst[1]), (0.02, 0.06))


def touches(engine: Engine) -> bool:
    """Whether the robot touches debris or a wall."""
    model, data = engine.model, engine.data
    robot = model.body("robot").id
    floor = model.geom("floor").id
    for contact in data.contact[: data.ncon]:
        roots = {int(model.body_rootid[model.geom_bodyid[geom]]) for geom in (contact.geom1, contact.geom2)}
        if robot in roots and floor not in (contact.geom1, contact.geom2):
            return True
    return False


def scores(probes: Mapping[str, Any]) -> tuple[float, float]:
    """The largest deviation of the score and of the dense reward in hand-made cases."""
    scenes = [(DEMO.moved(blocks=case["debris"]), case) for case in probes["score_cases"]]
    return (
        max(abs(score(DEMO, scene) - case["score"]) for scene, case in scenes),
        max(abs(dense_reward(scene) - case["dense"]) for scene, case in scenes),
    )


def drawn(probes: Mapping[str, Any]) -> int:
    """The number of the original's draws that differ from those of `original_scene`."""
    caps = ("robot_pos", "robot_rot", "robot_finger", "shape_trans", "shape_rot")
    wrong = 0
    for variant, rows in probes["reset_draws"].items():
        name = variant.removeprefix("Test").replace("Color", "Colour")
        generators: dict[int, np.random.RandomState] = {}
        for row in rows:
            rng = generators.setdefault(row["seed"], np.random.RandomState(row["seed"]))
            scene = original_scene(name, rng)
            same = [block.shape for block in scene.blocks] == row["shapes"]
            same &= [block.colour for block in scene.blocks] == row["colors"]
            same &= scene.regions[0].colour == row["goal"]
            same &= np.allclose(poses(scene)[1:], row["debris"], atol=6e-6)
            values = row.get("phys", {})
            ours = (scene.dynamics.drive_force, scene.dynamics.turn_torque, scene.dynamics.finger_torque)
            ours = (*ours, scene.dynamics.block_friction_force, scene.dynamics.block_friction_torque)
            theirs = [next(value for key, value in values.items() if key.startswith(cap)) for cap in caps if values]
            same &= not values or np.allclose(ours, theirs, atol=6e-6)
            wrong += not same
    return wrong


def main() -> None:
    """Prints all deviations."""
    probes = json.loads(Path(sys.argv[1] if len(sys.argv) > 1 else PROBES).read_text())
    bodies = [name.lower() for name in probes["response"]]
    found: list[Deviation] = []
    for body in bodies:
        found += [*free_motion(probes, body), turn_rates(probes, body), resting(body), *pushes(probes, body)]
        found += sequences(probes, body)
    for kind, body, position, angle, bounds in found:
        beyond = "" if position <= bounds[0] and angle <= bounds[1] else "  beyond its bound"
        print(f"{body:12} {kind:34} position {position:.4f}  angle {angle:.4f}{beyond}")
    print("score cases: largest deviation of score {:.2g}, of dense reward {:.2g}".format(*scores(probes)))
    print(f"reset draws that differ: {drawn(probes)}")
    for name, static in probes["static"].items():
        ours = state_vector(start(name.lower()).scene)
        print(f"{name:12} state vector at the start: deviation {np.abs(ours - static['state']).max():.2g}")
    print(f"MuJoCo {mujoco.__version__}, {1 / TIMESTEP:g} Hz")


if __name__ == "__main__":
    main()
