"""The Gymnasium ids: ``magical_mj/<Task>-<Demo|TestX>[-<Preset>]-v0`` for all environments and presets.

Tasks that other packages announce have ids of the same form. Their modules are not imported at registration, since
they import this package. Therefore all eight variants get ids, and making one that the task lacks raises an error.
The ids of a task given as ``"package.module:SPEC"`` are registered when `env_id` is called with it.
"""

from __future__ import annotations

import itertools
from typing import Final

import gymnasium
from gymnasium.envs.registration import EnvSpec, WrapperSpec

from magical_mj.envs.presets import PRESETS, preset_named
from magical_mj.tasks import SUITES
from magical_mj.tasks.registry import (
    ENVIRONMENTS,
    VARIANTS,
    environment_axes,
    task_name,
    task_plugins,
    task_spec,
    variant_name,
)
from magical_mj.utils.errors import TaskError
from magical_mj.variants import variants_of


def env_id(task: str, variant: str = "Demo", preset: str = "") -> str:
    """The Gymnasium id of an environment, such as ``"magical_mj/FindDupe-TestShape-LoRes4E-v0"``.

    Args:
        task: a task's name, or ``"package.module:SPEC"``.
        variant: a variant that the task has.
        preset: one of `magical_mj.envs.presets.PRESETS`.

    Raises:
        UnknownNameError: if there is no such task, variant or preset, or the task does not have this variant.
        TaskError: if it is an invalid task of another package, or another task has its name.
    """
    environment_axes(task, variant)
    preset_named(preset)
    task = task_name(task)
    return _register(task, task_spec(task).name, variant_name(variant), preset, task_spec(task).horizon())


class SingleWrappers(tuple[WrapperSpec, ...]):
    """Wrappers of single environments, whose work the vector environment does by itself.

    `gymnasium.make_vec` refuses vector entry points of ids for which the length of this tuple is not 0. Nothing else
    looks at the length: `gymnasium.make` takes a slice.
    """

    __slots__ = ()

    def __len__(self) -> int:
        return 0


AT_THE_END: Final = SingleWrappers((WrapperSpec("ScoreAtTheEnd", "magical_mj.envs.wrappers:ScoreAtTheEnd", {}),))


def register_all() -> None:
    """Registers every environment that is not registered yet. `import magical_mj` calls it."""
    for (task, variant), preset in itertools.product(ENVIRONMENTS, PRESETS):
        _register(task, task, variant, preset, task_spec(task).horizon())
    for task, variant, preset in itertools.product(task_plugins(), VARIANTS, PRESETS):
        _register(task, task, variant, preset, None)
    _register_xmagical()


def suite_id(body: str, variant: str = "Demo", observation: str = "State", view: str = "Allo") -> str:
    """The id of SweepToTop in the suite xmagical, with these arguments of `magical_mj.envs.xmagical.XMagicalEnv`."""
    test = variant if variant == "Demo" else f"Test{variant.replace('Colour', 'Color')}"
    return f"magical_mj/SweepToTop-{body.capitalize()}-{observation}-{view}-{test}-v0"


def _register_xmagical() -> None:
    """Registers the 96 ids of the suite xmagical."""
    spec = SUITES["xmagical"]["SweepToTop"]
    for body, observation, view in itertools.product(spec.bodies, ("State", "Pixels"), ("Allo", "Ego")):
        for variant in variants_of(spec):
            id_ = suite_id(body, variant, observation, view)
            gymnasium.registry[id_] = EnvSpec(
                id_,
                entry_point="magical_mj.envs.xmagical:XMagicalEnv",
                vector_entry_point="magical_mj.envs.xmagical:make_suite_worlds",
                kwargs={"body": body, "variant": variant, "observation": observation, "view": view},
                max_episode_steps=spec.horizon("paper", body),
                additional_wrappers=AT_THE_END,
            )


def _register(task: str, name: str, variant: str, preset: str, steps: int | None) -> str:
    """Registers one environment if it is not registered yet, and returns its id. `steps` is None if not known yet."""
    test = variant if variant == "Demo" else f"Test{variant}"
    id_ = "-".join(filter(None, (f"magical_mj/{name}", test, preset, "v0")))
    registry = gymnasium.registry
    if id_ not in registry:  # `gymnasium.register` compares each with all others, which takes a tenth of the import
        registry[id_] = EnvSpec(
            id_,
            entry_point="magical_mj:MagicalEnv",
            vector_entry_point="magical_mj.envs.vector:make_worlds",
            kwargs={"task": task, "variant": variant, "preset": preset},
            max_episode_steps=steps,
            additional_wrappers=AT_THE_END,
        )
    elif (other := registry[id_].kwargs["task"]) != task:
        raise TaskError(f"{id_} is the id of {other}; give the task {task} another name than {name!r}")
    elif steps is not None:
        registry[id_].max_episode_steps = steps  # of a task that was edited and reloaded
    return id_
