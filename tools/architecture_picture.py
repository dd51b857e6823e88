"""Draws docs/architecture.png: the folders of the core as layers, the lowest at the bottom.

python -m tools.architecture_picture
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

from tests.test_architecture import CORE

OUT = Path(__file__).parents[1] / "docs" / "architecture.png"
CONTENT: Final = {
    "utils": "errors, files, imports, settings, processes",
    "scene": "Scene, geometry, actions, state vector",
    "variants": "which scenes a variant has",
    "tasks": "goals: scene, rules, score, plan",
    "assets": "MJCF models of scenes, and their look",
    "rendering": "pictures, by OpenGL or in software",
    "shifts": "changes of any environment",
    "engine": "one simulation: step, score, states",
    "envs": "Gymnasium and dm_env",
    "experts": "planners that know the true state",
    "policies": "interface, agents, model files",
    "demos": "demonstrations: files, replay, export",
    "evaluation": "episodes by the protocol, and reports",
    "cli": "the command magical-mj",
}
ROWS: Final = (
    ("utils",),
    ("scene",),
    ("variants", "tasks"),
    ("assets", "rendering"),
    ("shifts", "engine"),
    ("envs",),
    ("experts", "policies", "demos"),
    ("evaluation", "cli"),
)
KINDS: Final = {  # colour and name of groups of rows
    range(3): ("#e9f5ec", "plain data and pure functions"),
    range(3, 6): ("#eef4fa", "simulation"),
    range(6, 8): ("#fdf3e3", "agents and results"),
}
INK, LINE = "#1f2d3d", "#9fb3c8"


def draw() -> Figure:
    """A figure with a box for each folder that describes its content."""
    figure = Figure(figsize=(10, 5.3), layout="constrained")
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
    assert [folder for row in ROWS for folder in row] == list(CORE)  # noqa: S101
    draw().savefig(OUT, dpi=110)
