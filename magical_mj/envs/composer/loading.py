"""How environments are loaded: by the name of a task, or from a scene."""

from __future__ import annotations

import secrets
from collections.abc import Sequence

from magical_mj.engine.settings import EnvironmentSettings
from magical_mj.envs.composer.environment import Environment
from magical_mj.scene import Scene
from magical_mj.scene.state_vector import VIEWS
from magical_mj.tasks.registry import task_spec
from magical_mj.tasks.spec import Reward, Rules
from magical_mj.variants import check_seed


def load(
    task: str,
    variant: str = "Demo",
    *,
    seed: int | None = None,
    scene: Scene | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
    reward: Reward = "none",
    rules: Rules = "paper",
) -> Environment:
    """A dm_env environment of the benchmark.

    Args:
        task: one of `magical_mj.TASKS`, a task that a package announces, or ``"package.module:SPEC"``.
        variant: one of `magical_mj.VARIANTS` that the task has.
        seed: the first episode starts in `sample_scene(task, variant, seed)`, the following ones in scenes
            drawn from a generator with this seed. None: seeded from the system's entropy.
        scene: start every episode in this scene instead.
        observations: any of "ego", "allo" and "state".
        image_size: side of the pictures in pixels.
        reward: "none" (always 0: the benchmark has no reward) or "score" (the score, at the last step).
        rules: "paper", or "released" for the scores and horizons of the original's released code.

    Raises:
        UnknownNameError: for an unknown task, variant, observation, reward or rules, or an unsupported pair.
        TaskError: if the task of another package is invalid.
        InvalidSceneError: if the scene is illegal or not one of the task.
        InvalidSeedError, SettingsError: for a bad seed; for a bad image size or list of observations.
    """
    task_spec(task)  # None, too, is no task
    return _loaded(EnvironmentSettings(task, variant, scene, observations, image_size, reward, rules), seed)


def load_scene(
    scene: Scene,
    *,
    seed: int | None = None,
    observations: Sequence[str] = VIEWS,
    image_size: int = 96,
) -> Environment:
    """A dm_env environment that starts every episode in `scene`: no task, so no score and no horizon.

    Raises:
        UnknownNameError, InvalidSceneError, InvalidSeedError, SettingsError: as `load`.
    """
    return _loaded(EnvironmentSettings(None, "Demo", scene, observations, image_size, "none", "paper"), seed)


def _loaded(settings: EnvironmentSettings, seed: int | None) -> Environment:
    seed = secrets.randbits(63) if seed is None else check_seed(seed)
    env = Environment(settings, settings.sample(seed), seed)
    if settings.scene is None:
        env.task.seed = env.task.next_seed = seed
    return env
