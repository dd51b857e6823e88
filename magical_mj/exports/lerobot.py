"""Exports demonstrations to LeRobot data sets (format 3.0), with lerobot's own writer.

Frames are rendered at 96 px, and stored as PNG by default, because videos are lossy. Alternatively, observations are
state vectors. Actions are vectors (drive, turn, grip), including no-ops, because LeRobot assumes a constant frame rate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from magical_mj.actions import to_vector
from magical_mj.assets.scene_model import SceneModel
from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.learning import observations
from magical_mj.demos.recording import render_demo
from magical_mj.exports.folders import CARD, EACH, about, card
from magical_mj.observations import STATE_NAMES
from magical_mj.protocol import PROTOCOL
from magical_mj.scene import constants as c
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
"""Choice of views -> the pictures in an observation. Without pictures, the observation is the state vector."""
PRESETS: Final[Mapping[str, str]] = MappingProxyType(
    {"ego": "LoRes4E", "allo": "LoRes4A", "both": "LoResStack", "state": "State"}
)
"""Choice of views -> the preset with these observations. LeRobot uses only the newest picture of its stacks."""


def missing_lerobot() -> MagicalError:
    """The error if lerobot cannot be imported."""
    return MagicalError(
        "this needs lerobot 0.6 and Python 3.12 or newer. lerobot excludes versions that this package is tested with, "
        f'so create a new virtual environment for both, and run there: {remedy("eval")} "lerobot[dataset]==0.6.1". In '
        "a checkout, `make lerobot` does so in .venv-lerobot"
    )


def require_lerobot() -> None:
    """Raises a `MagicalError` if data sets of lerobot cannot be made here."""
    try:
        import lerobot.datasets.lerobot_dataset  # pyright: ignore[reportMissingImports]  # noqa: F401
    except ImportError:
        raise missing_lerobot() from None


def image_keys(views: str) -> dict[str, str]:
    """View -> the key of its pictures in LeRobot's data: ``observation.image``, or with both views a key for each."""
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
    """Writes demonstrations of one environment as a LeRobot data set. Each becomes an episode.

    The id of the data set contains task, variant, demonstrators, observations and protocol.

    Args:
        demos: demonstrations of one environment.
        folder: the new folder.
        views: the choice of observations, one of `VIEWS`.
        fingers: whether ``observation.state`` contains the angles (rad) of the left and right finger, which the paper's
            learners do not see. Otherwise it is constant, because LeRobot's policies require a state.
        video: whether to store AV1 videos instead of PNG. They are smaller, but lossy, with errors of 0.7 levels on
            average, and at most 31.

    Raises:
        MagicalError: if lerobot is not installed.
        UnknownNameError: for an unknown choice of views.
        DemonstrationError: if the demonstrations are not of one environment.
        FileExistsError: if the folder exists.
    """
    require_lerobot()
    from lerobot.datasets.lerobot_dataset import LeRobotDataset  # pyright: ignore[reportMissingImports]

    keys = image_keys(views)
    facts, folder = about(demos), files.to_path(folder)
    makers, observed = "-".join(facts["demonstrators"]), f"{views}{'-fingers' if fingers else ''}"
    name = f"magical-mj/{facts['environment']}-{makers}-{observed}-p{PROTOCOL}"
    features = _features(keys, fingers=fingers, video=video)
    if demos[0].actions.ndim == 2:
        features["action"] = _vector(("speed", "turn", "grip")[: demos[0].actions.shape[1]])
    with files.new_folder(folder) as unfinished:  # because an incomplete data set looks like a complete one
        data_set = LeRobotDataset.create(
            name, c.CONTROL_RATE, features, root=unfinished, robot_type="magical_mj", use_videos=video
        )
        for demo in demos:
            for frame in _frames(demo, keys, fingers=fingers):
                data_set.add_frame(frame)
            data_set.save_episode()
        data_set.finalize()
        description = f"{', '.join(keys) or 'the state vector'}, at {c.CONTROL_RATE} Hz"
        shapes = {key: f"{part['dtype']}, shape {part['shape']}" for key, part in features.items()}
        options = " ".join(f"--env.{name}={value}" for name, value in env_options(demos[0], views, fingers).items())
        made_in = EACH if "tasks" in facts else f"`{options}`"
        text = card(facts, demos[0].task, description, made_in, shapes)
        (unfinished / CARD).write_text(text, encoding="utf-8")
    return LeRobotDataset(name, root=folder)


def env_options(demo: Demonstration, views: str, fingers: bool) -> dict[str, str]:
    """The options of LeRobot's commands for a demonstration's environment with a data set's observations."""
    facts = {"task": demo.task, "variant": demo.variant, "body": demo.scene.robot.body, "shifts": demo.shifts}
    chosen = {**facts, "views": views, "fingers": str(fingers).lower()}
    return {"type": "magical", **{name: value for name, value in chosen.items() if value}}


STATE_VECTOR: Final = "observation.environment_state"
NO_STATE: Final = ("zero0", "zero1", "zero2")
FINGERS: Final = ("left_finger", "right_finger")
"""The entries of LeRobot's state with fingers. `NO_STATE` has another length, so that the two cannot be confused.

It does not have length 1, because LeRobot would then drop the axis.
"""


def state(fingers: ArrayLike | None) -> NDArray[np.float32]:
    """LeRobot's state: the angles of the fingers (rad), shape (2,). With None three zeros, shape (3,)."""
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
    """Yields each action with the observation before it: pictures, or the state vector if `keys` is empty."""
    sentence, model = task_spec(demo.task).instruction, SceneModel(demo.scene)
    if keys:
        pictures = render_demo(demo, list(keys), IMAGE_SIZE)
        observed = ({key: frame[view] for view, key in keys.items()} for frame in pictures)
    else:
        observed = ({STATE_VECTOR: row} for row in observations(demo, "State"))
    for parts, qpos, action in zip(observed, demo.qpos, demo.actions, strict=False):
        yield {
            **parts,
            "observation.state": state(model.fingers(qpos) if fingers else None),
            "action": action if np.ndim(action) else to_vector(action),
            "task": sentence,
        }
