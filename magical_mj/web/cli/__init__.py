"""The commands of the page, as `magical_mj.cli.app.COMMANDS` lists those of the core."""

from __future__ import annotations

from typing import Final

COMMANDS: Final = {
    "serve": ("magical_mj.web.cli.serve:serve", "Play in a browser."),
    "collect": ("magical_mj.web.cli.serve:collect", "Collect demonstrations of people who play in their browsers."),
    "guess": (
        "magical_mj.web.cli.guess:guess",
        "Play an intent after two demonstrations, before you see its sentence.",
    ),
    "inspect": ("magical_mj.web.cli.inspect:inspect", "Inspect a running scene or any MuJoCo model in a browser."),
}
