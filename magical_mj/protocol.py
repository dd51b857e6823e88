"""The protocol numbers of environments, demonstrations and intents."""

from magical_mj.tasks.protocol import DEMONSTRATIONS, INTENTS, MUJOCO, PROTOCOL

__all__ = ["DEMONSTRATIONS", "INTENTS", "MUJOCO", "PROTOCOL"]
