"""Scripted experts that solve every environment from the privileged state.

An expert reads the true state of the simulation, tries manoeuvres on a copy of it, and acts with the same 18 actions as
every other agent.
"""

from __future__ import annotations

from magical_mj.policies.expert.planner import Expert

__all__ = ["Expert"]
