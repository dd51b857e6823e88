"""The scripted experts, and pictures of solved scenes."""

from magical_mj.policies.expert import (
    Expert,
    GoalPicture,
    Sweeper,
    expert_of,
)

__all__ = ["Expert", "GoalPicture", "Sweeper", "expert_of"]
