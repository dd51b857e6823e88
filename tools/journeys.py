"""How far a call travels through the package before the work begins.

Usage: python tools/journeys.py

For an evaluation, an action in a Gymnasium environment and a training, it prints the modules whose functions are
called, in order of the first call; how many these are without those that sample, model, shift and draw scenes, which
are journeys of their own; and how often control comes back to the module where the journey starts. An evaluation ends
its journey at the first step of the simulation, a training at its first update. All modules are imported before, caches
are empty; modules of small things (`utils`, `scene`) are left out.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any, Final

PACKAGE: Final = "magical_mj."
SMALL: Final = ("utils", "scene")
SCENES: Final = ("tasks", "variants", "shifts", "assets", "rendering")
"""The folders of other journeys."""
SIMULATION: Final = ("engine.simulation", "act")


def evaluation() -> tuple[Callable[[], Any], str, tuple[str, str]]:
    """An evaluation of the random agent."""
    import magical_mj.engine  # noqa: F401  else it is imported on the way
    from magical_mj.evaluation.run import evaluate

    return lambda: evaluate("random", tasks="MoveToRegion", variants="Demo", episodes=1), "evaluation.run", SIMULATION


def action() -> tuple[Callable[[], Any], str, tuple[str, str]]:
    """One action in a Gymnasium environment."""
    import gymnasium

    env = gymnasium.make("magical_mj:magical_mj/MoveToRegion-Demo-LoRes4E-v0").unwrapped
    env.reset(seed=0)
    return lambda: env.step(0), "envs.gymnasium_env", ("", "")


def training() -> tuple[Callable[[], Any], str, tuple[str, str]]:
    """A training by behavioural cloning."""
    from magical_mj.learners.config import load_settings
    from magical_mj.learners.training import train

    settings = load_settings("bc", "MoveToRegion", quick=True, demonstrations=2, device="cpu")
    folder = Path(tempfile.mkdtemp()) / "run"
    return lambda: train(settings, folder), "learners.training", ("learners.bc", "update")


JOURNEYS: Final = {"evaluation": evaluation, "action": action, "training": training}


class ArrivedError(BaseException):
    """Ends a journey; not an `Exception`, which might count as a policy's failure."""


class Journey:
    """Follows control through the modules in all threads, which take turns."""

    def __init__(self, start: str, end: tuple[str, str]) -> None:
        self._start, self._end, self._here = start, end, start
        self.modules: dict[str, None] = {}
        self.returns = 0

    def trace(self, frame: FrameType, event: str, _: Any) -> None:
        """Notes where control is after a call or a return, see `sys.setprofile`."""
        at = frame.f_back if event == "return" else frame if event == "call" else None
        module = "" if at is None else str(at.f_globals.get("__name__", ""))
        if at is None or not module.startswith(PACKAGE) or module.split(".")[1] in SMALL:
            return
        module = module.removeprefix(PACKAGE)
        self.returns += module == self._start and self._here != self._start
        self._here = module
        self.modules.setdefault(module)
        if (module, at.f_code.co_name) == self._end:
            raise ArrivedError


def main() -> None:
    """Prints one journey, or all of them, each in a process of its own."""
    if len(sys.argv) == 1:
        for name in JOURNEYS:
            subprocess.run([sys.executable, __file__, name], check=True)
        return
    JOURNEYS[sys.argv[1]]()[0]  # imports everything
    call, start, end = JOURNEYS[sys.argv[1]]()
    journey = Journey(start, end)
    threading.setprofile(journey.trace)
    sys.setprofile(journey.trace)
    try:
        call()
    except ArrivedError:
        pass
    finally:
        sys.setprofile(None)
    own = sum(module.split(".")[0] not in SCENES for module in journey.modules)
    counts = f"{len(journey.modules)} modules, {own} without those of scenes; {journey.returns} returns to {start}"
    print(f"{sys.argv[1]}: {counts}")
    print("  " + ", ".join(journey.modules))


if __name__ == "__main__":
    main()
