"""Draws docs/experts.png: the first shipped demonstration of each task at even intervals. `make docs` runs this."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

import magical_mj

PICTURE: Final = Path(__file__).parent.parent / "docs" / "experts.png"
SIZE: Final = 112  # pixels, of a frame
FRAMES: Final = 8
GAP: Final = 4  # pixels


def strip(demo: magical_mj.demos.Demonstration) -> np.ndarray:
    """Frames side by side, from the start to the end of the last action that does something."""
    end = int(np.flatnonzero(demo.actions)[-1]) + 1
    wanted = set(np.linspace(0, end, FRAMES).astype(int).tolist())
    frames = [seen["allo"] for step, seen in enumerate(magical_mj.demos.see(demo, size=SIZE)) if step in wanted]
    return np.concatenate(
        [np.pad(frame, ((0, GAP), (0, GAP), (0, 0)), constant_values=255) for frame in frames], axis=1
    )


if __name__ == "__main__":
    tasks = [task for task in magical_mj.TASKS if task != "MoveToRegion"]  # there is little to see in driving
    Image.fromarray(np.concatenate([strip(magical_mj.demos.load(task)[0]) for task in tasks])).save(PICTURE)
