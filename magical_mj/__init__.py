"""The MAGICAL benchmark for robust imitation (Toyer et al., NeurIPS 2020) on MuJoCo.

A table of tasks and test variants (`magical_mj.ENVIRONMENTS`): through dm_env with `load`, through Gymnasium with
``gymnasium.make("magical_mj/FindDupe-Demo-LoRes4E-v0")``, and as MJCF files with `export_mjcf`.
"""

from __future__ import annotations

import signal
import sys
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

if (PurePath(sys.argv[0]).stem == "magical-mj" or ("-m" in sys.argv[:1] and "magical_mj" in sys.orig_argv)) and (
    signal.getsignal(signal.SIGINT) is signal.default_int_handler
):  # Ctrl-C ends the command without a traceback, even while its modules are imported; `magical_mj.cli` takes it over
    signal.signal(signal.SIGINT, signal.SIG_DFL)

from magical_mj._version import __version__
from magical_mj.envs.registration import env_id, register_all
from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene, actions
from magical_mj.scene import state_vector as observations
from magical_mj.tasks import protocol
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS, sample_scene, score

if TYPE_CHECKING:
    from magical_mj import batched, demos, evaluation, shifts
    from magical_mj.engine import Engine
    from magical_mj.engine.export import export_mjcf
    from magical_mj.envs import wrappers
    from magical_mj.envs.composer import Environment, load, load_scene
    from magical_mj.envs.gymnasium_env import MagicalEnv
    from magical_mj.envs.vector import make_vec
    from magical_mj.evaluation import evaluate
    from magical_mj.policies import expert as experts

_LAZY = {  # loaded at first use, so that listing tasks and sampling scenes start no simulator
    "Engine": "engine",
    "Environment": "envs.composer",
    "MagicalEnv": "envs.gymnasium_env",
    "load": "envs.composer",
    "load_scene": "envs.composer",
    "make_vec": "envs.vector",
    "evaluate": "evaluation",
    "export_mjcf": "engine.export",
}

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


_LAZY_MODULES = {
    "batched": "batched",
    "demos": "demos",
    "evaluation": "evaluation",
    "experts": "policies.expert",
    "shifts": "shifts",
    "wrappers": "envs.wrappers",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY and name not in _LAZY_MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    if name in _LAZY_MODULES:
        return import_module(f"{__name__}.{_LAZY_MODULES[name]}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)


def __dir__() -> list[str]:
    """Public names that are loaded at first use are there, too."""
    return sorted({*globals(), *__all__})


register_all()
