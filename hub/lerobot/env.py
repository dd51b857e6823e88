"""MAGICAL's environments for LeRobot's EnvHub: `make_env("USER/REPOSITORY", n_envs=4, trust_remote_code=True)`."""

from __future__ import annotations

from typing import Any

from magical_mj.integrations.lerobot import MagicalConfig


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None) -> dict[str, dict[int, Any]]:
    """Suite (the task) -> number of the variant -> vector of environments, which start anew in the step that ends.

    Args:
        n_envs: the environments in each vector.
        use_async_envs: whether each has a process of its own.
        cfg: a `MagicalConfig`, or another configuration of LeRobot's, of which `task` counts: a comma list of tasks,
            or "all". Without one all tasks are made, in the scene of the demonstrations.
    """
    if not isinstance(cfg, MagicalConfig):
        cfg = MagicalConfig(task=getattr(cfg, "task", None) or "all")
    return cfg.create_envs(n_envs, use_async_envs)
