"""The command of exports, as `magical_mj.cli.app.COMMANDS` lists those of the core."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "demos export": ("magical_mj.exports.cli.export:export_demos", "Export demonstrations for other tools."),
}
