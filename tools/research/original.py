"""The original simulation, rebuilt on its 2-D engine, to find how much of our deviation from it is chance.

    pip install pymunk==5.6.0
    python tools/research/original.py FOLDER

FOLDER holds the recordings, `probes.npz` and `human_replays.npz`. It prints three tables:

- the deviation of the rebuilt simulation from the probes, with its pin joints for the fingers, and with hinges instead;
- the deviation of ours from the rebuilt one in new rollouts;
- the scores of the recorded human actions in both, from the recorded start and from `COPIES` starts that differ from
  it by `NUDGE`.

The dimensions are those of `magical_mj.scene.constants`. One fact was documented nowhere, and was found by comparing
rollouts: a finger is attached by a pin joint of length zero that corrects its whole error within one step. Such a joint
acts only along the line between its two points. Since these coincide, rounding decides the direction of its force.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Final

import numpy as np
import pymunk
from rollouts import Array, Case, Rollouts, demo_scene, distances, final_score, probe_poses, probe_scene, recordings

from magical_mj.actions import ACTIONS, Drive, Gripper, Turn
from magical_mj.assets.block import INERTIA
from magical_mj.assets.contacts import SUBSTEPS, TIMESTEP
from magical_mj.assets.robot import FINGER_INERTIA, SIGN
from magical_mj.scene import Block, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.scene.geometry import block_outline, finger_outlines, mirrored

COPIES: Final = 8
NUDGE: Final = 1e-7
"""The standard deviation of the changes of a start, in world units and radians."""
SAME: Final = 1e-4
"""The largest difference of rollouts that count as equal, in world units."""
UNSEEN: Final = 60
"""The number of new rollouts of each kind."""
TASKS: Final = ("FindDupe", "MatchRegions", "MakeLine")
"""The tasks with scores that depend on chance."""
BLOCK, BODY, FINGER, WALL = 0.5, 0.5, 5.0, 0.8  # friction; a contact has the product of both
ROBOT_GROUP: Final = 1  # shapes of the same group do not collide


class Original:
    """A scene at rest for the rollout of one action sequence.

    Args:
        scene: the start.
        hinged: attach the fingers by hinges instead of pins.
    """

    def __init__(self, scene: Scene, *, hinged: bool = False) -> None:
        self._hinged = hinged
        self._space = pymunk.Space()
        self._space.iterations, self._space.collision_slop = 10, 0.01
        corners = [(-2, -2), (-2, 2), (2, 2), (2, -2), (-2, -2)]
        for start, end in pairwise(corners):
            self._shape(pymunk.Segment(self._space.static_body, start, end, 1.0), WALL)
        self._add_robot(scene.robot)
        self._bodies = [self._robot, *map(self._add_block, scene.blocks)]

    def _shape(self, shape: pymunk.Shape, friction: float, group: int = 0) -> None:
        shape.friction, shape.filter = friction, pymunk.ShapeFilter(group=group)
        self._space.add(shape)

    def _body(self, mass: float, inertia: float, position: tuple[float, float], angle: float) -> pymunk.Body:
        body = pymunk.Body(mass, inertia)
        body.position, body.angle = position, angle
        self._space.add(body)
        return body

    def _servo(self, master: pymunk.Body, body: pymunk.Body, force: float, torque: float, turn: float) -> None:
        """Adds joints with capped force and torque that give `body` the velocity of `master`."""
        slide, gear = pymunk.PivotJoint(master, body, (0, 0), (0, 0)), pymunk.GearJoint(master, body, 0, 1)
        slide.max_bias, slide.max_force = 0, force
        gear.error_bias, gear.max_bias, gear.max_force = 0, turn, torque
        self._space.add(slide, gear)

    def _add_block(self, block: Block) -> pymunk.Body:
        body = self._body(c.BLOCK_MASS, INERTIA[block.shape], (block.x, block.y), block.angle)
        self._servo(self._space.static_body, body, c.BLOCK_FRICTION_FORCE, c.BLOCK_FRICTION_TORQUE, 0)
        outline = block_outline(block.shape).tolist()
        if block.shape == "circle":
            self._shape(pymunk.Circle(body, c.BLOCK_SIZE), BLOCK)
        elif block.shape == "star":
            ends = [
                (-1, 0),
                (0, 1),
                *((tip - 1, tip + 1) for tip in range(2, 10, 2)),
            ]  # the top tip consists of two halves
            for first, last in ends:
                corners = [outline[index] for index in range(first, last + 1)]
                self._shape(pymunk.Poly(body, [*corners, (0, 0)]), BLOCK)
        else:
            self._shape(pymunk.Poly(body, outline, radius=c.SQUARE_MARGIN * (block.shape == "square")), BLOCK)
        return body

    def _add_robot(self, robot: Robot) -> None:
        self._robot = self._body(c.ROBOT_MASS, c.ROBOT_INERTIA, (robot.x, robot.y), robot.angle)
        self._master = pymunk.Body(body_type=pymunk.Body.KINEMATIC)
        self._space.add(self._master)
        self._servo(self._master, self._robot, c.DRIVE_FORCE, c.TURN_TORQUE, c.SPEED_TURN)
        for _ in range(2):  # the pupils, which are attached by weak springs
            pupil = self._body(0.1, 0.002, (robot.x, robot.y), robot.angle)
            spring = pymunk.DampedRotarySpring(self._robot, pupil, 0, 0.1, 0.003)
            spring.max_force = 0.001
            self._space.add(spring)
        self._fingers = [self._add_finger(sign, FINGER_INERTIA[side], robot) for side, sign in SIGN.items()]
        self._shape(pymunk.Circle(self._robot, c.ROBOT_RADIUS), BODY, ROBOT_GROUP)

    def _add_finger(self, sign: int, inertia: float, robot: Robot) -> tuple[pymunk.Body, pymunk.SimpleMotor]:
        root = sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1]
        position, angle = self._robot.local_to_world(root), robot.fingers[sign > 0]
        finger = self._body(c.FINGER_MASS, inertia, position, robot.angle + angle)
        pin = (pymunk.PivotJoint if self._hinged else pymunk.PinJoint)(self._robot, finger, root, (0, 0))
        limit = pymunk.RotaryLimitJoint(self._robot, finger, *sorted((0.0, -sign * c.FINGER_OPEN)))
        pin.error_bias = limit.error_bias = 0
        if not self._hinged:
            pin.distance = 0
        motor = pymunk.SimpleMotor(self._robot, finger, 0)
        motor.max_force = c.FINGER_TORQUE
        self._space.add(pin, limit, motor)
        for outline in finger_outlines():
            corners = (outline if sign > 0 else mirrored(outline)).tolist()
            self._shape(pymunk.Poly(finger, corners), FINGER, ROBOT_GROUP)
        return finger, motor

    def _act(self, number: int) -> None:
        action, robot = ACTIONS[number], self._robot
        speed = {Drive.NONE: 0.0, Drive.FORWARD: c.SPEED_FORWARD, Drive.BACK: -c.SPEED_BACKWARD}[action.drive]
        ahead = {Turn.NONE: 0.0, Turn.LEFT: 1.5, Turn.RIGHT: -1.5}[action.turn]
        for _ in range(SUBSTEPS):
            self._master.velocity = pymunk.Vec2d(0, speed).rotated(robot.angle)
            self._master.angle = robot.angle + ahead
            for sign, (finger, motor) in zip(SIGN.values(), self._fingers, strict=True):
                target = 0.0 if action.gripper is Gripper.CLOSE else -sign * c.FINGER_OPEN
                rate = 10 * (finger.angle - robot.angle - target)
                motor.rate = float(np.clip(rate, -c.SPEED_FINGER, c.SPEED_FINGER)) if abs(rate) > 1e-4 else 0.0
            self._space.step(TIMESTEP)

    def roll(self, actions: Iterable[int]) -> tuple[Array, Array]:
        """Poses (steps + 1, 1 + blocks, 3), the robot first, and finger angles (steps + 1, 2)."""
        states = [self._state()]
        for action in actions:
            self._act(action)
            states.append(self._state())
        poses, fingers = zip(*states, strict=True)
        return np.array(poses), np.array(fingers)

    def _state(self) -> tuple[list[tuple[float, float, float]], list[float]]:
        fingers = [finger.angle - self._robot.angle for finger, _ in self._fingers]
        return [(body.position.x, body.position.y, body.angle) for body in self._bodies], fingers


def nudged(scene: Scene, seed: int) -> Scene:
    """The scene with poses that differ randomly by `NUDGE`. Seed 0 gives the scene itself."""
    size = NUDGE if seed else 0.0
    change = np.random.default_rng(seed).normal(0, size, (1 + len(scene.blocks), 3))
    poses = (np.array([scene.robot.pose, *(block.pose for block in scene.blocks)]) + change).tolist()
    return scene.moved(poses[0], poses[1:])


def gripping(rng: np.random.Generator) -> tuple[Scene, list[int]]:
    """A random scene with a block between the fingers, and actions that grip it and drag it or turn with it."""
    x, ahead, y = rng.uniform(-0.015, 0.015), 0.33 + rng.uniform(-0.015, 0.015), rng.uniform(-0.6, -0.2)
    block = Block(rng.choice(c.SHAPES), "red", x, y + ahead, rng.choice([0.0, rng.uniform(-0.5, 0.5)]))
    pairs = [((10, 11, 2), (6, 8, 3)), ((12, 15, 0), (7, 7, 3)), ((15, 12, 0), (7, 7, 3))]
    actions, lengths = pairs[rng.integers(len(pairs))]
    counts = [4, *(np.array(lengths) + rng.integers(-1, 2, 3)).tolist()]
    return Scene(Robot(0.0, y, 0.0), (block,)), np.repeat([9, *actions], counts).tolist()


def pushing(rng: np.random.Generator) -> tuple[Scene, list[int]]:
    """A random scene with a block ahead of the robot, and actions that push it."""
    pose = rng.uniform(-0.14, 0.14), -0.2 + rng.uniform(-0.02, 0.02), rng.uniform(-0.6, 0.6)
    return Scene(Robot(0.0, -0.7, 0.0), (Block(rng.choice(c.SHAPES), "red", *pose),)), [1] * 12 + [0] * 4


def unseen() -> Iterator[str]:
    """A table of distances from the rebuilt simulation in new rollouts: of itself with nudged starts, and of ours."""
    yield "| Roll-outs | rebuilt, nudged | ours |\n| --- | --- | --- |"
    for draw in (gripping, pushing):
        rng, rows = np.random.default_rng(0), []
        for _ in range(UNSEEN):
            scene, actions = draw(rng)
            truth, _ = Original(scene).roll(actions)
            for world in (Original(nudged(scene, 1)), Rollouts(scene)):
                apart = distances(world.roll(actions)[0], truth)
                rows.append((apart.mean(), apart[-1]))
        means = np.mean(np.reshape(rows, (UNSEEN, 2, 2)), axis=0)
        yield f"| {draw.__name__} ({UNSEEN}) | " + " | ".join(f"{mean:.3f} / {end:.3f}" for mean, end in means) + " |"


def probes(cases: Mapping[str, Case]) -> Iterator[str]:
    """A table of the error of the worst body in each family of probes."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name, case in cases.items():
        pinned, hinged = (
            distances(Original(probe_scene(case), hinged=hinged).roll(case["actions"].tolist())[0], probe_poses(case))
            for hinged in (False, True)
        )
        same = int(np.argmax(pinned > SAME)) if (pinned > SAME).any() else len(pinned)
        row = same, float(pinned.mean()), float(pinned[-1]), float(hinged.mean()), float(hinged[-1])
        rows.setdefault(name.split("/")[0], []).append(row)
    yield f"| Family | actions until {SAME} off | error | with hinges |\n| --- | --- | --- | --- |"
    for family, values in rows.items():
        same, mean, end, hinged_mean, hinged_end = np.mean(values, axis=0)
        errors = f"{mean:.4f} / {end:.4f} | {hinged_mean:.4f} / {hinged_end:.4f}"
        yield f"| {family} ({len(values)}) | {same:.1f} | {errors} |"


def scores(cases: Mapping[str, Case]) -> Iterator[str]:
    """A table of the mean final scores in each task."""
    yield "| Task | recorded | rebuilt | nudged | kept | ours | nudged | kept |\n|" + " --- |" * 8
    for task in TASKS:
        names = [name for name in cases if name.startswith(task + "/")]
        recorded = np.mean([final_score(name, cases[name]["poses"][-1]) for name in names])
        cells = [f"{recorded:.2f}"]
        for world in (Original, Rollouts):
            table = np.array([[_score(world, name, cases[name], seed) for name in names] for seed in range(COPIES + 1)])
            solved = table[1:] == 1
            both = [np.mean(one[other]) for one in solved for other in solved if one is not other and other.any()]
            cells += [f"{table[0].mean():.2f}", f"{table[1:].mean():.2f}", f"{np.mean(both):.2f}"]
        yield f"| {task} ({len(names)}) | " + " | ".join(cells) + " |"


def _score(world: type[Original | Rollouts], name: str, case: Case, seed: int) -> float:
    poses, _ = world(nudged(demo_scene(name.split("/", maxsplit=1)[0]), seed)).roll(case["actions"].tolist())
    return final_score(name, poses[-1])


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="the folder with probes.npz and human_replays.npz")
    folder = parser.parse_args().folder
    for table in (
        probes(recordings(folder / "probes.npz")),
        unseen(),
        scores(recordings(folder / "human_replays.npz")),
    ):
        for line in table:
            print(line, flush=True)
        print()


if __name__ == "__main__":
    main()
