"""How much code runs on the main paths of the package: the functions called, their files, and how deeply calls nest.

Each path runs once before it is measured, so that imports, compilation and caches are not counted. Only the package's
own functions count, each once. To Python 3.11, a comprehension is a function, too.
"""

from __future__ import annotations

import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

import gymnasium

import magical_mj

PACKAGE = str(Path(magical_mj.__file__).parent)


class Traced(NamedTuple):
    """What a call has run of the package."""

    functions: int
    files: int
    depth: int


def traced(call: Callable[[], Any]) -> Traced:
    """Calls once without measuring, and once with: in all threads, but not in other processes."""
    call()
    called: set[CodeType] = set()
    deepest = 0

    def profile(frame: FrameType, event: str, _: object) -> None:
        nonlocal deepest
        if event == "call" and own(frame.f_code) and frame.f_code not in called:
            called.add(frame.f_code)
            deepest = max(deepest, depth(frame))

    threading.setprofile(profile)
    sys.setprofile(profile)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    return Traced(len(called), len({code.co_filename for code in called}), deepest)


def own(code: CodeType) -> bool:
    """Whether the code is a function of the package."""
    return code.co_filename.startswith(PACKAGE) and code.co_name != "<module>"


def depth(frame: FrameType | None) -> int:
    """The number of the package's functions that wait for each other, this one included."""
    count = 0
    while frame is not None:
        count += own(frame.f_code)
        frame = frame.f_back
    return count


def main_paths(folder: Path) -> Iterator[tuple[str, Traced]]:
    """Name -> what it runs, for each path. `folder` is for evaluations and trainings."""
    for preset in ("LoRes4E", "State"):
        env = gymnasium.make(f"magical_mj/FindDupe-TestLayout-{preset}-v0").unwrapped
        env.reset(seed=0)
        yield f"env.step, {preset}", traced(partial(env.step, 0))
    for preset in ("LoRes4E", "State"):
        env = gymnasium.make(f"magical_mj/FindDupe-TestLayout-{preset}-v0").unwrapped
        env.reset(seed=0)
        yield f"env.reset, FindDupe TestLayout, {preset}", traced(env.reset)
    env = magical_mj.load("FindDupe", "TestLayout", seed=0)
    env.reset()
    yield "composer step", traced(partial(env.step, 0))
    yield "composer reset", traced(env.reset)
    yield "evaluate, one episode", traced(partial(evaluate, folder))
    yield "train bc", traced(partial(train, folder))


def evaluate(folder: Path) -> None:
    """An evaluation of one episode, in a folder of its own."""
    settings = {"tasks": "MoveToRegion", "variants": "Demo", "episodes": 1, "jobs": 1}
    magical_mj.evaluate("random", out=tempfile.mkdtemp(dir=folder), **settings)


def train(folder: Path) -> None:
    """A short training, in a folder of its own."""
    from magical_mj.learners import load_settings, train

    settings = {"tasks": "MoveToRegion", "quick": True, "preset": "LoRes4E", "bc.batches": 4}
    train(load_settings("bc", **settings), tempfile.mkdtemp(dir=folder))
