"""MAGICAL's environments for LeRobot's EnvHub: `make_env("USER/REPOSITORY", n_envs=4, trust_remote_code=True)`."""

from __future__ import annotations

from typing import Any

from magical_mj.integrations.lerobot import MagicalConfig


def make_env(n_envs: int = 1, use_async_envs: bool = False, cfg: Any = None) -> dict[str, dict[int, Any]]:
    """Creates the environments: task -> number of the variant -> vector environment with SAME_STEP autoreset.

    Args:
        n_envs: the number of environments in each vector.
        use_async_envs: whether each environment has its own process.
        cfg: a `MagicalConfig`, or another configuration with the attribute `task`: a comma-separated list of tasks, or
            "all". Without it, all tasks are created with the variant Demo.
    """
    if not isinstance(cfg, MagicalConfig):
        cfg = MagicalConfig(task=getattr(cfg, "task", None) or "all")
    return cfg.create_envs(n_envs, use_async_envs)
