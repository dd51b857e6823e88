"""Transitions of demonstrations as one numpy archive, for any learner."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from magical_mj.demos.demonstration import Demonstration, check_seeds
from magical_mj.demos.learning import stream
from magical_mj.scene.actions import NOOP
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

    Arrays with a row for each transition: `observations` (for presets with several parts, one for each, such as
    `observations_ego`), `actions`, `episodes` (the number of the episode) and `steps` (the number of the step in it,
    from 0). Arrays with a row for each episode: `tasks`, `variants`, `seeds` (of the scenes), `demonstrators`,
    `lengths` (in steps) and `scores`.

    Args:
        demos: demonstrations of any environments.
        path: the file.
        preset: the Gymnasium preset of the observations.
        drop_noop: leave out the transitions with the no-op action.
        overwrite: replace an existing file.

    Raises:
        DemonstrationError: if there are no demonstrations, or a scene's seed is 2**63 or more.
        FileExistsError: if the file exists.
    """
    demos = list(demos)
    if not demos:
        raise DemonstrationError("there are no demonstrations to write")
    check_seeds(demos)
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    columns: dict[str, list[Any]] = {}

    def add(**values: Any) -> None:
        for name, value in values.items():
            columns.setdefault(name, []).append(value)

    with files.new_file(path, overwrite=overwrite) as unfinished:
        for number, (demo, part) in enumerate(zip(demos, stream(demos, preset, drop_noop=drop_noop), strict=True)):
            seen = part.observations if isinstance(part.observations, dict) else {"": part.observations}
            add(**{f"observations_{view}".rstrip("_"): rows for view, rows in seen.items()})
            steps = np.flatnonzero(demo.actions != NOOP) if drop_noop else np.arange(len(demo.actions))
            add(actions=part.actions, episodes=np.full(len(steps), number), steps=steps)
            add(tasks=[demo.task], variants=[demo.variant], seeds=[demo.scene_seed])
            add(demonstrators=[demo.demonstrator], lengths=[len(demo.actions)], scores=[demo.score])
        with unfinished.open("wb") as file:
            joined = {name: np.concatenate(rows) for name, rows in columns.items()}
            np.savez_compressed(file, allow_pickle=False, **joined)
