"""Demonstrations come back to life: acted again, or drawn from their states."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Final, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import Recorder
from magical_mj.environment import Environment, load
from magical_mj.episodes import play
from magical_mj.registry import sample_scene

Picture = NDArray[np.uint8]

GLANCE: Final = 10  # steps from one picture that is compared to the next
SIZE: Final = 96  # pixels


class Verdict(NamedTuple):
    """What became of a demonstration when it was checked."""

    scene: bool
    """The scene is still that of its seed."""
    score: bool
    """The last state has the score that was written down."""
    replay: bool
    """The same actions lead to the same score."""
    exact: bool
    """The same actions lead through the same states, bit by bit; so on the machine and versions of the recording."""
    pictures: bool
    """The replay looks like the pictures that are drawn from the states, pixel by pixel."""

    @property
    def good(self) -> bool:
        """Whether the demonstration can be used."""
        return self.score and self.replay


def verify(demo: Demonstration) -> Verdict:
    """Check a demonstration against this version of the world."""
    drawn = [pictures["allo"] for pictures in itertools.islice(see(demo), 0, None, GLANCE)]
    with _world(demo) as env:
        recorder, seen = Recorder(env), [env.render("allo", SIZE)]
        for step, _ in enumerate(play(recorder, demo.actions.tolist()), start=1):
            if step % GLANCE == 0:
                seen.append(env.render("allo", SIZE))
        positions, velocities = recorder.states()
        score = env.score()
    same_scene = sample_scene(demo.task, demo.variant, demo.scene_seed) == demo.scene
    same_states = np.array_equal(positions, demo.qpos) and np.array_equal(velocities, demo.qvel)
    same_pictures = np.array_equal(seen, drawn)
    return Verdict(same_scene, demo.rescored() == demo.score, score == demo.score, same_states, same_pictures)


def see(demo: Demonstration, views: Sequence[str] = ("allo",), size: int = SIZE) -> Iterator[dict[str, Picture]]:
    """The pictures before the first action and after each, drawn from the states: as they were, in any size.

    Args:
        demo: what to look at.
        views: any of "ego" and "allo".
        size: side of the pictures in pixels.

    Yields:
        View -> picture, shape (size, size, 3).
    """
    with _world(demo) as env:
        for positions in demo.qpos:
            place(env, positions)
            yield {view: env.render(view, size) for view in views}


def place(env: Environment, positions: NDArray[np.float64]) -> None:
    """Put everything where it was: what is drawn depends on positions alone."""
    env.physics.data.qpos[:] = positions
    mujoco.mj_kinematics(env.physics.model.ptr, env.physics.data.ptr)
    mujoco.mj_camlight(env.physics.model.ptr, env.physics.data.ptr)


@contextmanager
def _world(demo: Demonstration) -> Iterator[Environment]:
    """The environment of a demonstration, at its start."""
    env = load(demo.task, demo.variant, scene=demo.scene, observations=())
    env.reset()
    try:
        yield env
    finally:
        env.close()
