"""The MAGICAL benchmark for robust imitation (Toyer et al., NeurIPS 2020) on MuJoCo.

`magical_mj.ENVIRONMENTS` lists the environments: pairs of a task and a test variant. They are available through dm_env
with `load`, through Gymnasium with ``gymnasium.make("magical_mj/FindDupe-Demo-LoRes4E-v0")``, and as MJCF files with
`export_mjcf`. Importing this package registers the Gymnasium environments.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from magical_mj import actions, observations, protocol, shifts
from magical_mj._version import __version__
from magical_mj.envs.registration import env_id, register_all
from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, sample_scene, score, score_trajectory

if TYPE_CHECKING:
    from magical_mj import batched, datasets, demos, evaluation, experts, intents, wrappers
    from magical_mj.engine import Engine
    from magical_mj.engine.export import export_mjcf
    from magical_mj.envs.composer import Environment, load, load_scene
    from magical_mj.envs.gymnasium_env import MagicalEnv
    from magical_mj.envs.vector import make_vec
    from magical_mj.evaluation import evaluate

__all__ = [
    "ENVIRONMENTS",
    "TASKS",
    "VARIANTS",
    "Block",
    "Dynamics",
    "Engine",
    "Environment",
    "GoalRegion",
    "MagicalEnv",
    "Robot",
    "Scene",
    "__version__",
    "actions",
    "batched",
    "datasets",
    "demos",
    "env_id",
    "evaluate",
    "evaluation",
    "experts",
    "export_mjcf",
    "intents",
    "load",
    "load_scene",
    "make_vec",
    "observations",
    "protocol",
    "sample_scene",
    "score",
    "score_trajectory",
    "shifts",
    "wrappers",
]

register_all()


_MODULES: Final = ("batched", "datasets", "demos", "evaluation", "experts", "intents", "wrappers")
_NAMES: Final = {
    "Engine": "engine",
    "Environment": "envs.composer",
    "MagicalEnv": "envs.gymnasium_env",
    "evaluate": "evaluation",
    "export_mjcf": "engine.export",
    "load": "envs.composer",
    "load_scene": "envs.composer",
    "make_vec": "envs.vector",
}


def __getattr__(name: str) -> Any:
    """Imports names that need the simulator at first use.

    With an invalid MUJOCO_GL, `import mujoco` fails. All other names of this package still work.
    """
    if name in _MODULES:
        return import_module(f"{__name__}.{name}")
    if name in _NAMES:
        globals()[name] = found = getattr(import_module(f"{__name__}.{_NAMES[name]}"), name)  # for the next uses
        return found
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
