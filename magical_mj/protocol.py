"""The protocol numbers of environments and demonstrations."""

from magical_mj.tasks.protocol import DEMONSTRATIONS, MUJOCO, PROTOCOL

__all__ = ["DEMONSTRATIONS", "MUJOCO", "PROTOCOL"]
