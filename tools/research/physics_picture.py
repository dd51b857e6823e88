"""Draws docs/physics.png: a dozen rollouts of the original, each next to ours. `make docs` runs this."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from rollouts import Array, Case, Rollouts, probe_errors, probe_poses, probe_scene, recordings

from magical_mj.scene import constants as c
from magical_mj.scene.geometry import Outline, block_outline, finger_outlines, mirrored, placed, regular_polygon

ROOT: Final = Path(__file__).parent.parent
CASES: Final = {
    "drive/hold_action_04": "forward and left",
    "drive/hold_action_08": "backward and right",
    "wall/oblique": "into a wall",
    "wall/block_corner": "a square, into a corner",
    "push/square_offset06_angle4": "push a square",
    "push/pentagon_offset12_angle0": "push a pentagon",
    "push/star_offset06_angle0": "push a star (the worst)",
    "push/chain_three": "push three",
    "grip/square_forward_back": "grip, forward, back, let go",
    "grip/circle_turn": "grip, left, right, let go",
    "grip/star_turn": "grip, left, right, let go",
    "spin/square": "spin beside a square",
}
COLUMNS: Final = 3
PANEL, LABEL, GAP = 230, 24, 14  # pixels
OVERSAMPLING: Final = 3
INK, PALE, TRACE, REFERENCE = "#333333", "#cfcfcf", "#1f6fb4", "#d62728"


def parts(shapes: list[str], poses: Array, fingers: Array) -> list[Outline]:
    """The outlines of the four finger segments, the robot, and the blocks."""
    segments = []
    for sign, angle in ((-1, fingers[0]), (1, fingers[1])):
        for outline in finger_outlines():
            own = placed(mirrored(outline) if sign < 0 else outline, (sign * c.FINGER_ROOT[0], c.FINGER_ROOT[1], angle))
            segments.append(placed(own, tuple(poses[0])))
    robot = placed(regular_polygon(60, c.ROBOT_RADIUS), tuple(poses[0]))
    blocks = [placed(block_outline(s), tuple(p)) for s, p in zip(shapes, poses[1:], strict=True)]
    return [*segments, robot, *blocks]


class Panel:
    """A picture of a square part of the arena."""

    def __init__(self, centre: Array, half: float) -> None:
        side = PANEL * OVERSAMPLING
        self.image = Image.new("RGB", (side, side), "white")
        self._draw = ImageDraw.Draw(self.image)
        self._corner, self._scale = centre + np.array([-half, half]), side / (2 * half)
        self.line(c.ARENA_HALF_WIDTH * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]), "black", 2, closed=True)

    def line(self, points: Array, colour: str, width: float, *, closed: bool = False) -> None:
        """Draws a polyline with points in world units."""
        pixels = (points - self._corner) * [self._scale, -self._scale]
        if closed:
            pixels = np.vstack([pixels, pixels[:1]])
        self._draw.line([tuple(p) for p in pixels.tolist()], fill=colour, width=round(width * OVERSAMPLING))

    def motion(self, shapes: list[str], track: Array, fingers: Array) -> None:
        """Draws the start and some steps in grey, the end in black, and the paths of all centres."""
        steps = range(0, len(track) - 1, max(1, len(track) // 4))
        for step in (*steps, len(track) - 1):
            last = step == len(track) - 1
            for outline in parts(shapes, track[step], fingers[step]):
                self.line(outline, INK if last else PALE, 1.6 if last else 1, closed=True)
        for body in range(track.shape[1]):
            self.line(track[:, body, :2], TRACE, 1.6)

    def finished(self) -> Image.Image:
        """The picture in its final size, with a frame."""
        image = self.image.resize((PANEL, PANEL), Image.Resampling.LANCZOS)
        ImageDraw.Draw(image).rectangle((0, 0, PANEL - 1, PANEL - 1), outline="#999999")
        return image


def pair(case: Case) -> tuple[Image.Image, Image.Image]:
    """Pictures of the original, and of ours with the end of the original in red."""
    scene, theirs = probe_scene(case), probe_poses(case).astype(float)
    ours, our_fingers = Rollouts(scene).roll(case["actions"].tolist())
    shapes = [block.shape for block in scene.blocks]
    low, high = (f(np.concatenate([theirs, ours])[..., :2], axis=(0, 1)) for f in (np.min, np.max))
    centre, half = (low + high) / 2, float((high - low).max()) / 2 + 0.42
    panels = Panel(centre, half), Panel(centre, half)
    panels[0].motion(shapes, theirs, case["fingers"].astype(float))
    panels[1].motion(shapes, ours, our_fingers)
    for outline in parts(shapes, theirs[-1], case["fingers"][-1].astype(float)):
        panels[1].line(outline, REFERENCE, 0.8, closed=True)
    return panels[0].finished(), panels[1].finished()


def picture(cases: Mapping[str, Case]) -> Image.Image:
    """All pairs, with descriptions and distances."""
    width, height = 2 * PANEL + GAP, PANEL + LABEL + GAP
    sheet = Image.new("RGB", (COLUMNS * (width + GAP), height * -(-len(CASES) // COLUMNS) + LABEL + GAP), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for index, (name, words) in enumerate(CASES.items()):
        left, top = index % COLUMNS * (width + GAP) + GAP // 2, index // COLUMNS * height + LABEL + GAP
        mean, end, _ = probe_errors(cases[name])
        draw.text((left, top), f"{words}: {mean:.3f} apart, {end:.3f} at the end", INK, font)
        for offset, panel in zip((0, PANEL + 2), pair(cases[name]), strict=True):
            sheet.paste(panel, (left + offset, top + LABEL))
    draw.text((GAP // 2, 4), "left: the original; right: ours, with the end of the original in red", INK, font)
    return sheet


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    shown = picture(recordings(ROOT / "tests" / "data" / "probes.npz"))
    shown.quantize(64).save(ROOT / "docs" / "physics.png", optimize=True)
