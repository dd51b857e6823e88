"""Writes pictures of the built site: docs/site.png (home, task, play on two screens, gallery) and docs/inspect.png."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path

from PIL import Image

ROOT = Path(__file__).parent.parent
HEIGHT, GAP = 420, 10  # pixels
INSPECT = 960, 600

if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["node", str(ROOT / "site" / "screenshots.mjs"), folder], check=True)
        shots = [Image.open(Path(folder) / f"{name}.png") for name in ("home", "task", "play", "phone", "gallery")]
        inspect = Image.open(Path(folder) / "inspect.png").convert("RGB").resize(INSPECT, 1)
        small = [shot.convert("RGB").resize((shot.width * HEIGHT // shot.height, HEIGHT), 1) for shot in shots]
    rows = [small[:2], small[2:]]
    width = max(sum(shot.width + GAP for shot in row) for row in rows) + GAP
    sheet = Image.new("RGB", (width, 2 * HEIGHT + 3 * GAP), (205, 207, 214))
    for line, row in enumerate(rows):
        x = GAP
        for shot in row:
            sheet.paste(shot, (x, GAP + line * (HEIGHT + GAP)))
            x += shot.width + GAP
    sheet.quantize(256).save(ROOT / "docs" / "site.png", optimize=True)
    inspect.quantize(256).save(ROOT / "docs" / "inspect.png", optimize=True)
