"""A hidden X11 display. It needs Xvfb; its keyboard needs xdotool."""

from __future__ import annotations

import os
import struct
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Display(NamedTuple):
    """A hidden display."""

    name: str
    file: Path

    def picture(self) -> NDArray[np.uint8]:
        """The current screen. Shape (height, width, 3). Read from the dump file of Xvfb (X11/XWDFile.h)."""
        data = self.file.read_bytes()
        header = struct.unpack(">25I", data[:100])
        height, row, start = header[5], header[12], header[0] + 12 * header[19]
        pixels = np.frombuffer(data, np.uint8, height * row, start).reshape(height, row // 4, 4)
        return pixels[:, :, 2::-1]  # stored as blue, green, red

    def xdotool(self, *words: str) -> None:
        """Runs xdotool, which simulates a keyboard."""
        subprocess.run(["xdotool", *words], env=os.environ | {"DISPLAY": self.name}, check=True, timeout=60)


@contextmanager
def hidden_display(folder: Path) -> Iterator[Display]:
    """A context with a hidden display. Its screen is written to a file in the folder."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1024x768x24", "-nolisten", "tcp"]
    with subprocess.Popen([*command, "-fbdir", folder], pass_fds=[writing], stderr=subprocess.DEVNULL) as server:
        os.close(writing)
        try:
            with os.fdopen(reading) as answer:
                number = answer.readline().strip()
            yield Display(f":{number}", folder / "Xvfb_screen0")
        finally:
            server.terminate()
