"""Import of recordings: episodes that were played elsewhere, mostly in a browser, become demonstrations.

A recording is a small JSON object in UTF-8:

| key | value |
|---|---|
| `format` | 1 |
| `protocol` | the `magical_mj.tasks.protocol.PROTOCOL` under which it was played |
| `task`, `variant` | names, as in `magical_mj.ENVIRONMENTS` |
| `seed` | an integer: the episode started in `sample_scene(task, variant, seed)` |
| `actions` | a list of integers in 0..17, one for each step of a whole episode |
| `final` | the poses that the player saw at the end, in world units and radians; optional |

`final` is `{"robot": [x, y, angle], "fingers": [left, right], "blocks": [[x, y, angle], ...]}`. Other keys are ignored.
Only task, variant, seed and actions are trusted: the scene is drawn again, the actions are replayed here, and the
demonstration holds the states and the score of this replay. `final` is compared with its end.
"""

from __future__ import annotations

import json
from contextlib import closing
from typing import Any, Final, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import Recorder
from magical_mj.engine import Engine
from magical_mj.policies.interface import play
from magical_mj.scene import Scene
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import environment_axes, task_spec, variant_name
from magical_mj.utils.errors import DemonstrationError, shown

FORMAT: Final = 1
MAX_BYTES: Final = 100_000
"""The largest size of a recording: many times that of the longest episode."""
TOLERANCE: Final = 1e-3
"""The difference (world units or radians) between the end of a replay and what the player saw that is accepted."""
LONGEST_NAME: Final = 60  # characters
LARGEST_SEED: Final = 2**63 - 1


class Imported(NamedTuple):
    """A demonstration, and the difference between its end and what the player saw."""

    demonstration: Demonstration
    deviation: float | None
    """The largest difference of any coordinate or angle; None if the recording has no `final`."""

    suspect: bool
    """Whether that is more than `TOLERANCE`: the player saw something different from the demonstration."""


def from_recording(text: str | bytes) -> Imported:
    """Replays a recording, whose keys are listed above, and makes a demonstration of the replay.

    Raises:
        DemonstrationError: if it is too long, not JSON, of another format or protocol, or not a whole episode.
        UnknownNameError: if there is no such environment.
    """
    data = _parsed(text)
    for key, here in (("format", FORMAT), ("protocol", PROTOCOL)):
        if not _is_integer(data.get(key)) or data[key] != here:
            raise DemonstrationError(f"a recording must have {key} {here} to be replayed here, not {_value(data, key)}")
    task, variant, seed, actions = (data.get(key) for key in ("task", "variant", "seed", "actions"))
    if not (_is_name(task) and _is_name(variant)):  # "module:SPEC" is refused: a file must not choose code to load
        raise DemonstrationError(
            f"task and variant must be names, not {_value(data, 'task')} and {_value(data, 'variant')}"
        )
    environment_axes(task, variant)
    if not _is_integer(seed) or not 0 <= seed <= LARGEST_SEED:
        raise DemonstrationError(f"seed must be an integer from 0 to {LARGEST_SEED}, not {_value(data, 'seed')}")
    horizon = task_spec(task).horizon()
    if not isinstance(actions, list) or len(actions) != horizon:
        count = f"{len(actions)}" if isinstance(actions, list) else _value(data, "actions")
        raise DemonstrationError(f"an episode of {task} has {horizon} actions; this recording has {count}")
    if not all(_is_integer(action) and 0 <= action < len(ACTIONS) for action in actions):
        raise DemonstrationError(f"actions must be integers from 0 to {len(ACTIONS) - 1}")
    seen = data.get("final")
    return _replayed(task, variant_name(variant), seed, actions, seen)


def _replayed(task: str, variant: str, seed: int, actions: list[int], seen: Any) -> Imported:
    with closing(Engine(task, variant, seed=0)) as env:
        env.reset(seed=seed)
        expected = None if seen is None else _poses(seen, blocks=len(env.initial_scene.blocks))
        recorder = Recorder(env)
        for _ in play(recorder, actions):
            pass
        demonstration = recorder.demonstration(task, variant, seed, "human", seed)
        found = _poses_of(env.scene)
    deviation = None if expected is None else float(np.abs(found - expected).max())
    return Imported(demonstration, deviation, deviation is not None and deviation > TOLERANCE)


def _parsed(text: str | bytes) -> dict[str, Any]:
    if not isinstance(text, str | bytes):
        raise DemonstrationError(f"a recording is given as its text, not as {type(text).__name__}")
    if len(text) > MAX_BYTES:
        raise DemonstrationError(f"a recording has at most {MAX_BYTES:,} bytes; this one is longer")
    try:
        data = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise DemonstrationError(f"a recording must be JSON; this is cut short or something else: {error}") from None
    if not isinstance(data, dict):
        raise DemonstrationError(f"a recording must be a JSON object, not {shown(data)}")
    return data


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def _is_integer(value: Any) -> TypeGuard[int]:
    return isinstance(value, int) and not isinstance(value, bool)


def _is_name(value: Any) -> TypeGuard[str]:
    return isinstance(value, str) and value.isidentifier() and len(value) <= LONGEST_NAME


def _value(data: dict[str, Any], key: str) -> str:
    return shown(data[key]) if key in data else "nothing"


def _poses(seen: Any, blocks: int) -> NDArray[np.float64]:
    """The poses in `final` as one row: the robot's pose, its fingers' angles, and each block's pose."""
    try:
        parts = [seen["robot"], seen["fingers"], *seen["blocks"]]
        sizes = [len(part) for part in parts]
        row = np.array([float(number) for part in parts for number in part if _is_number(number)])
    except (KeyError, TypeError, OverflowError):
        sizes, row = [], np.empty(0)
    if sizes != [3, 2, *[3] * blocks] or len(row) != sum(sizes) or not np.isfinite(row).all():
        raise DemonstrationError(f"final must hold robot, fingers and the poses of {blocks} blocks, not {shown(seen)}")
    return row


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _poses_of(scene: Scene) -> NDArray[np.float64]:
    robot = scene.robot
    poses = [(robot.x, robot.y, robot.angle, *robot.fingers), *((b.x, b.y, b.angle) for b in scene.blocks)]
    return np.array([number for pose in poses for number in pose])
