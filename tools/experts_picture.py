"""Draws docs/experts.png: frames of the first shipped demonstration of each task. `make docs` runs this."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont

import magical_mj
from magical_mj.cli.film import INK

PICTURE: Final = Path(__file__).parent.parent / "docs" / "experts.png"
SIZE: Final = 112  # the side of a frame in pixels
FRAMES: Final = 8
GAP: Final = 4  # pixels
LINE: Final = 24  # the height of a task's name in pixels


def strip(demo: magical_mj.demos.Demonstration) -> np.ndarray:
    """Frames at equal intervals, side by side, from the start to the end of the last action that is not a no-op."""
    end = int(np.flatnonzero(demo.actions)[-1]) + 1
    wanted = set(np.linspace(0, end, FRAMES).astype(int).tolist())
    drawn = enumerate(magical_mj.demos.render_demo(demo, size=SIZE))
    frames = [pictures["allo"] for step, pictures in drawn if step in wanted]
    return np.concatenate(
        [np.pad(frame, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for frame in frames], axis=1
    )


def label(task: str, width: int) -> np.ndarray:
    """A picture of the task's name, for the space above its row."""
    line = Image.new("RGB", (width, LINE), "white")
    ImageDraw.Draw(line).text((GAP, LINE - GAP), task, INK, ImageFont.load_default(14), anchor="ls")
    return np.asarray(line)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    tasks = [task for task in magical_mj.TASKS if task != "MoveToRegion"]  # it only shows driving
    rows = {task: strip(magical_mj.demos.load(task)[0]) for task in tasks}
    labelled = [part for task, row in rows.items() for part in (label(task, row.shape[1]), row)]
    Image.fromarray(np.concatenate(labelled)).save(PICTURE)
