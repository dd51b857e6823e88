"""Exports demonstrations to HDF5 files that robomimic's `SequenceDataset` reads.

They contain single frames of 96 px, because robomimic stacks frames itself. Actions are vectors (drive, turn, grip),
including no-ops.
"""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import to_vector
from magical_mj.demos.demonstration import Demonstration, only_environment
from magical_mj.demos.learning import environment_of, observations, rewards
from magical_mj.demos.recording import render_demo
from magical_mj.exports.lerobot import IMAGE_SIZE, VIEWS
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, check_name
from magical_mj.utils.extras import check_extra

GYM: Final = 2
"""robomimic's type number of Gym environments. Its own wrapper imports the old `gym`, so rollouts need another one."""


def to_robomimic(
    demos: Sequence[Demonstration], path: Path | str, *, views: str = "ego", overwrite: bool = False
) -> None:
    """Writes demonstrations of one environment as a robomimic data set.

    Each demonstration is a group ``data/demo_0``, ``data/demo_1`` and so on:

    - ``obs`` and ``next_obs``: ``ego_image`` and ``allo_image`` (uint8, height x width x channels), or ``state``.
    - ``actions``: drive, turn, grip, float32.
    - ``rewards``: the score at the last step, otherwise 0.
    - ``dones``: 1 at the last step, otherwise 0.
    - ``states``: the exact positions and velocities.

    ``env_args`` names the Gymnasium environment with the same observations: the state, or a dict with the key "ego" for
    ``ego_image``. Its ``reset(seed=...)`` with a demonstration's ``seed`` starts in the demonstration's scene.

    Args:
        demos: demonstrations of one environment.
        path: the file. A missing folder is created.
        views: the choice of observations, one of `VIEWS`.
        overwrite: replace an existing file.

    Raises:
        MissingExtraError: if h5py is not installed.
        UnknownNameError: for an unknown choice of views.
        DemonstrationError: if the demonstrations are not of one environment, or their actions are speeds.
        FileExistsError: if the file exists.
    """
    check_extra("exports to robomimic", "robomimic")
    import h5py

    check_name("choice of views", views, VIEWS)
    only_environment(demos)
    if task_spec(demos[0].task).speeds:
        raise DemonstrationError(
            "exports to robomimic need demonstrations with the 18 actions: for speeds, export to minari, lerobot or "
            "webdataset"
        )
    path = files.to_path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    seen = {"image_size": IMAGE_SIZE} if VIEWS[views] else {}
    env, kwargs = environment_of(demos[0], "" if VIEWS[views] else "State", **seen, action="continuous", reward="score")
    content = io.BytesIO()  # not directly into the file, because HDF5 ends the process if the disk is full
    with files.new_file(path, overwrite=overwrite) as unfinished:
        with h5py.File(content, "w") as file:
            data = file.create_group("data")
            data.attrs["total"] = sum(len(demo.actions) for demo in demos)
            data.attrs["env_args"] = json.dumps({"env_name": env, "type": GYM, "env_kwargs": kwargs})
            for number, demo in enumerate(demos):
                group = data.create_group(f"demo_{number}")
                group.attrs["num_samples"] = len(demo.actions)
                group.attrs["seed"] = str(demo.scene_seed)
                for key, rows in _columns(demo, views).items():
                    group.create_dataset(key, data=rows, compression="gzip" if rows.dtype == np.uint8 else None)
        unfinished.write_bytes(content.getvalue())


def _columns(demo: Demonstration, views: str) -> dict[str, NDArray[Any]]:
    """The arrays of an episode by key."""
    if VIEWS[views]:
        frames = list(render_demo(demo, VIEWS[views], IMAGE_SIZE))
        parts = {f"{view}_image": np.array([pictures[view] for pictures in frames]) for view in VIEWS[views]}
    else:
        parts = {"state": np.asarray(observations(demo, "State"))}
    last = np.arange(len(demo.actions)) == len(demo.actions) - 1
    return {
        **{f"obs/{key}": rows[:-1] for key, rows in parts.items()},
        **{f"next_obs/{key}": rows[1:] for key, rows in parts.items()},
        "actions": to_vector(demo.actions),
        "rewards": rewards(demo),
        "dones": last.astype(np.int64),
        "states": np.concatenate([demo.qpos, demo.qvel], axis=1)[:-1],
    }
