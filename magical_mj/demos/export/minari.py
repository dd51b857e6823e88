"""Demonstrations as Minari data sets, written by minari itself, completely or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np

from magical_mj.demos.demonstration import Demonstration, check_seeds, demonstrators, only_environment
from magical_mj.demos.learning import observations
from magical_mj.envs.registration import env_id
from magical_mj.tasks.protocol import PROTOCOL
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError
from magical_mj.utils.extras import missing_extra

NAMESPACE: Final = "namespace_metadata.json"
"""The file that Minari writes into each folder of data sets."""
HDF5_BYTES: Final = 32_000
"""What HDF5 writes for each episode besides its arrays, at most."""


def minari_name(demos: Sequence[Demonstration], preset: str) -> str:
    """The id of a Minari data set of demonstrations, such as ``magical-mj/FindDupe/Demo-expert-State-p1-v0``.

    It names all demonstrators, the preset of the observations and the number of the protocol, here 1.
    """
    task, variant = task_spec(demos[0].task).name, demos[0].variant
    return f"magical-mj/{task}/{variant}-{'-'.join(demonstrators(demos))}-{preset or 'views'}-p{PROTOCOL}-v0"


def to_minari(
    demos: Sequence[Demonstration],
    name: str | None = None,
    preset: str = "State",
    *,
    overwrite: bool = False,
) -> str:
    """Makes a Minari data set of demonstrations of one environment.

    The observations are those of the preset; `infos` holds the exact positions and velocities. The reward is the
    score at the last step. The environment that `dataset.recover_environment()` makes has the same rewards, and its
    `reset(seed=episode's seed)` starts in the episode's scene.

    Args:
        demos: demonstrations of one environment.
        name: the id; None: `minari_name`.
        preset: the Gymnasium preset of the observations.
        overwrite: replace an existing data set with this id.

    Returns:
        The id.

    Raises:
        MissingExtraError: if minari is not installed.
        DemonstrationError: if the demonstrations are not of one environment, a scene's seed is 2**63 or more, the id is
            invalid, or the data set exists already.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
        from minari.dataset.minari_dataset import parse_dataset_id
        from minari.storage import get_dataset_path
    except ModuleNotFoundError:
        raise missing_extra("exporting to Minari", "minari") from None
    environment, first = only_environment(demos), demos[0]
    check_seeds(demos)
    name = minari_name(demos, preset) if name is None else name
    who = " and ".join(demonstrators(demos))
    versions = {f"magical-mj=={demo.package}" for demo in demos} | {f"mujoco=={demo.mujoco}" for demo in demos}
    try:
        parse_dataset_id(name)
    except (TypeError, ValueError):  # TypeError if the version is missing
        raise DemonstrationError(
            f"Minari does not take the id {name!r}, which must be like magical-mj/mine-v0"
        ) from None
    episodes = [_episode(demo, number, preset) for number, demo in enumerate(demos)]
    _check_space(get_dataset_path(), sum(HDF5_BYTES + _size(episode) for episode in [*episodes, {}, {}]))
    made = gymnasium.make(env_id(first.task, first.variant, preset), reward="score")
    with closing(made) as env, warnings.catch_warnings(), _new_folder(get_dataset_path(name), overwrite):
        warnings.filterwarnings("ignore", module="minari")  # it asks for optional metadata
        minari.create_dataset_from_buffers(
            dataset_id=name,
            buffer=[EpisodeBuffer(**episode) for episode in episodes],
            env=env,
            eval_env=env,
            algorithm_name=f"magical_mj {who}",
            author="magical_mj",
            description=f"{len(demos)} demonstrations of {environment} by the {who} of magical_mj",
            requirements=sorted(versions) if len(versions) == 2 else [],
            jpeg_encoding=False,
        )
    return name


def check_new(name: str) -> None:
    """Raises a `DemonstrationError` if there is a data set of this id, and a `MissingExtraError` without minari."""
    try:
        from minari.storage import get_dataset_path
    except ModuleNotFoundError:
        raise missing_extra("exporting to Minari", "minari") from None
    _check_new(get_dataset_path(name))


def _check_new(path: Path) -> None:
    if path.exists():
        raise DemonstrationError(f"there is a data set {path} already; give it another id, or overwrite it (--force)")


def _size(data: Any) -> int:
    """The number of bytes of the arrays in nested dicts."""
    return sum(map(_size, data.values())) if isinstance(data, dict) else getattr(data, "nbytes", 0)


def _check_space(folder: Path, size: int) -> None:
    """Raises an `OSError` that names the folder if there is no space for `size` bytes: HDF5 would end the process."""
    if not hasattr(os, "posix_fallocate"):
        return
    with tempfile.TemporaryFile(dir=folder) as file:
        try:
            os.posix_fallocate(file.fileno(), 0, size)
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(folder)) from None


@contextmanager
def _new_folder(path: Path, overwrite: bool) -> Iterator[None]:
    """For a block that makes a folder. If the block raises, or its process dies, the previous content is restored.

    Other processes that make folders beside it wait.
    """
    missing = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        with files.locked(path.parent):
            old, new, discarded = (path.with_name(f".{path.name}.{what}") for what in ("old", "new", "discarded"))
            _restore(path, old, new, discarded)
            if not overwrite:
                _check_new(path)
            if path.exists():
                path.rename(old)
            else:
                new.mkdir()
            try:
                yield
            except BaseException:
                _restore(path, old, new, discarded)
                raise
            if old.exists():
                old.rename(discarded)  # from here on, the new content counts
            _remove(new, discarded)
    except BaseException:
        for folder in missing:
            _remove_unused(folder)
        raise


def _restore(path: Path, old: Path, new: Path, discarded: Path) -> None:
    """Restores a folder that was not completed: `old` is its previous content, and `new` says that there was none."""
    _remove(discarded)
    if old.exists() or new.exists():
        _remove(path)
    if old.exists():
        old.rename(path)
    _remove(new)


def _remove(*folders: Path) -> None:
    for folder in folders:
        shutil.rmtree(folder, ignore_errors=True)


def _remove_unused(folder: Path) -> None:
    """Removes a folder of Minari's unless it holds a data set or a folder, which another process may have made."""
    with suppress(OSError):
        if {path.name for path in folder.iterdir()} <= {NAMESPACE}:
            (folder / NAMESPACE).unlink(missing_ok=True)
            folder.rmdir()


def _episode(demo: Demonstration, number: int, preset: str) -> dict[str, Any]:
    """The fields of Minari's buffer."""
    steps = len(demo.actions)
    rewards = np.zeros(steps)
    rewards[-1] = demo.score
    last = np.arange(steps) == steps - 1
    return {
        "id": number,
        "seed": demo.scene_seed,
        "observations": observations(demo, preset),
        "actions": demo.actions.astype(np.int64),
        "rewards": rewards,
        "terminations": np.zeros(steps, bool),
        "truncations": last,
        "infos": {"qpos": demo.qpos, "qvel": demo.qvel},
    }
