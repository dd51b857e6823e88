"""Many environments on one accelerator: MuJoCo Warp simulates them, numba draws them, and all data are tensors.

The package is made for learning. It computes in single precision, so its episodes agree statistically with those of
`magical_mj.load`, not digit by digit. `magical_mj.evaluate` gives the official results.

Example:
    >>> env = magical_mj.batched.make("MoveToRegion", "Demo", num_envs=1024, device="cuda", seed=0)
    >>> observations, info = env.reset()  # (1024, 96, 96, 12) uint8, on the device
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from gymnasium.vector import AutoresetMode

from magical_mj.shifts.registry import Shifts
from magical_mj.tasks.registry import given_environments, task_spec
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
    shifts: Shifts = None,
) -> BatchedEnv:
    """A vector environment whose environments are all simulated on one device.

    Args:
        task: a task, or several (as a sequence or separated by commas) for batches of several tasks.
        variant: a variant, or several. The environments alternate between the existing pairs of task and variant, task
            by task in the given order; a name that is given twice counts twice. `tasks` and `variants` of the result
            are those of each environment.
        num_envs: the number of environments, at least one for each pair.
        preset: the preset of the observations, one of `magical_mj.envs.presets.PRESETS`.
        device: "cuda", "cuda:1" or "cpu" (slow, for tests).
        seed: determines the sampled scenes if `reset` is given no seed.
        image_size: side of the pictures in pixels; None means the preset's.
        rules: "paper" or "released".
        reward: "none", or "score" for the score as reward at the last step.
        autoreset_mode: `gymnasium.vector.AutoresetMode.SAME_STEP` or `DISABLED`.
        workers: processes that sample scenes in advance. 0 samples a scene when it is needed, in half a millisecond,
            with shifts in two.
        shifts: shifts of the pictures and their strengths, such as ``"camera:3,light:2"``. The values of an episode
            are those of its seed, as in single environments.

    Raises:
        MissingExtraError: if the extra `gpu` is not installed.
        InvalidSeedError: if the seed is not an integer, or negative.
        SettingsError: if the device does not exist, a setting is invalid, or a task's score depends on the scenes of
            all steps.
        UnknownNameError: if the task, variant or preset does not exist.
    """
    check_extra("batched environments", "gpu")
    from magical_mj.batched.environment import BatchedEnv

    for name, value, least in (("num_envs", num_envs, 1), ("workers", workers, 0)):
        if as_integer(value, least) is None:
            raise SettingsError(f"{name} must be an integer of at least {least}, not {short_repr(value)}")
    pairs = given_environments(task, variant)
    for name, _ in pairs:
        if task_spec(name).trajectory:
            raise SettingsError(
                f"batched environments do not store the scenes of all steps, but the score of {name} depends on them; "
                "use gymnasium.make or make_vec"
            )
    if num_envs < len(pairs):
        raise SettingsError(
            f"num_envs={num_envs} must be at least {len(pairs)}, one environment for each task and variant"
        )
    return BatchedEnv(
        [pairs[env % len(pairs)] for env in range(num_envs)],
        preset=preset,
        device=device,
        seed=seed,
        image_size=image_size,
        rules=rules,
        reward=reward,
        autoreset_mode=autoreset_mode,
        workers=workers,
        shifts=shifts,
    )
