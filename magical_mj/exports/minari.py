"""Exports demonstrations to Minari data sets, with minari's own storage. They are written completely or not at all."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np

from magical_mj.demos.demonstration import Demonstration, check_seeds, demonstrators, only_environment
from magical_mj.demos.learning import environment_of, observations, rewards
from magical_mj.protocol import PROTOCOL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError
from magical_mj.utils.extras import check_extra

HDF5_BYTES: Final = 32_000
"""The maximum number of bytes that HDF5 writes for each episode in addition to its arrays."""


def minari_name(demos: Sequence[Demonstration], preset: str, tag: str = "") -> str:
    """The default id of a Minari data set, such as ``magical-mj/FindDupe/Demo-expert-State-p1-v0``.

    It contains task, variant, demonstrators, preset and protocol. If there are shifts or another body, it contains them
    as well, as in ``magical-mj/FindDupe/Demo-clutter2-slip3-expert-State-p1-v0``. `tag` comes before the version.
    """
    task, variant = task_spec(demos[0].task).name, re.sub(r"[^\w.-]+", "-", demos[0].name.partition("-")[2])
    return f"magical-mj/{task}/{variant}-{'-'.join(demonstrators(demos))}-{preset or 'views'}-p{PROTOCOL}{tag}-v0"


def to_minari(
    demos: Sequence[Demonstration], name: str | None = None, preset: str = "State", *, overwrite: bool = False
) -> str:
    """Writes demonstrations of one environment as a Minari data set.

    Observations of the preset are stored as arrays, because Minari's JPEG is lossy and cannot store stacks. `infos`
    contains the exact positions and velocities. The reward is the score at the last step. The environment of
    `dataset.recover_environment()` has the same rewards. With an episode's seed, its `reset` starts in the episode's
    scene.

    Args:
        demos: demonstrations of one environment.
        name: the id. None: the id of `minari_name`.
        preset: the Gymnasium preset of the observations.
        overwrite: replace an existing data set with this id.

    Returns:
        The id.

    Raises:
        MissingExtraError: if minari is not installed.
        DemonstrationError: if the demonstrations are not of one environment, a scene's seed is 2**63 or larger, or the
            id is invalid.
        FileExistsError: if the data set exists.
    """
    environment, first = only_environment(demos), demos[0]
    check_seeds(demos)
    name = minari_name(demos, preset) if name is None else name
    path = dataset_path(name)
    episodes = [_episode(demo, number, preset) for number, demo in enumerate(demos)]
    makers = " and ".join(demonstrators(demos))
    versions = {f"magical-mj=={demo.package}" for demo in demos} | {f"mujoco=={demo.mujoco}" for demo in demos}
    about = {
        "algorithm_name": f"magical_mj {makers}",
        "description": f"{len(demos)} demonstrations of {environment} by the {makers} of magical_mj",
        "requirements": sorted(versions) if len(versions) == 2 else [],
    }
    made, kwargs = environment_of(first, preset, reward="score")
    with (
        closing(gymnasium.make(made, **kwargs)) as env,
        files.new_folder(path, overwrite=overwrite) as unfinished,
    ):
        _fill(unfinished, name, env, about, episodes)
    return name


def dataset_path(name: str) -> Path:
    """The folder of the data set with this id. Raises a `DemonstrationError` for an invalid id."""
    check_extra("exports to Minari", "minari")
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.storage import get_dataset_path

    try:
        parse_dataset_id(name)
    except (TypeError, ValueError):  # TypeError if the version is missing
        raise DemonstrationError(
            f"Minari does not accept the id {name!r}: it must be similar to magical-mj/mine-v0"
        ) from None
    return get_dataset_path(name)


def _size(data: Any) -> int:
    """The number of bytes of the arrays in nested dicts."""
    return sum(map(_size, data.values())) if isinstance(data, dict) else getattr(data, "nbytes", 0)


def _check_space(folder: Path, size: int) -> None:
    """Raises an `OSError` with the folder if `size` bytes do not fit on the disk. HDF5 would end the process."""
    if not hasattr(os, "posix_fallocate"):
        return
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(folder)) from None


def _fill(
    folder: Path, name: str, env: gymnasium.Env[Any, Any], about: dict[str, Any], episodes: list[dict[str, Any]]
) -> None:
    """Writes a data set into a new folder, and creates the namespace of its id."""
    import minari
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage
    from minari.namespace import create_namespace, list_local_namespaces

    namespace, _, _ = name.rpartition("/")
    if namespace and namespace not in list_local_namespaces():
        create_namespace(namespace)
    folder.mkdir()
    _check_space(folder, sum(HDF5_BYTES + _size(episode) for episode in [*episodes, {}, {}]))
    spec = env.spec
    storage = MinariStorage.new(folder / "data", env.observation_space, env.action_space, spec, jpeg_encoding=False)
    metadata: dict[str, Any] = {"dataset_id": name, "author": {"magical_mj"}, "minari_version": minari.__version__}
    storage.update_metadata({**metadata, **about, "eval_env_spec": spec.to_json() if spec else None})
    storage.update_episodes([EpisodeBuffer(**episode) for episode in episodes])


def _episode(demo: Demonstration, number: int, preset: str) -> dict[str, Any]:
    """The fields of Minari's episode buffer."""
    steps = len(demo.actions)
    return {
        "id": number,
        "seed": demo.scene_seed,
        "observations": observations(demo, preset),
        "actions": demo.actions if demo.actions.ndim == 2 else demo.actions.astype(np.int64),
        "rewards": rewards(demo),
        "terminations": np.zeros(steps, bool),
        "truncations": np.arange(steps) == steps - 1,
        "infos": {"qpos": demo.qpos, "qvel": demo.qvel},
    }
