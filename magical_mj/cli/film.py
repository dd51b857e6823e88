"""Whole episodes with the expert or with agents that look at nothing, and films of them."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from magical_mj.actions import ACTIONS, NOOP
from magical_mj.constants import CONTROL_RATE
from magical_mj.extras import missing_extra

if TYPE_CHECKING:
    from magical_mj.environment import Environment

Agent = Literal["expert", "random", "noop"]

Watch = Callable[["Environment"], None]


class Result(NamedTuple):
    """How an episode ended."""

    score: float
    steps: int


def actions(agent: Agent, seed: int, env: Environment, task: str) -> Iterator[int]:
    """What the agent does in an environment of the task, for ever.

    The expert of the seed looks at the environment; the others do nothing, or independent uniform actions.
    """
    if agent == "expert":
        from magical_mj.experts import Expert

        expert = Expert(env, task, seed)
        return (expert() for _ in itertools.count())
    if agent == "noop":
        return itertools.repeat(NOOP)
    rng = np.random.default_rng(seed)
    return (int(rng.integers(len(ACTIONS))) for _ in itertools.count())


def play(env: Environment, task: str, agent: Agent, seed: int, watch: Watch | None = None) -> Result:
    """Plays one episode of the task in the scene of `seed`.

    `watch` sees the environment at its start and after each step.
    """
    env.reset(seed=seed)
    if watch is not None:
        watch(env)
    for steps, action in enumerate(actions(agent, seed, env, task), start=1):
        last = env.step(action).last()
        if watch is not None:
            watch(env)
        if last:
            return Result(env.score(), steps)
    raise AssertionError("agents act for ever")


@contextmanager
def film(path: Path, size: int, speed: int = 1) -> Iterator[Watch]:
    """A video of an environment, both views side by side; yields what adds a frame. See `film_pictures`."""
    with film_pictures(path, size, speed) as add:
        yield lambda env: add(both_views(env, size))


@contextmanager
def film_pictures(path: Path, size: int, speed: int = 1) -> Iterator[Callable[[np.ndarray], None]]:
    """A video of two pictures side by side; yields what adds a frame of shape (size, 2 size, 3).

    Args:
        path: the MP4 file, overwritten if it exists.
        size: side of each picture in pixels.
        speed: 1 is real time.
    """
    try:
        import imageio_ffmpeg
    except ModuleNotFoundError:
        raise missing_extra("writing a video", "video") from None
    writer = imageio_ffmpeg.write_frames(
        str(path), (2 * size, size), fps=speed * CONTROL_RATE, macro_block_size=2, quality=8, ffmpeg_log_level="error"
    )
    writer.send(None)
    try:
        yield lambda picture: writer.send(np.ascontiguousarray(picture))
    except BaseException:
        writer.close()
        path.unlink(missing_ok=True)  # half a film is no use
        raise
    writer.close()


def both_views(env: Environment, size: int) -> np.ndarray:
    """The world as it is now: from above, and as the robot sees it. Shape (size, 2 size, 3)."""
    return np.concatenate([env.render("allo", size), env.render("ego", size)], axis=1)
