"""Results that others can rely on: every episode is replayed, entries are hashed, and tables are made of both."""

from __future__ import annotations

from magical_mj.leaderboard.check import Findings, check_entry, verify
from magical_mj.leaderboard.entry import Entry, submit

__all__ = ["Entry", "Findings", "check_entry", "submit", "verify"]
