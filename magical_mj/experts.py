"""The scripted experts, and pictures of solved scenes."""

from magical_mj.policies.expert import (
    Expert,
    GoalPicture,
    expert_of,
)
from magical_mj.utils.imports import moved

__all__ = ["Expert", "GoalPicture", "expert_of"]

__getattr__ = moved("magical_mj.xmagical.expert", "Sweeper")
