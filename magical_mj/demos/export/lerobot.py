"""Demonstrations as LeRobot data sets (format 3.0), written by lerobot itself.

Frames are drawn at 96 px, not scaled down, and stored as PNG unless videos are asked for: AV1 is lossy; the state
vector can take their place. Actions are vectors (drive, turn, grip); no-ops stay, for LeRobot takes frames to be evenly
spaced in time.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical_mj.assets.world import World
from magical_mj.demos.demonstration import Demonstration, demonstrators, only_environment
from magical_mj.demos.export.folders import CARD, card
from magical_mj.demos.learning import observations
from magical_mj.demos.recording import render_demo
from magical_mj.scene import constants as c
from magical_mj.scene.actions import to_vector
from magical_mj.scene.state_vector import STATE_NAMES
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import MagicalError, check_name
from magical_mj.utils.extras import remedy

if TYPE_CHECKING:
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # pyright: ignore[reportMissingImports]

IMAGE_SIZE: Final = 96
VIEWS: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {"ego": ("ego",), "allo": ("allo",), "both": ("ego", "allo"), "state": ()}
)
"""The pictures that a policy sees, by the word that options use; instead of none, it sees the state vector."""
PRESETS: Final[Mapping[str, str]] = MappingProxyType(
    {"ego": "LoRes4E", "allo": "LoRes4A", "both": "LoResStack", "state": "State"}
)
"""By the same words, the preset with these pictures, of whose stacks the newest count, or with the state vector."""


def missing_lerobot() -> MagicalError:
    """The error where lerobot cannot be imported: it needs an environment of its own."""
    return MagicalError(
        "this needs lerobot 0.6 (Python 3.12 or newer), which excludes versions that this package is tested with: make "
        f'a new environment for both, and in it {remedy("eval")} "lerobot[dataset]==0.6.1"; in a checkout, '
        "`make lerobot` does so in .venv-lerobot"
    )


def image_keys(views: str) -> dict[str, str]:
    """View -> the key of its pictures in LeRobot's data: ``observation.image``, or one key for each of both views."""
    check_name("choice of views", views, VIEWS)
    only_one = len(VIEWS[views]) == 1
    return {view: "observation.image" if only_one else f"observation.images.{view}" for view in VIEWS[views]}


def to_lerobot(
    demos: Sequence[Demonstration],
    folder: Path | str,
    *,
    views: str = "ego",
    fingers: bool = False,
    video: bool = False,
) -> LeRobotDataset:
    """Makes a LeRobot data set of demonstrations of one environment in a new folder; each becomes an episode.

    `fingers` puts the two finger angles (left, right; rad), which the paper's learners do not see, into
    ``observation.state``. Without, it is a constant: LeRobot's policies cannot do without a state. `video` stores AV1
    videos instead of PNG: smaller, but lossy (0.7 levels on average, at most 31). The id of the finished data set names
    task, variant, demonstrators, observations and protocol.

    Raises a `MagicalError` without lerobot, a `DemonstrationError` if the demonstrations are not of one environment,
    and a `FileExistsError` if the folder exists.
    """
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise missing_lerobot() from None
    keys = image_keys(views)
    environment, folder = only_environment(demos), files.to_path(folder)
    who, observed = "-".join(demonstrators(demos)), f"{views}{'-fingers' if fingers else ''}"
    name = f"magical-mj/{environment}-{who}-{observed}-p{PROTOCOL}"
    features = _features(keys, fingers=fingers, video=video)
    if demos[0].actions.ndim == 2:
        features["action"] = _vector(("speed", "turn", "grip")[: demos[0].actions.shape[1]])
    with files.new_folder(folder) as unfinished:  # half a data set reads like a whole one
        data_set = LeRobotDataset.create(
            name, c.CONTROL_RATE, features, root=unfinished, robot_type="magical_mj", use_videos=video
        )
        for demo in demos:
            for frame in _frames(demo, keys, fingers=fingers):
                data_set.add_frame(frame)
            data_set.save_episode()
        data_set.finalize()
        what = f"{', '.join(keys) or 'the state vector'}, at {c.CONTROL_RATE} Hz"
        shapes = {key: f"{part['dtype']}, shape {part['shape']}" for key, part in features.items()}
        options = " ".join(f"--env.{name}={value}" for name, value in env_options(demos[0], views, fingers).items())
        (unfinished / CARD).write_text(card(demos, what, f"`{options}`", shapes), encoding="utf-8")
    return LeRobotDataset(name, root=folder)


def env_options(demo: Demonstration, views: str, fingers: bool) -> dict[str, str]:
    """The environment of a demonstration, with a data set's observations, as LeRobot's commands take it."""
    facts = {"task": demo.task, "variant": demo.variant, "body": demo.scene.robot.body, "shifts": demo.shifts}
    chosen = {**facts, "views": views, "fingers": str(fingers).lower()}
    return {"type": "magical", **{name: value for name, value in chosen.items() if value}}


STATE_VECTOR: Final = "observation.environment_state"
NO_STATE: Final = ("zero0", "zero1", "zero2")
FINGERS: Final = ("left_finger", "right_finger")
"""The entries of LeRobot's state, with fingers and without; their number differs (one entry would lose its axis)."""


def state(fingers: ArrayLike | None) -> NDArray[np.float32]:
    """LeRobot's state: the angles of the fingers (rad), shape (2,), or without them zeros, shape (3,)."""
    return np.zeros(len(NO_STATE), np.float32) if fingers is None else np.asarray(fingers, np.float32)


def _features(keys: Mapping[str, str], *, fingers: bool, video: bool) -> dict[str, Any]:
    image = {
        "dtype": "video" if video else "image",
        "shape": (IMAGE_SIZE, IMAGE_SIZE, 3),
        "names": ["height", "width", "channels"],
    }
    return {
        **(dict.fromkeys(keys.values(), image) if keys else {STATE_VECTOR: _vector(STATE_NAMES)}),
        "observation.state": _vector(FINGERS if fingers else NO_STATE),
        "action": _vector(("drive", "turn", "grip")),
    }


def _vector(names: Sequence[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": (len(names),), "names": list(names)}


def _frames(demo: Demonstration, keys: Mapping[str, str], *, fingers: bool) -> Iterator[dict[str, Any]]:
    """What is observed before each action, and the action: pictures, or without keys of any the state vector."""
    sentence, world = task_spec(demo.task).summary, World(demo.scene)
    if keys:
        pictures = render_demo(demo, list(keys), IMAGE_SIZE)
        observed = ({key: frame[view] for view, key in keys.items()} for frame in pictures)
    else:
        observed = ({STATE_VECTOR: row} for row in observations(demo, "State"))
    for parts, qpos, action in zip(observed, demo.qpos, demo.actions, strict=False):
        yield {
            **parts,
            "observation.state": state(world.fingers(qpos) if fingers else None),
            "action": action if np.ndim(action) else to_vector(action),
            "task": sentence,
        }
