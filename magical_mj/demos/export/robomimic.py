"""Demonstrations as an HDF5 file of robomimic's format, which its `SequenceDataset` reads.

Frames are single and drawn at 96 px: robomimic stacks them itself. Actions are vectors (drive, turn, grip); no-ops
stay.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, only_environment
from magical_mj.demos.export.lerobot import IMAGE_SIZE, VIEWS
from magical_mj.demos.learning import observations
from magical_mj.demos.replay import see
from magical_mj.envs.registration import env_id
from magical_mj.scene.actions import to_vector
from magical_mj.utils import files
from magical_mj.utils.errors import check_name
from magical_mj.utils.extras import missing_extra

GYM: Final = 2
"""robomimic's number for Gym environments; its class for them imports the old `gym`, so rollouts need one's own."""


def to_robomimic(
    demos: Sequence[Demonstration], path: Path | str, *, views: str = "ego", overwrite: bool = False
) -> None:
    """Write demonstrations of one environment as a data set of robomimic.

    Each becomes ``data/demo_0`` and so on: ``obs`` and ``next_obs`` (``ego_image`` and ``allo_image``, uint8, height x
    width x channels; or ``state``), ``actions`` (float32, drive, turn, grip), ``rewards`` (the score at the last step),
    ``dones`` (1 at the last step) and ``states`` (positions and velocities, exact).

    Args:
        demos: demonstrations of one environment.
        path: of the file.
        views: "ego", "allo" or "both"; "state" for the state vector instead of pictures.
        overwrite: replace a file of that name.

    Raises:
        MissingExtraError: if h5py is not installed.
        DemonstrationError: if the demonstrations are not of one environment.
        UnknownNameError: if `views` is none of `magical_mj.demos.export.lerobot.VIEWS`.
        FileExistsError: if the file exists.
    """
    try:
        import h5py
    except ModuleNotFoundError:
        raise missing_extra("exporting to robomimic", "robomimic") from None
    check_name("choice of views", views, VIEWS)
    only_environment(demos)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    written = io.BytesIO()  # since HDF5 ends the process if the disk is full
    with files.new_file(path, overwrite=overwrite) as unfinished:
        with h5py.File(written, "w") as file:
            _fill(file, demos, views)
        unfinished.write_bytes(written.getvalue())


def _fill(file: Any, demos: Sequence[Demonstration], views: str) -> None:
    """Write everything into an open HDF5 file."""
    first = demos[0]
    data = file.create_group("data")
    data.attrs["total"] = sum(len(demo.actions) for demo in demos)
    kwargs = {"action": "continuous", "reward": "score"}
    name = env_id(first.task, first.variant)
    data.attrs["env_args"] = json.dumps({"env_name": name, "type": GYM, "env_kwargs": kwargs})
    for number, demo in enumerate(demos):
        group = data.create_group(f"demo_{number}")
        group.attrs["num_samples"] = len(demo.actions)
        group.attrs["seed"] = str(demo.scene_seed)
        for key, rows in _columns(demo, views).items():
            group.create_dataset(key, data=rows, compression="gzip" if rows.dtype == np.uint8 else None)


def _columns(demo: Demonstration, views: str) -> dict[str, NDArray[Any]]:
    """Everything of an episode, by its key."""
    if VIEWS[views]:
        frames = list(see(demo, VIEWS[views], IMAGE_SIZE))
        seen = {f"{view}_image": np.array([pictures[view] for pictures in frames]) for view in VIEWS[views]}
    else:
        seen = {"state": np.asarray(observations(demo, "State"))}
    last = np.arange(len(demo.actions)) == len(demo.actions) - 1
    return {
        **{f"obs/{key}": rows[:-1] for key, rows in seen.items()},
        **{f"next_obs/{key}": rows[1:] for key, rows in seen.items()},
        "actions": to_vector(demo.actions),
        "rewards": np.where(last, demo.score, 0.0),
        "dones": last.astype(np.int64),
        "states": np.concatenate([demo.qpos, demo.qvel], axis=1)[:-1],
    }
