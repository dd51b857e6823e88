"""Scenes as plain data, with geometry, bodies and constants."""

from magical_mj.scene.scene import (
    Block,
    Dynamics,
    GoalRegion,
    Pebble,
    Pose,
    Robot,
    Scene,
    check_same_objects,
    check_scene_type,
)

__all__ = [
    "Block",
    "Dynamics",
    "GoalRegion",
    "Pebble",
    "Pose",
    "Robot",
    "Scene",
    "check_same_objects",
    "check_scene_type",
]
