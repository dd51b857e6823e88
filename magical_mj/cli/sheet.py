"""The contact sheet: the initial scene of every environment, tasks down, variants across."""

from __future__ import annotations

from typing import Final

from PIL import Image, ImageDraw, ImageFont

import magical_mj
from magical_mj import ENVIRONMENTS, TASKS, VARIANTS

GAP: Final = 6  # pixels between the cells
MARGIN: Final = 28  # pixels above and left of the cells, for the labels
TEXT_SIZE: Final = 15  # pixels
INK: Final = (60, 60, 60)
PAPER: Final = (255, 255, 255)
ABSENT: Final = (242, 242, 242)  # a cell whose task does not have the variant


def contact_sheet(seed: int, size: int, view: str = "allo") -> Image.Image:
    """All 60 initial scenes of `seed`, labelled, each `size` pixels wide."""
    pitch = size + GAP
    sheet = Image.new("RGB", (MARGIN + len(VARIANTS) * pitch, MARGIN + len(TASKS) * pitch), PAPER)
    for row, task in enumerate(TASKS):
        for column, variant in enumerate(VARIANTS):
            cell = _scene(task, variant, seed, size, view)
            sheet.paste(cell, (MARGIN + column * pitch, MARGIN + row * pitch))
    _label(sheet, VARIANTS, pitch)
    upright = sheet.rotate(-90, expand=True)  # the tasks are written upwards
    _label(upright, tuple(reversed(TASKS)), pitch, start=GAP)
    return upright.rotate(90, expand=True)


def _scene(task: str, variant: str, seed: int, size: int, view: str) -> Image.Image:
    if (task, variant) not in ENVIRONMENTS:
        return Image.new("RGB", (size, size), ABSENT)
    env = magical_mj.load(task, variant, seed=seed, observations=())
    env.reset()
    picture = Image.fromarray(env.render(view, size))
    env.close()
    return picture


def _label(sheet: Image.Image, names: tuple[str, ...], pitch: int, start: int = MARGIN) -> None:
    """Writes the names above the cells."""
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(TEXT_SIZE)
    for index, name in enumerate(names):
        middle = start + index * pitch + (pitch - GAP) / 2
        draw.text((middle, MARGIN / 2), name, INK, font, anchor="mm")
