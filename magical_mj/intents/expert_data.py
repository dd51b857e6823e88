"""Data sets of many intents: demonstrations by the expert, each with its intent.

The actions are stored in a file, so each demonstration is made once, and interrupted work continues. States and
observations are computed by a replay when a demonstration is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos import stored
from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.learning import stream
from magical_mj.demos.recording import ATTEMPTS, STRIDE
from magical_mj.demos.stored import Stored, Watch
from magical_mj.engine import Engine
from magical_mj.envs.presets import preset_named
from magical_mj.experts import Expert
from magical_mj.intents.intent import Intent
from magical_mj.intents.names import SETS
from magical_mj.intents.tasks import PREFIX, task_of
from magical_mj.policies.interface import Observations
from magical_mj.scene import Scene
from magical_mj.tasks.languages import canonical_name
from magical_mj.tasks.registry import SPLITS, VARIANTS, Names, listed, listed_tasks, variant_name
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError
from magical_mj.utils.settings import Count, fitting

FILE: Final = "demonstrations.jsonl"
"""The name of the file in a user's folder."""


class Example(NamedTuple):
    """A demonstration of an intent."""

    intent: Intent
    demonstration: Demonstration
    observations: Observations
    """The preset's observation before each action: shape (steps, ...)."""
    actions: NDArray[Any]
    """Numbers, shape (steps,)."""


@dataclass(frozen=True)
class Dataset(Sequence[Example]):
    """Demonstrations of intents, in the order of the intents. Reading one replays it.

    Attributes:
        stored: the actions.
        path: the file of the actions.
        preset: the preset of the observations.
        renderer: the renderer of pictures, as in `magical_mj.Engine`.
    """

    stored: tuple[Stored, ...]
    path: Path
    preset: str
    renderer: str | None = None

    def __len__(self) -> int:
        return len(self.stored)

    @overload
    def __getitem__(self, index: int) -> Example: ...
    @overload
    def __getitem__(self, index: slice) -> Dataset: ...
    def __getitem__(self, index: int | slice) -> Example | Dataset:
        """A demonstration, or for a slice a data set.

        Raises:
            DemonstrationError: if it was stored by another version of this package.
        """
        if isinstance(index, slice):
            return Dataset(self.stored[index], self.path, self.preset, self.renderer)
        demo = self.demonstration(index)
        (played,) = stream([demo], self.preset, drop_noop=False, renderer=self.renderer)
        return Example(task_of(demo.task.removeprefix(PREFIX)).intent, demo, *played)

    def demonstration(self, index: int) -> Demonstration:
        """A demonstration without observations."""
        return self.stored[index].verified(self.path)


def dataset(
    intents: Names = "train",
    per_intent: int = 5,
    preset: str = "State",
    *,
    scenes: int | None = None,
    variants: Names = "Demo",
    folder: Path | str | None = None,
    jobs: int | None = None,
    renderer: str | None = None,
    watch: Watch = lambda _, __: None,
) -> Dataset:
    """Demonstrations of sets of intents. The expert makes those that are not stored yet.

    They do not depend on the machine. Test scenes are not among their scenes.

    Args:
        intents: sets of `magical_mj.intents.SETS`, or intents, as a list or separated by commas.
        per_intent: the number of demonstrations of each intent in each variant.
        preset: the Gymnasium preset of the observations.
        scenes: the number of demo scenes in the variant Demo, 1 to 8; None: as the intent's text says, by default one.
        variants: the variants.
        folder: the folder of the stored actions; None: the user's cache folder. A larger data set adds to its file.
        jobs: the number of processes; None: one per core.
        renderer: the renderer of pictures, as in `magical_mj.Engine`.
        watch: called with the number of finished demonstrations, and their total number.

    Raises:
        IntentError: if a text is not an intent, or there are too many scenes.
        UnknownNameError: for an unknown variant or preset.
        SettingsError: if a number is out of range.
        DemonstrationError: if some demonstrations could not be made. All others are stored.
    """
    preset_named(preset)
    number, first = fitting("per_intent", per_intent, Count), SPLITS["dev"]
    chosen = [variant_name(variant) for variant in listed(variants, VARIANTS)]
    tasks = listed_tasks([f"{PREFIX}{name.removeprefix(PREFIX)}" for name in listed(intents, SETS)])
    path = stored.default_path() if folder is None else files.to_path(folder) / FILE
    names = [with_scenes(task, None if scenes is None else fitting("scenes", scenes, Count)) for task in tasks]
    keys = [(name, variant, first + k) for name in names for variant in chosen for k in range(number)]
    return Dataset(tuple(stored.complete(keys, path, jobs=jobs, watch=watch)), path, preset, renderer)


def with_scenes(task: str, scenes: int | None = None, *, contrasting: bool = False) -> str:
    """The name of an intent's task with this number of demo scenes; None: that of the task.

    Raises:
        IntentError: if there are too many scenes, or `contrasting` is given with only one.
    """
    own = task_of(task.removeprefix(PREFIX))
    changed = replace(own, demos=scenes or own.demos, contrasting=contrasting or own.contrasting)
    return canonical_name(f"{PREFIX}{changed}")


def frames_of(intent: Intent, start: Scene, seed: int, between: int) -> tuple[Scene, ...]:
    """The first and the last scene of an expert's episode, and some scenes in between at equal intervals.

    Args:
        intent: the intent, which the expert satisfies.
        start: the episode's first scene.
        seed: the expert's seed.
        between: the number of scenes in between.

    Raises:
        DemonstrationError: if no expert satisfies the intent.
    """
    task = f"{PREFIX}{intent}"
    with closing(Engine(task, scene=start)) as engine:
        for attempt in range(ATTEMPTS):
            engine.reset(scene=start)
            expert, scenes = Expert(engine, task, seed + attempt * STRIDE), [start]
            while not engine.step(expert()):
                scenes.append(engine.scene)
            scenes.append(engine.scene)
            if engine.score() == 1.0:
                chosen = np.linspace(0, len(scenes) - 1, between + 2).round().astype(int)
                return tuple(scenes[index] for index in chosen)
    raise DemonstrationError(f"{ATTEMPTS} experts tried the intent {intent} in a scene, but none satisfied it")
