"""Draws first frames in several threads at once, in many processes, and counts what happens.

    python tools/first_frames.py [ROUNDS]

One round is one process, whose two to eight threads make their first OpenGL contexts and pictures at the same moment:
drivers have crashed at that. Rounds with this package take turns with rounds with MuJoCo's own renderer, which has no
lock. Prints how many rounds of each ended well, with an error, and by a signal.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor


def ours(count: int) -> list[Callable[[], int]]:
    """For each thread a function that draws by this package, and returns the sum of its picture."""
    from magical_mj import Engine

    engines = [Engine("MatchRegions", seed=0, renderer="opengl") for _ in range(count)]
    return [lambda engine=engine: int(engine.render("ego", 96).sum()) for engine in engines]


def bare(count: int) -> list[Callable[[], int]]:
    """The same model, drawn by MuJoCo's own renderer."""
    import mujoco

    from magical_mj import Engine

    model = Engine("MatchRegions", seed=0).model

    def draw() -> int:
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        with mujoco.Renderer(model, 96, 96) as renderer:
            renderer.update_scene(data)
            return int(renderer.render().sum())

    return [draw] * count


def round_of(draws: list[Callable[[], int]]) -> None:
    """Draws in a thread each, at once; raises unless all threads get the same picture."""
    start = threading.Barrier(len(draws))

    def work(draw: Callable[[], int]) -> int:
        start.wait()
        return draw()

    with ThreadPoolExecutor(len(draws)) as threads:
        sums = list(threads.map(work, draws))
    if len(set(sums)) != 1 or not sums[0]:
        raise SystemExit(f"{len(draws)} threads drew {sums}")


def main() -> None:
    """Runs the rounds."""
    rounds = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    ends = {"ours": Counter[str](), "bare": Counter[str]()}
    for number in range(rounds):
        for kind, counts in ends.items():
            variables = os.environ | {"MUJOCO_GL": "egl", "ROUND": f"{kind} {2 + number % 7}"}
            result = subprocess.run(
                [sys.executable, __file__], env=variables, capture_output=True, text=True, check=False
            )
            code = result.returncode
            end = "well" if code == 0 else f"signal {-code}" if code < 0 else "error"
            counts[end] += 1
            if code:
                print(f"{kind}, round {number}: {end}\n{result.stderr[-2000:]}", flush=True)
        if number % 50 == 49 or number == rounds - 1:
            for kind, counts in ends.items():
                print(f"{kind}: {number + 1} rounds of 2 to 8 threads: {dict(counts)}", flush=True)


if __name__ == "__main__":
    if "ROUND" in os.environ:
        renderer, threads = os.environ["ROUND"].split()
        round_of({"ours": ours, "bare": bare}[renderer](int(threads)))
    else:
        main()
