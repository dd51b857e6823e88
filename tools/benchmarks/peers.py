"""Compares the speed of other benchmarks with ours, in one process: ``make peers``.

Each environment is stepped with random actions, including resets, in short alternating turns, so that other load
affects all equally. Times are processor time over all threads. The time of a step is the smallest of all turns. If an
environment cannot be made, the table shows the error.

Meta-World is missing: version 3.1.1 excludes the MuJoCo version that ours needs. Version 3.0.0 fails with it, because
it writes 11 numbers for each equality constraint, but that version has 12.
"""

from __future__ import annotations

import itertools
import os
import warnings
from collections.abc import Callable, Iterator
from importlib import import_module, metadata
from time import process_time
from typing import Annotated, Any, Final

import gymnasium
import numpy as np
import typer
from gymnasium.wrappers import AtariPreprocessing, FrameStackObservation

Step = Callable[[], object]
ROUNDS: Final = 12
TURN: Final = 0.25
"""Seconds of processor time of a turn."""
REFERENCE: Final = "ours, pixels (software)"
ENGINE: Final = "pymunk alone, nine boxes"
BLOCKS: Final = 8
ORIGINAL: Final = {"iterations": 10, "substeps": 10, "dt": 1 / 80}
"""The settings of the engine of the original MAGICAL."""


def stepper(env: gymnasium.Env[Any, Any]) -> Step:
    """A function that takes a random step in an environment, and resets it after the end of an episode."""
    env.action_space.seed(0)
    env.reset(seed=0)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()

    return step


def ours(task: str, variant: str, preset: str, renderer: str | None = None) -> Step:
    """An environment of ours."""
    import_module("magical_mj")
    options: dict[str, Any] = {"renderer": renderer} if renderer else {}
    return stepper(gymnasium.make(f"magical_mj/{task}-{variant}-{preset}-v0", **options))


def pusht(observations: str) -> Step:
    """gym-pusht with its default picture of 96 x 96 pixels."""
    import_module("gym_pusht")
    return stepper(gymnasium.make("gym_pusht/PushT-v0", obs_type=observations))


def minigrid() -> Step:
    """MiniGrid with the whole grid as a picture."""
    wrappers = import_module("minigrid.wrappers")
    return stepper(wrappers.RGBImgObsWrapper(gymnasium.make("MiniGrid-DoorKey-8x8-v0")))


def atari() -> Step:
    """The Arcade Learning Environment with the usual 84 x 84 x 4 grey pixels."""
    import_module("ale_py")
    env = AtariPreprocessing(gymnasium.make("ALE/Pong-v5", frameskip=1))
    return stepper(FrameStackObservation(env, 4))


def envpool_atari() -> Step:
    """The same in EnvPool with one environment and one thread. Its steps are C++ code."""
    env = import_module("envpool").make_gymnasium("Pong-v5", num_envs=1, num_threads=1)
    env.reset()
    action = np.zeros(1, np.int32)
    return lambda: env.step(action)


def original_engine() -> Step:
    """Only the physics engine of the original MAGICAL: eight boxes and a driven one, without pictures."""
    pymunk = import_module("pymunk")
    space = pymunk.Space()
    space.iterations = ORIGINAL["iterations"]
    rng = np.random.default_rng(0)
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    for start, end in itertools.pairwise([*corners, corners[0]]):
        space.add(pymunk.Segment(space.static_body, start, end, 0.01))
    for number in range(BLOCKS + 1):
        body = pymunk.Body(0.5, 0.01)
        body.position = (-0.6 + 0.6 * (number % 3), -0.6 + 0.6 * (number // 3))
        shape = pymunk.Poly.create_box(body, (0.22, 0.22))
        shape.friction = 0.5
        ground = pymunk.PivotJoint(space.static_body, body, (0, 0), (0, 0))
        ground.max_bias, ground.max_force = 0.0, 1.5
        turning = pymunk.GearJoint(space.static_body, body, 0.0, 1.0)
        turning.max_bias, turning.max_force = 0.0, 0.1
        space.add(body, shape, ground, turning)

    def step() -> None:
        space.bodies[0].velocity = tuple(rng.uniform(-1, 1, 2))
        for _ in range(int(ORIGINAL["substeps"])):
            space.step(ORIGINAL["dt"])

    return step


CANDIDATES: Final[dict[str, tuple[str, Callable[[], Step]]]] = {
    REFERENCE: ("magical-mj", lambda: ours("MatchRegions", "Demo", "LoRes4E", "software")),
    "ours, pixels (OpenGL)": ("magical-mj", lambda: ours("MatchRegions", "Demo", "LoRes4E", "opengl")),
    "ours, states": ("magical-mj", lambda: ours("MatchRegions", "Demo", "State")),
    "gym-pusht, pixels": ("gym-pusht", lambda: pusht("pixels")),
    "gym-pusht, states": ("gym-pusht", lambda: pusht("state")),
    "MiniGrid, RGB": ("minigrid", minigrid),
    "ALE, 84 x 84 x 4": ("ale-py", atari),
    "EnvPool, 84 x 84 x 4": ("envpool", envpool_atari),
    ENGINE: ("pymunk", original_engine),
}


def turns(steps: dict[str, Step]) -> Iterator[tuple[str, float]]:
    """The processor time of a step, for each candidate in each round."""
    for _ in range(ROUNDS):
        for name, step in steps.items():
            count, start = 0, process_time()
            while (taken := process_time() - start) < TURN:
                step()
                count += 1
            yield name, taken / count


def main(picture: Annotated[str, typer.Option(help="Draw a bar chart into this file.")] = "") -> None:
    """Print a Markdown table of steps per second and of ours as a multiple of each."""
    warnings.filterwarnings("ignore")
    os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
    steps: dict[str, Step] = {}
    failures: dict[str, str] = {}
    for name, (_, make) in CANDIDATES.items():
        try:
            steps[name] = make()
            steps[name]()  # the first step may compile, or open a window
        except Exception as error:  # noqa: BLE001 - other packages may raise anything
            failures[name] = f"{type(error).__name__}: {error}".splitlines()[0]
    best: dict[str, float] = {}
    for name, seconds in turns(steps):
        best[name] = min(seconds, best.get(name, seconds))
    typer.echo("| Environment | version | steps/s | ours is faster by |\n| --- | --- | ---: | ---: |")
    for name, (package, _) in CANDIDATES.items():
        version = metadata.version(package) if name in best else failures[name]
        numbers = f"{1 / best[name]:,.0f} | {best[name] / best[REFERENCE]:.2g}" if name in best else " | "
        typer.echo(f"| {name} | {version} | {numbers} |")
    if picture:
        _draw({name: 1 / seconds for name, seconds in best.items()}, picture)


def _draw(rates: dict[str, float], path: str) -> None:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 3.4), layout="constrained")
    axes = figure.subplots()
    names = sorted(rates.keys() - {ENGINE}, key=lambda name: rates[name])
    bars = axes.barh(names, [rates[name] for name in names])
    for bar, name in zip(bars, names, strict=True):
        bar.set_color("#2a6fb0" if name.startswith("ours") else "#b9bec4")
    axes.bar_label(bars, [f"{rates[name]:,.0f}" for name in names], padding=3)
    axes.set_xlabel("steps a second of processor time")
    axes.margins(x=0.15)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    typer.run(main)
