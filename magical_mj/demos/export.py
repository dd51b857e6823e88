"""Demonstrations for other tools: plain numpy archives, and Minari data sets."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.learning import observations, stream
from magical_mj.errors import DemonstrationError
from magical_mj.extras import missing_extra
from magical_mj.registration import env_id

if TYPE_CHECKING:
    from minari import MinariDataset


def to_npz(demos: Iterable[Demonstration], path: Path, preset: str = "LoRes4E", *, drop_noop: bool = True) -> None:
    """Write transitions as one numpy archive: observations, actions, and the number of the episode of each row.

    With a preset of several views there is one array for each: ``observations_ego`` and so on.

    Raises:
        FileExistsError: if the file exists.
    """
    if path.exists():
        raise FileExistsError(f"{path} exists already")
    parts = list(stream(demos, preset, drop_noop=drop_noop))
    if not parts:
        raise DemonstrationError("there are no demonstrations to write")
    columns: dict[str, list[np.ndarray]] = {}
    for number, part in enumerate(parts):
        seen = part.observations
        named = {f"observations_{view}": rows for view, rows in seen.items()} if isinstance(seen, dict) else None
        for name, rows in (named or {"observations": seen}).items():
            columns.setdefault(name, []).append(np.asarray(rows))
        columns.setdefault("actions", []).append(part.actions)
        columns.setdefault("episodes", []).append(np.full(len(part.actions), number))
    with path.open("xb") as file:
        np.savez_compressed(file, allow_pickle=False, **{name: np.concatenate(rows) for name, rows in columns.items()})


def to_minari(
    demos: Sequence[Demonstration], name: str | None = None, preset: str = "State", author: str = "magical_mj"
) -> MinariDataset:
    """Make a Minari data set of demonstrations of one environment, bit by bit.

    The observations are those of the preset; `infos` holds the exact positions and velocities. The reward is the
    score, at the last step. `dataset.recover_environment()` makes the environment, and `reset(seed=episode's seed)`
    gives the episode's scene.

    Args:
        demos: demonstrations of one environment.
        name: the id; by default ``magical-mj/<Task>/expert-v0``, with the variant's name in it if it is not Demo.
        preset: the Gymnasium preset that gives the observations.
        author: who made them.

    Raises:
        MissingExtraError: if minari is not installed.
        DemonstrationError: if the demonstrations are not of one environment.
        ValueError: Minari's own, if there is such a data set already.
    """
    try:
        import minari
        from minari.data_collector import EpisodeBuffer
    except ModuleNotFoundError:
        raise missing_extra("exporting to Minari", "minari") from None
    names = {demo.name for demo in demos}
    if len(names) != 1:
        raise DemonstrationError(f"a data set holds demonstrations of one environment, not of {sorted(names)}")
    first = demos[0]
    variant = "" if first.variant == "Demo" else f"{first.variant.lower()}-"
    environment = env_id(first.task, first.variant, preset)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", module="minari")  # wants an e-mail address, a link, a score to compare with
        return minari.create_dataset_from_buffers(
            dataset_id=name or f"magical-mj/{first.task}/{variant}{first.demonstrator}-v0",
            buffer=[EpisodeBuffer(**_episode(demo, number, preset)) for number, demo in enumerate(demos)],
            env=environment,
            eval_env=environment,
            algorithm_name=f"magical_mj {first.demonstrator}",
            author=author,
            description=f"{len(demos)} demonstrations of {first.name} by the {first.demonstrator} of magical_mj",
            requirements=[f"magical-mj=={first.package}", f"mujoco=={first.mujoco}"],
            jpeg_encoding=False,
        )


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
