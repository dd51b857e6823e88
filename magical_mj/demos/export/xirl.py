"""Demonstrations as the folders of pictures that XIRL (Zakka et al. 2021) trains its rewards on.

Its loader reads ``ROOT/train/BODY/VIDEO/FRAME.png`` and ``ROOT/valid/...``, all numbered from 0, and learns across the
bodies. Pictures are of the whole workspace, before the first action and after each; XIRL scales them down to 112 px.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from PIL import Image

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.replay import render_demo
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError

SIZE: Final = 384
"""Pixels per side, as x-magical draws them."""
VALID: Final = 10
"""The last of so many videos of a body are for validation."""


def to_xirl(demos: Sequence[Demonstration], folder: Path | str, *, overwrite: bool = False) -> None:
    """Draws demonstrations of one task, by any bodies, into a new folder.

    Args:
        demos: the demonstrations. Each body's first nine of ten are for training.
        folder: the root, which is made.
        overwrite: replace an existing folder.

    Raises:
        DemonstrationError: if they are of several tasks, or a body has a single one.
        FileExistsError: if the folder exists already.
    """
    tasks = sorted({demo.task for demo in demos})
    if len(tasks) != 1:
        raise DemonstrationError(f"a data set for XIRL holds one task, and these are of {', '.join(tasks) or 'none'}")
    groups: dict[str, list[Demonstration]] = {}
    for demo in demos:
        groups.setdefault(demo.scene.robot.body.rpartition(":")[2], []).append(demo)
    for body, group in groups.items():
        if len(group) < 2:
            raise DemonstrationError(f"there is one demonstration by the {body}: training and validation need one each")
    with files.new_folder(files.to_path(folder), overwrite=overwrite) as unfinished:
        for body, group in groups.items():
            trained = len(group) - max(1, len(group) // VALID)
            for number, demo in enumerate(group):
                split, video = ("train", number) if number < trained else ("valid", number - trained)
                _draw(demo, unfinished / split / body / str(video))


def _draw(demo: Demonstration, folder: Path) -> None:
    folder.mkdir(parents=True)
    for frame, pictures in enumerate(render_demo(demo, size=SIZE, renderer="software")):
        Image.fromarray(pictures["allo"]).save(folder / f"{frame}.png")
