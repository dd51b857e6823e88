"""The Gymnasium ids: ``magical_mj/<Task>-<Demo|TestX>[-<Preset>]-v0`` for all environments and presets.

Tasks of installed plug-ins have ids of the same form. Their modules import this package, so registration cannot import
them. Therefore all eight variants get ids, and making a variant that the task does not have raises an error. The ids of
a task given as ``"package.module:SPEC"`` are registered when `env_id` is called with it.

Suites register their own ids: see `magical_mj.tasks.suites`.
"""

from __future__ import annotations

import itertools
import zlib
from typing import Final

import gymnasium
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.tasks.registry import (
    ENVIRONMENTS,
    VARIANTS,
    environment_axes,
    task_name,
    task_plugins,
    task_spec,
    variant_name,
)
from magical_mj.tasks.suites import suites
from magical_mj.utils.errors import TaskError


def env_id(task: str, variant: str = "Demo", preset: str = "") -> str:
    """The Gymnasium id of an environment, such as ``"magical_mj/FindDupe-TestShape-LoRes4E-v0"``.

    Args:
        task: a task's name, or ``"package.module:SPEC"``.
        variant: a variant of the task.
        preset: one of `magical_mj.envs.presets.PRESETS`.

    Raises:
        UnknownNameError: if the task, variant or preset does not exist, or the task does not have this variant.
        TaskError: if a task of another package is invalid, or another task has its name.
    """
    environment_axes(task, variant)
    preset_named(preset)
    task, spec = task_name(task), task_spec(task)
    name = spec.name
    if spec.further_demos:  # tasks with other numbers of demo scenes have the same name
        name += f"D{zlib.crc32(task.encode()):08x}"
    return _register(task, name, variant_name(variant), preset, spec.horizon())


class SingleWrappers(tuple[WrapperSpec, ...]):
    """Wrappers that `gymnasium.make` applies to single environments. The vector environment does not need them.

    `gymnasium.make_vec` refuses a vector entry point if the length of this tuple is not 0. `gymnasium.make` does not
    read the length: it takes a slice.
    """

    __slots__ = ()

    def __len__(self) -> int:
        return 0


AT_THE_END: Final = SingleWrappers((WrapperSpec("ScoreAtTheEnd", "magical_mj.wrappers:ScoreAtTheEnd", {}),))


def register_all() -> None:
    """Registers all environments that are not registered yet. `import magical_mj` calls this function."""
    for (task, variant), preset in itertools.product(ENVIRONMENTS, PRESETS):
        _register(task, task, variant, preset, task_spec(task).horizon())
    for task, variant, preset in itertools.product(task_plugins(), VARIANTS, PRESETS):
        _register(task, task, variant, preset, None)
    for suite in suites().values():
        suite.register()


def _register(task: str, name: str, variant: str, preset: str, steps: int | None) -> str:
    """Registers an environment if it is not registered yet, and returns its id. `steps` is None if it is unknown."""
    test = variant if variant == "Demo" else f"Test{variant}"
    id_ = "-".join(filter(None, (f"magical_mj/{name}", test, preset, "v0")))
    registry = gymnasium.registry
    if id_ not in registry:  # `gymnasium.register` compares each id with all others: a tenth of the import time
        registry[id_] = EnvSpec(
            id_,
            entry_point="magical_mj:MagicalEnv",
            vector_entry_point="magical_mj.envs.vector:make_vector",
            kwargs={"task": task, "variant": variant, "preset": preset},
            max_episode_steps=steps,
            additional_wrappers=AT_THE_END,
        )
    elif (other := registry[id_].kwargs["task"]) != task:
        raise TaskError(f"{id_} is already the id of {other}: rename the task {task}, whose name is {name!r}")
    elif steps is not None:
        registry[id_].max_episode_steps = steps  # the task may have been edited and reloaded
    return id_
