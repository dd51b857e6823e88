"""Rollouts of our physics compared with recordings of the original: short probes, and human action sequences."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj import sample_scene, score
from magical_mj.assets.contacts import FOOT_DEPTH, FOOT_RADIUS, SETTINGS, SUBSTEPS, TIMESTEP, PhysicsSettings
from magical_mj.assets.robot import JOINTS, MOTORS, ROTORS, WHEELS, controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.assets.scene_model import SceneModel
from magical_mj.scene import Block, Robot, Scene

Array = NDArray[np.float64]
Case = Mapping[str, NDArray[Any]]
"""One recording: `actions`, and the poses of all bodies at the start and after each action."""

AIMS: Final = {
    "drive": (0.010, 0.015),
    "push": (0.020, 0.030),
    "grip": (0.030, 0.050),
    "spin": (0.050, 0.080),
    "wall": (0.020, 0.030),
}
"""Family of probes -> limits of the mean position error: the mean over a rollout, and the error at its end."""
REPLAY_AIMS: Final = {
    "MoveToRegion": 1.0,
    "MoveToCorner": 0.95,
    "FixColour": 0.95,
    "FindDupe": 0.9,
    "MatchRegions": 0.75,
    "MakeLine": 0.4,
}
"""Task -> the mean score that replayed human actions should reach."""


@functools.cache
def recordings(path: Path) -> dict[str, dict[str, NDArray[Any]]]:
    """The cases of an .npz file with keys `case/field`."""
    cases: dict[str, dict[str, NDArray[Any]]] = {}
    with np.load(path) as file:
        for key in file.files:
            case, name = key.rsplit("/", 1)
            cases.setdefault(case, {})[name] = file[key]
    return cases


class Rollouts:
    """A compiled scene for rollouts of action sequences."""

    def __init__(self, scene: Scene, settings: PhysicsSettings = SETTINGS) -> None:
        self.world = SceneModel(scene)
        self.model = mujoco.MjModel.from_xml_string(scene_mjcf(scene, settings=settings))
        self.data = mujoco.MjData(self.model)
        self._controls = controls(settings=settings)

    def roll(self, actions: Iterable[int]) -> tuple[Array, Array]:
        """Resets to the start of the scene, then calls `go`."""
        mujoco.mj_resetData(self.model, self.data)
        return self.go(actions)

    def place(self, poses: Array, fingers: Array, velocity: Array, finger_velocity: Array, last: int) -> None:
        """Sets the poses and velocities of a recorded moment after the action `last`."""
        mujoco.mj_resetData(self.model, self.data)
        data, signal = self.data, self._controls[last]
        planar = self.world.poses(np.arange(self.model.nq))
        joint = {name: self.model.joint(name).qposadr[0] for name in JOINTS}
        tips = [joint["left_finger"], joint["right_finger"]]
        data.qpos[planar], data.qvel[planar] = poses, velocity
        data.qpos[tips], data.qvel[tips] = fingers, finger_velocity
        data.act[:] = signal
        rolling = FOOT_RADIUS - FOOT_DEPTH / 2
        for name, speed in zip((*WHEELS, *ROTORS, *MOTORS.values()), signal, strict=True):
            data.qvel[joint[name]] = speed / rolling if name in WHEELS else -speed if name in ROTORS else speed
        data.qpos[joint["castor"]] = -velocity[0, 2] * TIMESTEP

    def go(self, actions: Iterable[int]) -> tuple[Array, Array]:
        """Takes actions from the current state.

        Returns:
            The poses, shape (steps + 1, 1 + blocks, 3) with the robot first, and the finger angles, (steps + 1, 2).
        """
        states = [self.data.qpos.copy()]
        for action in actions:
            self.act(action)
            states.append(self.data.qpos.copy())
        return np.array([self.world.poses(s) for s in states]), np.array([self.world.fingers(s) for s in states])

    def act(self, action: int) -> None:
        """Takes one action."""
        self.data.ctrl[:] = self._controls[action]
        mujoco.mj_step(self.model, self.data, SUBSTEPS)


def probe_scene(case: Case) -> Scene:
    """The initial scene of a probe."""
    shapes, starts = case.get("shapes", ()), case["blocks"][0].tolist() if "blocks" in case else ()
    blocks = tuple(Block(str(shape), "red", *pose) for shape, pose in zip(shapes, starts, strict=True))  # type: ignore[arg-type]
    return Scene(Robot(*case["robot"][0].tolist()), blocks)


def probe_poses(case: Case) -> Array:
    """The recorded poses of a probe. Shape (steps + 1, 1 + blocks, 3)."""
    return np.concatenate([case["robot"][:, None], *([case["blocks"]] if "blocks" in case else [])], axis=1)


def distances(one: Array, other: Array) -> Array:
    """The distance of the worst body at each step of two rollouts. Shape (steps + 1,)."""
    apart = one - other
    return np.hypot(apart[..., 0], apart[..., 1]).max(axis=1)


def probe_errors(case: Case, settings: PhysicsSettings = SETTINGS) -> tuple[float, float, float]:
    """The mean distance of the worst body, its distance at the end, and the mean angle error of the worst body."""
    track, _ = Rollouts(probe_scene(case), settings).roll(case["actions"].tolist())
    recorded = probe_poses(case)
    distance = distances(track, recorded)
    turn = np.abs(((track - recorded)[..., 2] + np.pi) % (2 * np.pi) - np.pi).max(axis=1)
    return float(distance.mean()), float(distance[-1]), float(turn.mean())


def family_errors(cases: Mapping[str, Case], settings: PhysicsSettings = SETTINGS) -> dict[str, tuple[float, ...]]:
    """The mean of `probe_errors` over each family."""
    rows: dict[str, list[tuple[float, ...]]] = {}
    for name, case in cases.items():
        rows.setdefault(name.split("/")[0], []).append(probe_errors(case, settings))
    return {family: tuple(np.mean(errors, axis=0).tolist()) for family, errors in rows.items()}


@functools.cache
def demo_scene(task: str) -> Scene:
    """The initial scene of the human action sequences."""
    return sample_scene(task, "Demo", seed=0)


def replays(cases: Mapping[str, Case], settings: PhysicsSettings, steps: int | None = None) -> dict[str, Array]:
    """The poses during the first `steps` actions of human sequences, for the tasks of `REPLAY_AIMS`."""
    by_task: dict[str, Rollouts] = {}
    tracks = {}
    for name, case in cases.items():
        task = name.split("/")[0]
        if task in REPLAY_AIMS:
            if task not in by_task:
                by_task[task] = Rollouts(demo_scene(task), settings)
            tracks[name] = by_task[task].roll(case["actions"][:steps].tolist())[0]
    return tracks


def final_score(name: str, poses: Array) -> float:
    """The score of a replay that ends at `poses`."""
    task = name.split("/", maxsplit=1)[0]
    start = demo_scene(task)
    robot, *blocks = poses.tolist()
    return score(task, start, start.moved(robot, blocks))


def task_means(rows: Mapping[str, float | Sequence[float]]) -> dict[str, Any]:
    """The mean over the replays of each task."""
    grouped: dict[str, list[Any]] = {}
    for name, row in rows.items():
        grouped.setdefault(name.split("/")[0], []).append(row)
    return {task: np.mean(values, axis=0) for task, values in grouped.items()}


def chosen(cases: Mapping[str, Case], keep: Callable[[str], bool]) -> dict[str, Case]:
    """The cases with names that `keep` accepts."""
    return {name: case for name, case in cases.items() if keep(name)}
