"""Scenes as plain data, with geometry, constants, actions and the state vector."""

from magical_mj.scene.scene import Block, Dynamics, GoalRegion, Pebble, Pose, Robot, Scene, check_scene_type

__all__ = ["Block", "Dynamics", "GoalRegion", "Pebble", "Pose", "Robot", "Scene", "check_scene_type"]
