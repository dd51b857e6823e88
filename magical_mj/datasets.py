"""Data sets with one call: the demonstrations of a task in the format of a library.

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
from magical_mj.demos.learning import observations
from magical_mj.demos.shipped import DemonstrationSet, of_demo_scene, set_suffix
from magical_mj.exports.formats import default_target, digest_tag, make_data_set
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, SettingsError, check_name

__all__ = ["FORMATS", "Format", "load", "make_env_and_datasets"]

Format = Literal["npz", "minari", "lerobot", "webdataset"]
FORMATS: Final = ("npz", "minari", "lerobot", "webdataset")
VALIDATED: Final = 5
"""One in this number of demonstrations is used for validation."""


def load(
    task: str,
    to: Format = "npz",
    folder: Path | str = "datasets",
    *,
    preset: str | None = None,
    set: DemonstrationSet = 1,  # noqa: A002 - the same name as in `magical_mj.demos.load`
) -> Any:
    """The data set of a task's demonstrations. It is written if it does not exist.

    Its name contains a digest of the demonstrations, so that it is never the data set of others.

    For other demonstrations and more options, use `magical-mj demos export`.

    Args:
        task: the task.
        to: the format: "npz" (without no-op actions), "minari", "lerobot" or "webdataset".
        folder: the folder of data sets. Minari uses its own folder instead.
        preset: the preset of the observations. None: "State" for Minari, otherwise "LoRes4E".
        set: 1, 2 or "graded"; see `magical_mj.demos.load`.

    Returns:
        For npz the arrays by name, for minari and lerobot the library's data set, for webdataset the archive's path.

    Raises:
        UnknownNameError: for an unknown task, format or preset.
        DemonstrationError: if the task has no demonstrations.
        MissingExtraError, MagicalError: if the library is not installed.
    """
    check_name("format of data sets", to, FORMATS)
    if preset is None:
        preset = "State" if to == "minari" else "LoRes4E"
    demos = demonstrations.load(task, set=set)
    target = default_target(to, only_environment(demos) + set_suffix(set), demos, preset, tag=digest_tag(demos))
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
            from magical_mj.exports.folders import ARCHIVE

            return Path(target) / ARCHIVE


Arrays = dict[str, NDArray[Any]]


def _are_numbers(space: gymnasium.Space[Any], rows: NDArray[Any]) -> bool:
    """Whether both the space and the actions are action numbers. Their integer types may differ."""
    return isinstance(space, gymnasium.spaces.Discrete) and rows.ndim == 1 and rows.dtype.kind in "iu"


def make_env_and_datasets(name: str, **options: Any) -> tuple[gymnasium.Env[Any, Any], Arrays, Arrays]:
    """An environment, and the task's demonstrations as training and validation data.

    Every fifth demonstration is for validation.

    Args:
        name: a Gymnasium id of this package with observations that are one array.
        options: further arguments of `gymnasium.make`.

    Returns:
        The environment, the training data and the validation data. The data are the arrays `observations`, `actions`,
        `next_observations`, `terminals` and `truncations`, with a row for each step. As in the environment, the last
        step of an episode is truncated, and none is terminal. All demonstrations are in the task's demo scene, for
        every variant.

    Raises:
        SettingsError: for other ids, for dict observations, for shifts, and if the environment's observations or
            actions differ from those of the demonstrations. Pictures of both are by the same renderer.
        DemonstrationError: if the task has fewer than five demonstrations of the demo scene with the body in `options`.
    """
    kwargs = gymnasium.spec(name).kwargs
    if not {"task", "preset"} <= kwargs.keys():
        raise SettingsError(f"{name} is not the id of a task's environment, such as magical_mj/FindDupe-Demo-State-v0")
    env = gymnasium.make(name, **options)
    if not isinstance(env.observation_space, gymnasium.spaces.Box):
        raise SettingsError(f"the observations of {name} are not one array: choose an id with LoRes... or State")
    ours: Any = env.unwrapped
    if ours.engine.shifts:
        env.close()
        raise SettingsError("the demonstrations are without shifts: leave out shifts, or make that environment alone")
    every = demonstrations.load(kwargs["task"], body=ours.engine.setup.body)
    demos = of_demo_scene(every, f"that come with {kwargs['task']}")
    if len(demos) < VALIDATED:
        raise DemonstrationError(
            f"{kwargs['task']} has {len(demos)} demonstrations, but this needs {VALIDATED} or more"
        )
    parts = [demos[number::VALIDATED] for number in range(VALIDATED)]
    training = [demo for part in parts[:-1] for demo in part]
    how = kwargs["preset"], ours.engine.renderer
    first = _arrays(demos[:1], *how)
    for space, key in ((env.observation_space, "observations"), (env.action_space, "actions")):
        rows = first[key]
        if (space.shape, space.dtype) != (rows.shape[1:], rows.dtype) and not _are_numbers(space, rows):
            env.close()
            raise SettingsError(
                f"the {key} of this environment are {space}, but those of the demonstrations are {rows.dtype} of shape "
                f"{rows.shape[1:]}: leave out the options that change them"
            )
    return env, _arrays(training, *how), _arrays(parts[-1], *how)


def _arrays(demos: Sequence[Demonstration], preset: str, renderer: str | None) -> Arrays:
    rows = [np.asarray(observations(demo, preset, renderer)) for demo in demos]
    return {
        "observations": np.concatenate([part[:-1] for part in rows]),
        "next_observations": np.concatenate([part[1:] for part in rows]),
        "actions": np.concatenate([demo.actions for demo in demos]),
        "terminals": np.concatenate([np.zeros(len(demo.actions), bool) for demo in demos]),
        "truncations": np.concatenate([np.arange(len(demo.actions)) == len(demo.actions) - 1 for demo in demos]),
    }
