"""Policies for the tests of evaluations, importable by worker processes as ``agents:...``."""

from __future__ import annotations

import os
import re
import signal
import sys
import time
import zlib
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from magical_mj.evaluation import Episode


def look(observation: Any) -> int:
    """An action that depends on every bit of the observation."""
    return zlib.crc32(np.ascontiguousarray(observation).tobytes()) % 18


class Acting:
    """Acts by a function (by default no-ops), calls another one before each episode, and has the given attributes."""

    def __init__(
        self, act: Callable[[Any], Any] = lambda _: 0, reset: Callable[[Episode], object] = repr, **facts: Any
    ) -> None:
        self._act, self.reset = act, reset
        vars(self).update(facts)

    def __call__(self, observation: Any) -> Any:
        return self._act(observation)


class Counting:
    """Its actions depend on the observation and on the number of steps, so that mixed-up episodes are detected."""

    def reset(self, episode: Episode) -> None:
        self.steps = episode.seed

    def __call__(self, observation: Any) -> int:
        self.steps += 1
        return (look(observation) + self.steps) % 18


class Batch:
    """Acts like `look`, for all environments at once."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        pass

    def act_batch(self, observations: Any) -> list[int]:
        return [look(observation) for observation in observations]

    def __call__(self, observation: Any) -> int:
        return look(observation)


class Alone:
    """Wraps a policy and hides its methods for batches."""

    def __init__(self, policy: Any) -> None:
        self._policy = policy
        self.reset, self.preset, self.tasks = policy.reset, policy.preset, policy.tasks

    def __call__(self, observation: Any) -> Any:
        return self._policy(observation)


class Stubborn:
    """Always takes the same action. After `close`, it fails."""

    def __init__(self, action: int = 0) -> None:
        self.action = action

    def close(self) -> None:
        self.action = -1

    def __call__(self, observation: Any) -> int:
        return self.action


class Trouble:
    """Acts normally in the scenes of even seeds. In each other scene, it fails in a different way."""

    uses_simulation = True

    def reset(self, episode: Episode) -> None:
        self.seed = episode.seed
        if self.seed == 1:
            raise RuntimeError("lost\nits way")

    def __call__(self, observation: Any) -> Any:
        if self.seed == 5:
            while True:
                pass
        if self.seed == 7:
            time.sleep(1000)
        if self.seed == 9:  # blocks all other threads
            re.match("(a+)+$", "a" * 60 + "b")
        return {3: 18, 11: None, 13: np.float32(2.0), 15: [1]}.get(self.seed, 1)


class Slow:
    """Takes no-op actions slowly."""

    uses_simulation = True

    def __call__(self, observation: Any) -> int:
        time.sleep(0.001)
        return 0


class Slower:
    """Takes no-op actions, a second for an episode of MoveToRegion, and ten in the scene of seed 1."""

    uses_simulation = True
    usual = 0.025

    def reset(self, episode: Episode) -> None:
        self.pause = 0.25 if episode.seed == 1 else self.usual

    def __call__(self, observation: Any) -> int:
        time.sleep(self.pause)
        return 0


class Leaving:
    """Calls `sys.exit` in the scene of seed 1."""

    def reset(self, episode: Episode) -> None:
        self.seed = episode.seed

    def __call__(self, observation: Any) -> int:
        if self.seed == 1:
            sys.exit("enough")
        return 0


class Needy:
    """Cannot be constructed without an argument."""

    def __init__(self, size: int) -> None:
        self.size = size

    def __call__(self, observation: Any) -> int:
        return 0


class Fatal:
    """Kills its process in the scene of seed 1, unless a file shows that it has done so before."""

    uses_simulation = True

    def reset(self, episode: Episode) -> None:
        mark = Path(os.environ["FATAL_MARK"])
        if episode.seed == 1 and (not mark.exists() or mark.read_text() == "always"):
            if not mark.exists():
                mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)

    def __call__(self, observation: Any) -> int:
        return 0


NOT_CALLABLE = 3


class Nearest:
    """Copies the action of the demonstrated moment whose state is nearest."""

    preset = "State"
    uses_demonstrations = True

    def reset(self, episode: Episode) -> None:
        self._states = np.concatenate([shown.observations for shown in episode.demonstrations])
        self._actions = np.concatenate([shown.actions for shown in episode.demonstrations])

    def __call__(self, observation: Any) -> int:
        return int(self._actions[np.abs(self._states - observation).sum(axis=1).argmin()])


class NearestOfAll(Nearest):
    """Does so for several episodes at once."""

    def reset_batch(self, episodes: Sequence[Episode]) -> None:
        self.reset(episodes[0])

    def act_batch(self, observations: Any) -> list[int]:
        return [self(observation) for observation in observations]
