"""The Gymnasium ids: ``magical_mj/<Task>-<Demo|TestX>[-<Preset>]-v0`` for all environments and presets."""

from __future__ import annotations

import gymnasium

from magical_mj.presets import PRESETS
from magical_mj.registry import ENVIRONMENTS


def env_id(task: str, variant: str = "Demo", preset: str = "") -> str:
    """The Gymnasium id of an environment, such as ``"magical_mj/FindDupe-TestShape-LoRes4E-v0"``."""
    test = variant if variant == "Demo" else f"Test{variant}"
    return "-".join(filter(None, (f"magical_mj/{task}", test, preset, "v0")))


def register_all() -> None:
    """Registers every environment that is not registered yet. Importing `magical_mj` does this."""
    for task, variant in ENVIRONMENTS:
        for preset in PRESETS:
            name = env_id(task, variant, preset)
            if name not in gymnasium.registry:
                gymnasium.register(
                    name,
                    entry_point="magical_mj:MagicalEnv",
                    kwargs={"task": task, "variant": variant, "preset": preset},
                )
