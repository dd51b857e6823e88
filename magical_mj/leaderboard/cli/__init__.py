"""The commands of the leaderboard, as `magical_mj.cli.app.COMMANDS` lists those of the core."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "verify": (
        "magical_mj.leaderboard.cli.entries:verify_folders",
        "Replay the episodes of an evaluation, and check that it is complete.",
    ),
    "submit": (
        "magical_mj.leaderboard.cli.entries:make_entry",
        "Pack the evaluations of one method into an entry for the leaderboard.",
    ),
    "leaderboard": (
        "magical_mj.leaderboard.cli.entries:make_leaderboard",
        "Check all entries in a folder, and write the leaderboard.",
    ),
}
