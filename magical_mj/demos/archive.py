"""Exports demonstrations to a numpy archive of transitions."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from magical_mj.demos.demonstration import Demonstration, check_seeds, checked
from magical_mj.demos.learning import stream
from magical_mj.tasks.registry import task_spec
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError


def to_npz(
    demos: Iterable[Demonstration],
    path: Path | str,
    preset: str = "LoRes4E",
    *,
    drop_noop: bool = True,
    overwrite: bool = False,
) -> None:
    """Writes transitions as one numpy archive without pickles.

    Arrays with a row for each transition: `observations`, `actions`, `episodes` (the number of the episode) and `steps`
    (the number of the step in the episode, from 0). Presets with dict observations have several arrays, such as
    `observations_ego`.

    Arrays with a row for each episode: `tasks`, `sentences` (the goal in English), `variants`, `bodies`, `shifts` (such
    as "clutter:3", or ""), `seeds` (of the scenes), `demonstrators`, `lengths` (in steps) and `scores`. The environment
    of an episode is ``gymnasium.make(magical_mj.env_id(task, variant, preset), body=body, shifts=shifts)``.

    Args:
        demos: demonstrations of any environments.
        path: the file. A missing folder is created.
        preset: the Gymnasium preset of the observations.
        drop_noop: leave out the transitions with the no-op action.
        overwrite: replace an existing file.

    Raises:
        DemonstrationError: if `demos` is empty, a scene's seed is 2**63 or larger, or their observations or actions
            have different shapes, such as those of different bodies.
        FileExistsError: if the file exists.
    """
    demos, path = list(checked(demos)), files.to_path(path)
    if not demos:
        raise DemonstrationError("no demonstrations were given: give at least one")
    check_seeds(demos)
    path.parent.mkdir(parents=True, exist_ok=True)
    episodes: list[dict[str, Any]] = []
    with files.new_file(path, overwrite=overwrite) as unfinished:
        for number, (demo, part) in enumerate(zip(demos, stream(demos, preset, drop_noop=drop_noop), strict=True)):
            views = part.observations if isinstance(part.observations, dict) else {"": part.observations}
            steps = np.flatnonzero(demo.acts) if drop_noop else np.arange(len(demo.actions))
            columns = {
                **{f"observations_{view}".rstrip("_"): pictures for view, pictures in views.items()},
                "actions": part.actions,
                "episodes": np.full(len(steps), number),
                "steps": steps,
                "tasks": [demo.task],
                "sentences": [task_spec(demo.task).instruction],
                "variants": [demo.variant],
                "bodies": [demo.scene.robot.body],
                "shifts": [demo.shifts],
                "seeds": [demo.scene_seed],
                "demonstrators": [demo.demonstrator],
                "lengths": [len(demo.actions)],
                "scores": [demo.score],
            }
            episodes.append(columns)
        with unfinished.open("wb") as file:
            for name in episodes[0]:
                if len({np.shape(episode[name])[1:] for episode in episodes}) > 1:
                    raise DemonstrationError(
                        "these demonstrations are of several bodies: write an archive for each body"
                    )
            joined = {name: np.concatenate([episode[name] for episode in episodes]) for name in episodes[0]}
            np.savez_compressed(file, allow_pickle=False, **joined)
