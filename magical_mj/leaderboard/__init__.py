"""The leaderboard: results are verified by replaying episodes, packed into entries with a hash, and put into tables."""

from __future__ import annotations

from magical_mj.leaderboard.check import Findings, check_entry, verify
from magical_mj.leaderboard.entry import Entry
from magical_mj.leaderboard.submission import submit

__all__ = ["Entry", "Findings", "check_entry", "submit", "verify"]
