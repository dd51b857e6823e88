"""Draws docs/architecture.png: the folders of the package as layers, the lowest at the bottom.

python -m tools.architecture_picture
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from tests.test_architecture import LAYERS

OUT = Path(__file__).parents[1] / "docs" / "architecture.png"
CONTENT: Final = {
    "utils": "errors, files, imports, settings, parallel work",
    "scene": "Scene, geometry, bodies, constants",
    "variants": "the scenes of a variant",
    "tasks": "demo scene, rules, score, plan; registry",
    "intents": "a language of goals, and their rivals",
    "shifts": "changes of any environment, with strengths 0 to 5",
    "assets": "MJCF models of scenes, and their look",
    "rendering": "pictures by OpenGL or in software",
    "engine": "one MuJoCo simulation: steps, score, saved states, export",
    "envs": "interfaces: Gymnasium, dm_env",
    "xmagical": "x-magical's suite",
    "batched": "many environments on one accelerator",
    "experts": "planners that know the true state",
    "policies": "interface, agents, loading of model files",
    "demos": "demonstrations: files, replay, export",
    "evaluation": "rollouts by the protocol, and reports",
    "leaderboard": "entries, which are replayed",
    "learners": "BC, GAIL, WGAIL-GP, AL",
    "web": "playing in a browser",
    "integrations": "plug-ins for other tools",
    "cli": "the command magical-mj",
}
ROWS: Final = (
    ("utils",),
    ("scene",),
    ("variants", "tasks", "intents"),
    ("assets", "rendering"),
    ("shifts",),
    ("engine",),
    ("envs", "batched", "xmagical"),
    ("experts", "policies", "demos"),
    ("evaluation", "leaderboard"),
    ("learners", "web", "integrations", "cli"),
)
KINDS: Final = {  # colour and name of groups of rows
    range(3): ("#e9f5ec", "plain data and pure functions"),
    range(3, 7): ("#eef4fa", "simulation"),
    range(7, 9): ("#fdf3e3", "agents and results"),
    range(9, 10): ("#f4eef8", "applications"),
}
INK, LINE = "#1f2d3d", "#9fb3c8"


def draw() -> Figure:
    """A figure with a box for each folder that describes its content."""
    figure = Figure(figsize=(10, 6.6), layout="constrained")
    axes = figure.subplots()
    axes.set(xlim=(0, 4.75), ylim=(0, len(ROWS)))
    axes.axis("off")
    for rows, (fill, kind) in KINDS.items():
        axes.text(
            4.72, sum(rows) / len(rows) + 0.5, kind.replace(" and ", "\nand "), ha="right", va="center", color=INK
        )
        for height in rows:
            for column, folder in enumerate(ROWS[height]):
                width = 4 / len(ROWS[height])
                box = (column * width + 0.04, height + 0.1), width - 0.08, 0.78
                axes.add_patch(FancyBboxPatch(*box, boxstyle="round,pad=0.01", facecolor=fill, edgecolor=LINE))
                centre = (column + 0.5) * width
                axes.text(centre, height + 0.62, folder, ha="center", va="center", weight="bold", color=INK)
                axes.text(centre, height + 0.34, CONTENT[folder], ha="center", va="center", size=7.5, color=INK)
    return figure


if __name__ == "__main__":
    assert [folder for row in ROWS for folder in row] == list(LAYERS)  # noqa: S101
    draw().savefig(OUT, dpi=110)
