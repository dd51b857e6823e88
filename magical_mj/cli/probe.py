"""Draws a few frames for `magical-mj doctor`, in a process for each renderer. It imports no more than drawing needs."""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from contextlib import closing
from typing import Final

import magical_mj
from magical_mj.rendering.backend import drawn_by

SIZE: Final = 96  # pixels, as in the LoRes presets
FRAMES: Final = 20


def probe() -> None:
    """Draws a few frames and prints JSON: the renderer, and the milliseconds of the first and of a typical frame."""
    times = []
    with closing(magical_mj.Engine("FindDupe", seed=0)) as env:  # its error explains why OpenGL does not start
        for _ in range(FRAMES):
            start = time.perf_counter()
            env.render("ego", SIZE)
            times.append(1000 * (time.perf_counter() - start))
    from magical_mj.rendering.opengl import opengl_name  # imported late: it may fail without OpenGL

    renderer = "on the processor, without OpenGL" if drawn_by() == "software" else opengl_name()
    facts = {"renderer": renderer, "first": times[0], "typical": sorted(times)[FRAMES // 2]}
    if drawn_by() == "software":
        from magical_mj.rendering.scanlines import draw_picture  # imported late: numba takes 0.3 s

        facts["code"] = draw_picture.folder
    sys.stdout.write(json.dumps(facts))


def _end_with_caller() -> None:
    """Ends this process when its caller has ended. A driver may hang in the main thread."""
    os.read(0, 1)  # a file object would be locked when Python ends
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=_end_with_caller, daemon=True).start()
    probe()
