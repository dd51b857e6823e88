"""The 18 actions, as numbers, as names and as vectors."""

from magical_mj.scene.actions import (
    ACTIONS,
    NOOP,
    THRESHOLD,
    Action,
    Drive,
    Gripper,
    Turn,
    action_number,
    to_discrete,
    to_vector,
)

__all__ = [
    "ACTIONS",
    "NOOP",
    "THRESHOLD",
    "Action",
    "Drive",
    "Gripper",
    "Turn",
    "action_number",
    "to_discrete",
    "to_vector",
]
