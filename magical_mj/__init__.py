"""The MAGICAL benchmark for robust imitation (Toyer et al., NeurIPS 2020) on MuJoCo.

A table of tasks and test variants (`magical_mj.ENVIRONMENTS`): through dm_env with `load`, through Gymnasium with
``gymnasium.make("magical_mj/FindDupe-Demo-LoRes4E-v0")``, and as MJCF files with `export_mjcf`.
"""

from __future__ import annotations

import sys
from importlib import import_module

from magical_mj._version import __version__

TYPE_CHECKING = False  # typing takes half of this package's time to import
if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from typing import Any

    from magical_mj import batched, demos, evaluation, shifts
    from magical_mj.demos import datasets
    from magical_mj.engine import Engine
    from magical_mj.engine.export import export_mjcf
    from magical_mj.envs import wrappers
    from magical_mj.envs.composer import Environment, load, load_scene
    from magical_mj.envs.gymnasium_env import MagicalEnv
    from magical_mj.envs.registration import env_id
    from magical_mj.envs.vector import make_vec
    from magical_mj.evaluation import evaluate
    from magical_mj.policies import expert as experts
    from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene, actions
    from magical_mj.scene import state_vector as observations
    from magical_mj.tasks import protocol
    from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, sample_scene, score

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
    "load",
    "load_scene",
    "make_vec",
    "observations",
    "protocol",
    "sample_scene",
    "score",
    "shifts",
    "wrappers",
]


_NAMES = {  # loaded at first use, so that help and the listing of tasks start no simulator
    **dict.fromkeys(("ENVIRONMENTS", "TASKS", "VARIANTS", "sample_scene", "score"), "tasks.registry"),
    **dict.fromkeys(("Block", "Dynamics", "GoalRegion", "Robot", "Scene"), "scene"),
    **dict.fromkeys(("Environment", "load", "load_scene"), "envs.composer"),
    "Engine": "engine",
    "MagicalEnv": "envs.gymnasium_env",
    "env_id": "envs.registration",
    "evaluate": "evaluation",
    "export_mjcf": "engine.export",
    "make_vec": "envs.vector",
}
_MODULES = {
    "actions": "scene.actions",
    "batched": "batched",
    "datasets": "demos.datasets",
    "demos": "demos",
    "evaluation": "evaluation",
    "experts": "policies.expert",
    "observations": "scene.state_vector",
    "protocol": "tasks.protocol",
    "shifts": "shifts",
    "wrappers": "envs.wrappers",
}
_FOLDERS = {  # with these modules of theirs, which are there without another import
    "envs": "envs.registration",
    **dict.fromkeys(("scene", "tasks", "utils", "variants"), "tasks.registry"),
}


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        value = import_module(f"{__name__}.{_MODULES[name]}")
    elif name in _NAMES:
        value = getattr(import_module(f"{__name__}.{_NAMES[name]}"), name)
    elif name in _FOLDERS:
        import_module(f"{__name__}.{_FOLDERS[name]}")
        value = sys.modules[f"{__name__}.{name}"]
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names that are loaded at first use are there, too."""
    return sorted({*globals(), *__all__})


class _Registering:
    """Registers the environments as soon as gymnasium is imported, which takes ten times as long as this package.

    No `importlib.abc.MetaPathFinder`: its import took a third of this package's time (15 ms, once, and 10 without).
    """

    def find_spec(self, name: str, *where: Any) -> ModuleSpec | None:
        """The place of gymnasium, with a loader that registers the environments when it has loaded it."""
        if name != "gymnasium":
            return None
        others = (finder.find_spec(name, *where) for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, others), None)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_register(module: Any) -> None:
                execute(module)
                _register()

            spec.loader.exec_module = execute_and_register
        return spec


def _register() -> None:
    import_module("magical_mj.envs.registration")


if "gymnasium" in sys.modules:
    _register()
else:
    sys.meta_path.insert(0, _Registering())
