"""The settings of `evaluate` that choose MuJoCo Warp as the simulator."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Final, Literal

import gymnasium
from gymnasium.vector import VectorEnv
from msgspec import Meta

from magical_mj.evaluation.base import BaseSettings
from magical_mj.scene.bodies import GRIPPER
from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.utils.extras import check_extra

Simulator = Literal["mujoco", "warp"]
DEVICE: Final = "cuda"
TOGETHER: Final = 100
"""The most episodes in one batch."""


@dataclass(frozen=True, kw_only=True)
class BatchedSettings(BaseSettings):
    """Settings for many episodes in one batch on an accelerator."""

    panel = "Batches on an accelerator"

    simulator: Annotated[
        Simulator,
        Meta(
            description="MuJoCo, or MuJoCo Warp (extra gpu): many episodes in one batch on DEVICE. Its scores are "
            "approximate and never official."
        ),
    ] = "mujoco"
    device: Annotated[str, Meta(description="The device of MuJoCo Warp: cuda, cuda:1 or cpu.")] = DEVICE

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.device != DEVICE and not self.batched:
            raise SettingsError(f"device {short_repr(self.device)} is only for MuJoCo Warp: give --simulator warp")
        if self.batched and (self.wrap or self.shifts or self.body != GRIPPER):
            raise SettingsError(
                "batched environments support no shifts, wrappers or other bodies: leave them out, or leave out "
                "--simulator warp"
            )

    @cached_property
    def batched(self) -> bool:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Whether MuJoCo Warp plays the episodes, in batches."""
        return self.simulator == "warp"

    @property
    def worlds(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The simulator's name in files."""
        return "batched" if self.batched else super().worlds

    @property
    def side_by_side(self) -> int:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The most episodes in one batch."""
        return TOGETHER if self.batched else super().side_by_side

    def check_extras(self) -> None:
        """Raises a `MissingExtraError` unless everything that the settings need is installed."""
        super().check_extras()
        if self.batched:
            check_extra("batched environments", "gpu")

    def vector_env(
        self, task: str, variant: str, number: int, shifts: str, instruction: bool
    ) -> VectorEnv[Any, Any, Any]:
        """The vector environment of MuJoCo Warp, or of MuJoCo."""
        if not self.batched:
            return super().vector_env(task, variant, number, shifts, instruction)
        from magical_mj import batched  # imported late: it needs PyTorch
        from magical_mj.batched.environment import Arrays

        envs = batched.make(
            task,
            variant,
            number,
            preset=self.observed,
            device=self.device,
            rules=self.rules,
            autoreset_mode=gymnasium.vector.AutoresetMode.DISABLED,
        )
        return Arrays(envs)
