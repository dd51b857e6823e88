"""The leaderboard: verification of results by replaying episodes, entries with a hash, and tables."""

from __future__ import annotations

from magical_mj.leaderboard.check import Findings, check_entries, verify
from magical_mj.leaderboard.entry import Entry, read_entry
from magical_mj.leaderboard.submission import submit

__all__ = ["Entry", "Findings", "check_entries", "read_entry", "submit", "verify"]
