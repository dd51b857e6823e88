"""Compares the software renderer with OpenGL: the differences of their pictures, and their speed.

    python tools/renderers.py [--seeds N] [--states N] [--steps N]
    python tools/renderers.py --hash N

In every environment, both draw the states after each action of a few random episodes, ego and allo at 96 pixels. Then
some environments are stepped with each renderer. Times are processor time, and unreliable on a busy machine.

With --hash, it only prints the SHA-256 of N pictures of the software renderer. This hash must be the same in every
process and under every version of Python.
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice

import gymnasium
import mujoco
import numpy as np

import magical_mj
from magical_mj.assets.contacts import SUBSTEPS
from magical_mj.assets.robot import controls
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.observations import VIEWS
from magical_mj.rendering.backend import RENDERERS
from magical_mj.rendering.opengl import OpenGLRenderer, opengl_name
from magical_mj.rendering.software import SoftwareRenderer

SIZE = 96
STEPPED = ("MoveToCorner", "MatchRegions", "MakeLine")
REPEATS = 7


def states(task: str, variant: str, seed: int, count: int) -> Iterator[tuple[mujoco.MjModel, mujoco.MjData]]:
    """Yields a model and its data `count` times: at the start, and after each random action."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(scene_mjcf(magical_mj.sample_scene(task, variant, seed)))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    action = 0
    for number in range(count):
        yield model, data
        action = int(rng.integers(18)) if number % 4 == 0 else action
        data.ctrl[:] = controls()[action]
        mujoco.mj_step(model, data, SUBSTEPS)
        mujoco.mj_forward(model, data)


def microseconds(draw: Callable[[], object], count: int = 50) -> float:
    """Processor time of one call in microseconds: the smallest of several means."""
    times = []
    for _ in range(REPEATS):
        start = time.thread_time_ns()
        for _ in range(count):
            draw()
        times.append((time.thread_time_ns() - start) / count / 1000)
    return min(times)


def compare(task: str, variant: str, seeds: int, count: int) -> np.ndarray:
    """Prints a row for one environment. Returns the number of pixels for each difference, shape (256,)."""
    levels = np.zeros(256, np.int64)
    slow = fast = 0.0
    for seed in range(seeds):
        opengl = software = None
        for model, data in states(task, variant, seed, count):
            opengl, software = opengl or OpenGLRenderer(model), software or SoftwareRenderer(model)
            for view in VIEWS:
                a, b = opengl.draw(data, view, SIZE).astype(np.int16), software.draw(data, view, SIZE)
                levels += np.bincount(np.abs(a - b).max(axis=2).ravel(), minlength=256)
            out = np.zeros((SIZE, SIZE, 12), np.uint8)[..., :3]
            if seed == 0 and not slow:
                slow, fast = (microseconds(partial(r.draw, data, "ego", SIZE, out)) for r in (opengl, software))
    print(
        f"{task:14}{variant:10} {share(levels):.4f} % differ, by at most {levels.nonzero()[0].max():3}; "
        f"OpenGL {slow:4.0f} us, software {fast:3.0f} us",
        flush=True,
    )
    return levels


def share(levels: np.ndarray) -> float:
    """The percentage of pixels that differ."""
    return 100 * levels[1:].sum() / max(levels.sum(), 1)


def software_pictures() -> Iterator[bytes]:
    """Pictures of 96 pixels, ego and allo, of 50 states of a random episode in each environment, seed after seed."""
    for seed in range(100):
        for task, variant in magical_mj.ENVIRONMENTS:
            software = None
            for model, data in states(task, variant, seed, 50):
                software = software or SoftwareRenderer(model)
                yield from (software.draw(data, view, SIZE).tobytes() for view in VIEWS)


def steps_per_second(task: str, renderer: str, steps: int) -> float:
    """Actions per second of processor time in a LoRes4E environment, without resets."""
    env = gymnasium.make(f"magical_mj/{task}-Demo-LoRes4E-v0", renderer=renderer).unwrapped
    rng = np.random.default_rng(0)
    spent, taken, seed = 0.0, 0, 0
    while taken < steps:
        env.reset(seed=seed)
        seed, last = seed + 1, False
        start = time.process_time()
        while not last:
            last = env.step(int(rng.integers(18)))[3]
            taken += 1
        spent += time.process_time() - start
    env.close()
    return taken / spent


def main() -> None:
    """Prints a row for each environment, the totals, and the steps per second."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("seeds", 2), ("states", 20), ("steps", 600)):
        parser.add_argument(f"--{name}", type=int, default=default)
    parser.add_argument("--hash", type=int, default=0, metavar="N")
    arguments = parser.parse_args()
    if arguments.hash:
        digest = hashlib.sha256()
        for picture in islice(software_pictures(), arguments.hash):
            digest.update(picture)
        print(f"{digest.hexdigest()}  {arguments.hash} pictures, Python {sys.version.split()[0]}")
        return
    print(f"OpenGL: {opengl_name()}; MuJoCo {mujoco.__version__}")
    levels = np.zeros(256, np.int64)
    for task, variant in magical_mj.ENVIRONMENTS if arguments.seeds else ():
        levels += compare(task, variant, arguments.seeds, arguments.states)
    middle = int(np.searchsorted(levels[1:].cumsum(), levels[1:].sum() / 2)) + 1
    print(f"{levels.sum()} pixels, {share(levels):.4f} % differ, half of these by at most {middle} of 255")
    for task in STEPPED if arguments.steps else ():
        rates = {renderer: steps_per_second(task, renderer, arguments.steps) for renderer in RENDERERS}
        ratio = rates["software"] / rates["opengl"]
        print(f"{task:14}" + ", ".join(f"{name} {rate:.0f} steps/s" for name, rate in rates.items()) + f": {ratio:.2f}")


if __name__ == "__main__":
    main()
