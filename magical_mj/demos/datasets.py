"""Data sets in one call: the demonstrations of a task in the form that a tool reads.

Example:
    >>> data = magical_mj.datasets.load("FindDupe", to="npz", preset="State")  # name -> array
    >>> env, training, validation = magical_mj.datasets.make_env_and_datasets("magical_mj/FindDupe-Demo-State-v0")
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from magical_mj import demos as demonstrations
from magical_mj.demos.demonstration import Demonstration, only_environment
from magical_mj.demos.export import default_target, make_data_set
from magical_mj.demos.learning import observations
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils import files
from magical_mj.utils.errors import SettingsError, check_name

__all__ = ["FORMATS", "Format", "load", "make_env_and_datasets"]

Format = Literal["npz", "minari", "lerobot", "webdataset"]
FORMATS: Final = ("npz", "minari", "lerobot", "webdataset")
VALIDATED: Final = 5
"""One episode of so many is for validation."""


def load(task: str, to: Format = "npz", folder: Path | str = "datasets", *, preset: str | None = None) -> Any:
    """The data set of a task's demonstrations, made if it is not there yet.

    Other demonstrations, and more options, go through `magical-mj demos export`.

    Args:
        task: the task.
        to: "npz" (without the steps of no-ops), "minari", "lerobot" or "webdataset".
        folder: where data sets are made and looked for; Minari has a place of its own.
        preset: the observations; None: "State" for Minari, otherwise "LoRes4E".

    Returns:
        For npz the arrays by name, for minari and lerobot the library's data set, for webdataset the archive's path.

    Raises:
        UnknownNameError: if there is no such task, format or preset.
        DemonstrationError: if there are no demonstrations of the task.
        MissingExtraError, MagicalError: if the library is not installed.
    """
    check_name("format of data sets", to, FORMATS)
    preset = preset if preset is not None else "State" if to == "minari" else "LoRes4E"
    demos = demonstrations.load(task)
    target = default_target(to, only_environment(demos), demos, preset)
    if to != "minari":
        target = str(files.to_path(folder) / target)
    with contextlib.suppress(FileExistsError):
        make_data_set(to, demos, target, preset)
    match to:
        case "npz":
            with np.load(target, allow_pickle=False) as archive:
                return dict(archive)
        case "minari":
            import minari

            return minari.load_dataset(target)
        case "lerobot":
            from lerobot.datasets.lerobot_dataset import LeRobotDataset  # pyright: ignore[reportMissingImports]

            return LeRobotDataset(target, root=target)
        case _:
            from magical_mj.demos.export.folders import ARCHIVE

            return Path(target) / ARCHIVE


Arrays = dict[str, NDArray[Any]]


def _counts(space: gymnasium.Space[Any], rows: NDArray[Any]) -> bool:
    """Whether both are numbers of actions, of whatever type of integers."""
    return isinstance(space, gymnasium.spaces.Discrete) and rows.ndim == 1 and rows.dtype.kind in "iu"


def make_env_and_datasets(name: str, **options: Any) -> tuple[gymnasium.Env[Any, Any], Arrays, Arrays]:
    """An environment with the task's demonstrations for training and for validation, every fifth episode.

    Args:
        name: a Gymnasium id of this package, whose observations are one array.
        options: as for `gymnasium.make`.

    Returns:
        The environment, and twice the arrays `observations`, `actions`, `next_observations` and `terminals`, with a row
        for each step. The demonstrations are those of the task, all in the demo scene, whatever the id's variant is.

    Raises:
        SettingsError: if it is another id, the observations have several parts, or the demonstrations have no such
            observations or actions as the environment.
        DemonstrationError: if there are none with the body of the options.
    """
    kwargs = gymnasium.spec(name).kwargs
    if not {"task", "preset"} <= kwargs.keys():
        raise SettingsError(f"{name} is not the id of a task's environment, such as magical_mj/FindDupe-Demo-State-v0")
    env = gymnasium.make(name, **options)
    if not isinstance(env.observation_space, gymnasium.spaces.Box):
        raise SettingsError(
            f"{name} has observations with several parts: take an id with one of the presets LoRes, State"
        )
    demos = demonstrations.load(kwargs["task"], body=options.get("body", GRIPPER))
    parts = [demos[number::VALIDATED] for number in range(VALIDATED)]
    training = [demo for part in parts[:-1] for demo in part]
    first = _arrays(demos[:1], kwargs["preset"])
    for space, key in ((env.observation_space, "observations"), (env.action_space, "actions")):
        rows = first[key]
        if (space.shape, space.dtype) != (rows.shape[1:], rows.dtype) and not _counts(space, rows):
            env.close()
            raise SettingsError(
                f"the {key} of this environment are {space}, and those of the demonstrations {rows.dtype} of shape "
                f"{rows.shape[1:]}: leave out the options that change them"
            )
    return env, _arrays(training, kwargs["preset"]), _arrays(parts[-1], kwargs["preset"])


def _arrays(demos: Sequence[Demonstration], preset: str) -> Arrays:
    rows = [np.asarray(observations(demo, preset)) for demo in demos]
    return {
        "observations": np.concatenate([part[:-1] for part in rows]),
        "next_observations": np.concatenate([part[1:] for part in rows]),
        "actions": np.concatenate([demo.actions for demo in demos]),
        "terminals": np.concatenate([np.arange(len(demo.actions)) == len(demo.actions) - 1 for demo in demos]),
    }
