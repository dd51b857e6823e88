"""Worlds by the hundred on one accelerator: physics by MuJoCo Warp, pictures by a kernel of ours, tensors all the way.

Arithmetic is in single precision, so episodes are statistically like those of `magical_mj.load`, not digit by digit:
made for learning. Official results come from `magical_mj.evaluate`.

Example:
    >>> env = magical_mj.batched.make("MoveToRegion", "Demo", num_envs=1024, device="cuda", seed=0)
    >>> observations, info = env.reset()  # (1024, 96, 96, 12) uint8, on the device
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gymnasium.vector import AutoresetMode

from magical_mj.tasks.registry import environments, task_spec
from magical_mj.tasks.spec import Reward, Rules
from magical_mj.utils.errors import SettingsError, as_integer, short_repr
from magical_mj.utils.extras import check_extra

if TYPE_CHECKING:
    from magical_mj.batched.environment import BatchedEnv

__all__ = ["make"]


def make(
    task: str | Sequence[str],
    variant: str | Sequence[str] = "Demo",
    num_envs: int = 256,
    *,
    preset: str = "LoRes4E",
    device: str = "cuda",
    seed: int = 0,
    image_size: int | None = None,
    rules: Rules = "paper",
    reward: Reward = "none",
    autoreset_mode: AutoresetMode = AutoresetMode.SAME_STEP,
    workers: int = 0,
) -> BatchedEnv:
    """A vector environment of many worlds on one device.

    Args:
        task: a task, or several (as a sequence or separated by commas) for batches of several tasks.
        variant: a variant, or several; the worlds take turns among all pairs that exist.
        num_envs: how many worlds, at least one for each pair.
        preset: of the observations; one of `magical_mj.envs.presets.PRESETS`.
        device: "cuda", "cuda:1" or "cpu" (slow; for tests).
        seed: of the scenes that are sampled when `reset` is given no seed.
        image_size: side of the pictures in pixels, instead of the preset's.
        rules: "paper" or "released".
        reward: "none", or "score" for the score as reward at the last step.
        autoreset_mode: `gymnasium.vector.AutoresetMode.SAME_STEP` or `DISABLED` of it.
        workers: processes that sample scenes ahead; 0 samples them when they are needed, half a millisecond each.

    Raises:
        MissingExtraError: if the extra `gpu` is not installed.
        InvalidSeedError: if the seed is not an integer, or negative.
        SettingsError: if there is no such device, or a setting is not possible; for tasks whose score depends on the
            scenes of all steps.
        UnknownNameError: if there is no such task, variant or preset.
    """
    check_extra("batched worlds", "gpu")
    from magical_mj.batched.environment import BatchedEnv

    for name, value, least in (("num_envs", num_envs, 1), ("workers", workers, 0)):
        if as_integer(value, least) is None:
            raise SettingsError(f"{name} must be an integer of at least {least}, not {short_repr(value)}")
    pairs = environments(task, variant)
    if whole := [name for name in dict.fromkeys(name for name, _ in pairs) if task_spec(name).trajectory]:
        raise SettingsError(
            f"batched worlds do not keep the scenes of all steps, on which the score of {whole[0]} depends; "
            "use gymnasium.make or make_vec"
        )
    if num_envs < len(pairs):
        raise SettingsError(f"these are {len(pairs)} environments, for which num_envs={num_envs} is too few")
    return BatchedEnv(
        [pairs[world % len(pairs)] for world in range(num_envs)],
        preset=preset,
        device=device,
        seed=seed,
        image_size=image_size,
        rules=rules,
        reward=reward,
        autoreset_mode=autoreset_mode,
        workers=workers,
    )
