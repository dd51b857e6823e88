"""Draws first frames in several threads at once, in many processes, and counts what happens.

    python tools/first_frames.py [ROUNDS]

One round is one process, whose two to eight threads make their first OpenGL contexts and pictures at the same moment:
drivers have crashed at that. Prints how many rounds ended well, with an error, and by a signal.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections import Counter


def round_of(threads: int) -> None:
    """Draws in so many threads at once; raises unless all see the same picture."""
    from magical_mj import Engine

    engines = [Engine("MatchRegions", seed=0) for _ in range(threads)]
    start, sums = threading.Barrier(threads), []

    def draw(engine: Engine) -> None:
        start.wait()
        sums.append(int(engine.render("ego", 96).sum()))

    workers = [threading.Thread(target=draw, args=(engine,)) for engine in engines]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    if len(sums) != threads or len(set(sums)) != 1:
        raise SystemExit(f"{threads} threads drew {sums}")


def main() -> None:
    """Runs the rounds."""
    rounds, ends = int(sys.argv[1]) if len(sys.argv) > 1 else 100, Counter[str]()
    for number in range(rounds):
        variables = os.environ | {"ROUND": str(2 + number % 7)}
        result = subprocess.run([sys.executable, __file__], env=variables, capture_output=True, text=True, check=False)
        end = "well" if result.returncode == 0 else f"signal {-result.returncode}" if result.returncode < 0 else "error"
        ends[end] += 1
        if result.returncode:
            print(f"round {number}: {end}\n{result.stderr[-2000:]}")
    print(f"{rounds} rounds of 2 to 8 threads: {dict(ends)}")


if __name__ == "__main__":
    round_of(int(os.environ["ROUND"])) if "ROUND" in os.environ else main()
