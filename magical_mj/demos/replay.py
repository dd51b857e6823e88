"""Replaying demonstrations: playing the actions again, or drawing the recorded states."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import Recorder
from magical_mj.engine import Engine
from magical_mj.policies.interface import play
from magical_mj.tasks.registry import sample_scene

Picture = NDArray[np.uint8]

GLANCE: Final = 10  # steps between the pictures that are compared
SIZE: Final = 96  # pixels
ROUNDING: Final = 1e-9


class Verdict(NamedTuple):
    """The result of checking a demonstration."""

    scene: bool
    """The scene is still that of its seed, and the recorded states begin in it."""
    score: bool
    """The last state has the recorded score."""
    replay: bool
    """The same actions lead to the same score, and all of them are within the episode."""
    exact: bool
    """The same actions lead to exactly the same states: so with the machine and versions of the recording."""
    pictures: bool
    """The pictures of the replay equal those of the recorded states, pixel by pixel."""

    @property
    def good(self) -> bool:
        """Whether the demonstration is what it says it is."""
        return self.scene and self.score and self.replay


def verify(demo: Demonstration) -> Verdict:
    """Checks a demonstration with this version of the package and of MuJoCo."""
    drawn = [pictures["allo"] for pictures in itertools.islice(see(demo), 0, None, GLANCE)]
    with _engine(demo) as env:
        recorder, seen = Recorder(env), [env.render("allo", SIZE)]
        for step, _ in enumerate(play(recorder, demo.actions.tolist()), start=1):
            if step % GLANCE == 0:
                seen.append(env.render("allo", SIZE))
        positions, velocities = recorder.states()
        score = env.score()
    same_scene = sample_scene(demo.task, demo.variant, demo.scene_seed) == demo.scene and all(
        np.allclose(states[0], recorded[0], rtol=0, atol=ROUNDING)
        for states, recorded in ((positions, demo.qpos), (velocities, demo.qvel))
    )
    same_score = score == demo.score and len(positions) == len(demo.qpos)
    same_states = np.array_equal(positions, demo.qpos) and np.array_equal(velocities, demo.qvel)
    same_pictures = np.array_equal(seen, drawn)
    return Verdict(same_scene, demo.rescored() == demo.score, same_score, same_states, same_pictures)


def see(demo: Demonstration, views: Sequence[str] = ("allo",), size: int = SIZE) -> Iterator[dict[str, Picture]]:
    """The pictures before the first action and after each action, drawn from the recorded states.

    Args:
        demo: the demonstration.
        views: any of "ego" and "allo".
        size: side of the pictures in pixels.

    Yields:
        View -> picture, shape (size, size, 3).
    """
    with _engine(demo) as env:
        for positions in demo.qpos:
            place(env, positions)
            yield {view: env.render(view, size) for view in views}


def place(engine: Engine, positions: NDArray[np.float64]) -> None:
    """Sets all positions; pictures depend on nothing else."""
    engine.data.qpos[:] = positions
    mujoco.mj_kinematics(engine.model, engine.data)
    mujoco.mj_camlight(engine.model, engine.data)


@contextmanager
def _engine(demo: Demonstration) -> Iterator[Engine]:
    """The engine of a demonstration, at its start."""
    with closing(Engine(demo.task, demo.variant, scene=demo.scene)) as engine:
        yield engine
