"""Wrappers of the Gymnasium environments."""

from magical_mj.envs.wrappers import ContinuousActions, ScoreAtTheEnd

__all__ = ["ContinuousActions", "ScoreAtTheEnd"]
