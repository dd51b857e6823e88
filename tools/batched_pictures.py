"""Compares the pictures and segmentations of batched environments with the software renderer's, byte by byte.

    python tools/batched_pictures.py --scenes 200
    python tools/batched_pictures.py --scenes 60 --size 48 --shifts camera:3,light:3,texture:3,palette:3,sensor:3
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
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

import magical_mj
from magical_mj.observations import SEGMENTATIONS, VIEWS
from magical_mj.shifts.registry import parse_shifts

if TYPE_CHECKING:
    from magical_mj.batched.scenes import BatchScenes, EpisodeArrays

ROOT: Final = Path(__file__).parent.parent
ALL_VIEWS: Final = (*VIEWS, *SEGMENTATIONS)
APART: Final = 7
"""The distance of environments in turn, prime to their number: few scenes show all tasks and most variants."""
STEPS: Final = 2
"""The number of steps before the pictures, since shifts may change with the step."""
Pictures = dict[str, Any]
"""View -> the pictures of all scenes, uint8."""
SIMULATED: Final = {"NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}


def different_bytes(count: int, size: int, shifts: str = "", device: str | None = None) -> int:
    """The number of bytes in which the pictures and segmentations of this many scenes differ, both views.

    Args:
        count: the number of scenes: those of the seeds 0, 1, 2..., of all environments in turn, in steps of `APART`.
        size: pixels per side.
        shifts: shifts with strengths.
        device: the device that draws the batch; None: numba-cuda's simulator.
    """
    from magical_mj.batched.scenes import BatchScenes, capacity_for
    from magical_mj.batched.tables import episode_tables

    pairs, strengths = magical_mj.ENVIRONMENTS, parse_shifts(shifts)
    drawn = [(*pairs[APART * index % len(pairs)], index) for index in range(count)]
    wanted: dict[str, list[NDArray[np.uint8]]] = {view: [] for view in ALL_VIEWS}
    scenes: list[magical_mj.Scene] = []
    for task, variant, seed in drawn:
        with closing(magical_mj.Engine(task, variant, seed=seed, renderer="software", shifts=shifts)) as engine:
            for _ in range(STEPS):
                engine.step(1)
            scenes.append(engine.scene)
            for view in ALL_VIEWS:
                wanted[view].append(engine.render(view, size))
    batch, seeds = BatchScenes.of(scenes, *capacity_for(scenes)), [seed for *_, seed in drawn]
    tables = episode_tables(batch, seeds, {name: int(strengths[name]) for name in strengths}, STEPS + 1)
    pictures = (_simulated if device is None else partial(_on_device, device))(batch, tables, size)
    differ = (np.stack(wanted[view]).reshape(out.shape) != out for view, out in pictures.items())
    return int(sum(map(np.count_nonzero, differ)))


def blank(count: int, size: int) -> Pictures:
    """Black pictures of this many scenes: a batch for each view."""
    return {view: np.zeros((count, size, size, 3 if view in VIEWS else 1), np.uint8) for view in ALL_VIEWS}


def _on_device(device: str, batch: BatchScenes, tables: EpisodeArrays, size: int) -> Pictures:
    """The pictures that a device draws."""
    import torch

    from magical_mj.batched.pictures import Painter

    painter = Painter(batch, tables, device)
    painter.set_steps(torch.full((len(batch.poses),), STEPS))
    poses, fingers = (torch.from_numpy(values).to(device) for values in (batch.poses, batch.fingers))
    drawn = {view: torch.from_numpy(out).to(device) for view, out in blank(len(poses), size).items()}
    for view, out in drawn.items():
        painter.draw(view, poses, fingers, out)
    return {view: out.cpu().numpy() for view, out in drawn.items()}


def _simulated(batch: BatchScenes, tables: EpisodeArrays, size: int) -> Pictures:
    """The pictures that numba-cuda's simulator draws in a process of its own."""
    from magical_mj.batched.tables import all_tables, most_corners

    arrays: dict[str, Any] = {name: np.ascontiguousarray(table) for name, table in all_tables(batch, tables).items()}
    with tempfile.TemporaryDirectory() as folder:
        given, result = Path(folder, "tables.npz"), Path(folder, "pictures.npz")
        np.savez(
            given, **arrays, corner_capacity=most_corners(batch), size=size, poses=batch.poses, fingers=batch.fingers
        )
        subprocess.run([sys.executable, __file__, "--simulate", given, result], env=os.environ | SIMULATED, check=True)
        return dict(np.load(result))


def simulate(given: Path, result: Path) -> None:
    """Draws with the simulator."""
    from magical_mj.batched.accelerator import launch
    from magical_mj.batched.tables import Faults, Tables

    arrays = np.load(given)
    tables = Tables(*(arrays[name] for name in Tables._fields))
    faults = Faults(*(arrays[name] for name in Faults._fields)) if "sensors" in arrays else None
    count, corner_capacity = len(tables.polygons), int(arrays["corner_capacity"])
    posed, pictures = (arrays["poses"], arrays["fingers"], np.full(count, STEPS)), blank(count, int(arrays["size"]))
    for view, out in pictures.items():
        launch(tables, faults, corner_capacity, posed, view, np.arange(count), out)
    np.savez(result, allow_pickle=False, **pictures)


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
    print(f"{chosen.scenes} scenes, {len(ALL_VIEWS)} views, {chosen.size} pixels{shifted}: {different} bytes differ")
    return int(different > 0)


if __name__ == "__main__":
    sys.exit(main())
