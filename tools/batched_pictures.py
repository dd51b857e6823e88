"""Compares the pictures of batched environments with the software renderer's, byte by byte.

    python tools/batched_pictures.py --scenes 200
    python tools/batched_pictures.py --scenes 60 --size 48 --shifts camera:3,light:3,texture:3,palette:3
    python tools/batched_pictures.py --scenes 2000 --device cuda

Without `--device`, numba-cuda's simulator runs the accelerator's kernel in Python, with a thread for each of its
threads. The command prints how many bytes differ, and exits with 1 unless none does. It needs the extra `gpu`.

On an accelerator a few bytes may differ: its cosine and sine are not rounded as the processor's.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

import magical_mj
from magical_mj.scene.state_vector import VIEWS
from magical_mj.shifts.episode import EpisodeShifts, draw_shifts
from magical_mj.shifts.registry import parse_shifts

if TYPE_CHECKING:
    from magical_mj.batched.scenes import BatchScenes

ROOT: Final = Path(__file__).parent.parent
SIMULATED: Final = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}


def different_bytes(count: int, size: int, shifts: str = "", device: str | None = None) -> int:
    """The number of bytes in which the pictures of this many scenes differ, both views.

    Args:
        count: the number of scenes: those of seeds 0, 1, 2... of all environments in turn.
        size: pixels per side.
        shifts: shifts with strengths.
        device: the device that draws the batch; None: numba-cuda's simulator.
    """
    from magical_mj.batched.scenes import BatchScenes, Capacity

    pairs, strengths = magical_mj.ENVIRONMENTS, parse_shifts(shifts)
    drawn = [(*pairs[index % len(pairs)], index // len(pairs)) for index in range(count)]
    scenes = [magical_mj.sample_scene(*each) for each in drawn]
    batch, seeds = BatchScenes.of(scenes, *Capacity.of(scenes)), [seed for *_, seed in drawn]
    draw = _simulated if device is None else partial(_on_device, device)
    pictures, different = draw(batch, {name: int(strengths[name]) for name in strengths}, seeds, size), 0
    for number, (task, variant, seed) in enumerate(drawn):
        with closing(magical_mj.Engine(task, variant, seed=seed, renderer="software", shifts=shifts)) as engine:
            for view, name in enumerate(VIEWS):
                different += int(np.count_nonzero(engine.render(name, size) != pictures[view, number]))
    return different


def _on_device(
    device: str, batch: BatchScenes, strengths: Mapping[str, int], seeds: Sequence[int], size: int
) -> NDArray[np.uint8]:
    """The pictures that a device draws, shape (views, scenes, size, size, 3)."""
    import torch

    from magical_mj.batched.pictures import Painter

    painter = Painter(batch, device, strengths, seeds)
    out = torch.zeros((len(VIEWS), len(seeds), size, size, 3), dtype=torch.uint8, device=device)
    poses, fingers = (torch.from_numpy(values).to(device) for values in (batch.poses, batch.fingers))
    for view, pictures in zip(VIEWS, out, strict=True):
        painter.draw(view, poses, fingers, pictures)
    return out.cpu().numpy()


def _simulated(batch: BatchScenes, strengths: Mapping[str, int], seeds: Sequence[int], size: int) -> NDArray[np.uint8]:
    """The pictures that numba-cuda's simulator draws in a process of its own."""
    from magical_mj.batched.pictures import most_corners, tables

    episodes = [EpisodeShifts(draw_shifts(strengths, seed)) for seed in seeds if strengths]
    arrays: dict[str, Any] = {
        name: np.ascontiguousarray(table) for name, table in tables(batch, episodes)._asdict().items()
    }
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "tables.npz"), Path(folder, "pictures.npy")
        np.savez(given, **arrays, room=most_corners(batch), size=size, poses=batch.poses, fingers=batch.fingers)
        subprocess.run([sys.executable, __file__, "--simulate", given, result], env=os.environ | SIMULATED, check=True)
        return np.load(result)


def simulate(given: Path, result: Path) -> None:
    """Draws with the simulator."""
    from magical_mj.batched.accelerator import launch
    from magical_mj.batched.pictures import Tables

    arrays = np.load(given)
    tables = Tables(*(arrays[name] for name in Tables._fields))
    envs, size = len(tables.polygons), int(arrays["size"])
    pictures = np.zeros((len(VIEWS), envs, size, size, 3), np.uint8)
    for view, out in enumerate(pictures):
        launch(tables, int(arrays["room"]), arrays["poses"], arrays["fingers"], view, np.arange(envs), out)
    np.save(result, pictures)


def main() -> int:
    """Runs the command line. Returns 1 if a byte differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=200)
    parser.add_argument("--size", type=int, default=96, help="pixels per side")
    parser.add_argument("--shifts", default="", help="shifts of the pictures with strengths, such as camera:3,light:2")
    parser.add_argument("--device", help="the device that draws the batch, such as cuda; default: the simulator")
    parser.add_argument("--simulate", nargs=2, type=Path, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.simulate:
        simulate(*chosen.simulate)
        return 0
    different = different_bytes(chosen.scenes, chosen.size, chosen.shifts, chosen.device)
    shifted = f", {chosen.shifts}" if chosen.shifts else ""
    print(f"{chosen.scenes} scenes, {len(VIEWS)} views, {chosen.size} pixels{shifted}: {different} bytes differ")
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
