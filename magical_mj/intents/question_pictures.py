"""Pictures of questions: scenes from above, with numbered blocks."""

from __future__ import annotations

from contextlib import closing
from functools import lru_cache
from io import BytesIO
from typing import Final

from PIL import Image, ImageDraw, ImageFont

from magical_mj.engine import Engine
from magical_mj.scene import Scene
from magical_mj.scene.constants import VISIBLE_SIZE

SIZE: Final = 256
"""The side of a picture in pixels."""


@lru_cache(maxsize=32)  # a question's initial scene is shown with each of its final scenes
def png(scene: Scene, size: int = SIZE) -> bytes:
    """The scene from above, with the number of each block on it, as a PNG file of `size` x `size` pixels."""
    with closing(Engine.of_scene(scene)) as engine:
        image = Image.fromarray(engine.render("allo", size))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(size / 16)
    scale = size / (VISIBLE_SIZE * scene.half_width)
    for number, block in enumerate(scene.blocks, 1):
        place = size / 2 + block.x * scale, size / 2 - block.y * scale
        draw.text(place, str(number), fill="black", font=font, anchor="mm", stroke_width=1, stroke_fill="white")
    file = BytesIO()
    image.save(file, "PNG")
    return file.getvalue()
