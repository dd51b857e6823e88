"""Pictures of batches: the software renderer's bytes, on the processor and by numba-cuda's simulator."""

from __future__ import annotations

import re
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
import torch

import magical_mj
from magical_mj.batched import tables
from magical_mj.batched.pictures import Painter, check_accelerator
from magical_mj.batched.scenes import BatchScenes, capacity_for
from magical_mj.batched.tables import episode_tables
from magical_mj.observations import SEGMENTATIONS, VIEWS
from magical_mj.scene import Scene
from magical_mj.shifts.drawn import BLOCKS, BLUR, DIRT, LOSS, NOISE
from magical_mj.shifts.episode import draw_shifts
from magical_mj.shifts.registry import DRAWN
from magical_mj.utils.errors import MissingExtraError
from tools.batched_pictures import different_bytes

pytestmark = pytest.mark.xdist_group("warp")
needs_numba_cuda = pytest.mark.skipif(find_spec("numba_cuda") is None, reason="needs numba-cuda, of the extra gpu")


def batch(scenes: list[Scene]) -> BatchScenes:
    return BatchScenes.of(scenes, *capacity_for(scenes))


def painted(scenes: BatchScenes) -> Painter:
    return Painter(scenes, episode_tables(scenes))


def drawn(painter: Painter, scenes: BatchScenes, view: str, size: int) -> np.ndarray:
    depth = 3 if view in VIEWS else 1
    out = torch.zeros((len(scenes.poses), size, size, depth), dtype=torch.uint8)
    painter.draw(view, torch.from_numpy(scenes.poses), torch.from_numpy(scenes.fingers), out)
    return out.numpy() if depth == 3 else out.numpy()[..., 0]


def rendered(scene: Scene, view: str, size: int) -> np.ndarray:
    engine = magical_mj.Engine.of_scene(scene, renderer="software")
    engine.reset()
    picture = engine.render(view, size)
    engine.close()
    return picture


@pytest.mark.parametrize("view", [*VIEWS, *SEGMENTATIONS])
def test_pictures_of_all_environments_are_the_software_renderers(view: str) -> None:
    scenes = [magical_mj.sample_scene(*pair, 1) for pair in magical_mj.ENVIRONMENTS]
    arrays = batch(scenes)
    for scene, picture in zip(scenes, drawn(painted(arrays), arrays, view, 96), strict=True):
        np.testing.assert_array_equal(picture, rendered(scene, view, 96))


@pytest.mark.parametrize("shifts", [*({name: 5} for name in DRAWN), dict.fromkeys(DRAWN, 3)], ids=str)
def test_shifted_pictures_are_those_of_the_single_environments(shifts: dict[str, int]) -> None:
    """Of the same seeds, after a step, so that shifts that change with the step are seen."""
    environments = [("FindDupe", "All", 3), ("MatchRegions", "All", 4), ("MoveToCorner", "Demo", 5)]
    engines = [
        magical_mj.Engine(task, variant, seed=seed, renderer="software", shifts=shifts)
        for task, variant, seed in environments
    ]
    scenes, seeds = batch([engine.scene for engine in engines]), [seed for *_, seed in environments]
    painter = Painter(scenes, episode_tables(scenes, seeds, shifts, steps=2))
    for engine in engines:
        engine.step(1)
    painter.set_steps(torch.tensor([1, 1, 1]))
    for view in (*VIEWS, *SEGMENTATIONS):
        for engine, picture in zip(engines, drawn(painter, batch([e.scene for e in engines]), view, 64), strict=True):
            np.testing.assert_array_equal(picture, engine.render(view, 64))


def test_other_scenes_in_the_same_slots() -> None:
    """More or fewer blocks and regions, and other sizes of regions; only the named environments change."""
    first, second = ([magical_mj.sample_scene("FindDupe", "All", seed) for seed in seeds] for seeds in ((0, 1), (2, 3)))
    before, after = (BatchScenes.of(scenes, 10, 3) for scenes in (first, second))
    painter = painted(before)
    second_after = after[np.array([1])]
    painter.set_episodes({**vars(second_after), **episode_tables(second_after)}, torch.tensor([1]))
    both = after[np.array([0, 1])]
    both.write(before[np.array([0])], np.array([0]))
    for scene, picture in zip((first[0], second[1]), drawn(painter, both, "allo", 61), strict=True):
        np.testing.assert_array_equal(picture, rendered(scene, "allo", 61))


def test_only_the_named_environments_are_drawn() -> None:
    arrays = batch([magical_mj.sample_scene("MoveToCorner", "Demo", 0)] * 3)
    out, poses, fingers = (
        torch.zeros((3, 16, 16, 3), dtype=torch.uint8),
        *map(torch.from_numpy, (arrays.poses, arrays.fingers)),
    )
    painted(arrays).draw("allo", poses, fingers, out, torch.tensor([1]))
    assert [bool(picture.any()) for picture in out] == [False, True, False]


@needs_numba_cuda
def test_an_accelerator_draws_the_same_bytes() -> None:
    """All tasks, both views; `python tools/batched_pictures.py` draws more and larger ones."""
    assert different_bytes(12, 10) == 0


@pytest.mark.weekly
@needs_numba_cuda
def test_an_accelerator_draws_shifts_with_the_same_bytes() -> None:
    faults = {draw_shifts({"sensor": 4}, seed)["sensor"]["fault"] for seed in range(8)}
    assert faults == {NOISE, BLUR, BLOCKS, DIRT, LOSS}
    assert different_bytes(8, 16, "camera:3,light:4,texture:4,palette:3,sensor:4") == 0


@pytest.mark.weekly
@needs_numba_cuda
def test_the_kernels_compile_for_an_accelerator(monkeypatch: pytest.MonkeyPatch) -> None:
    """And nothing but cosine and sine, which are CUDA's own functions, fuses a product with a sum."""
    from numba import cuda, float32, float64, int8, int32, int64, types, uint8

    from magical_mj.batched import accelerator
    from magical_mj.rendering import scanlines
    from magical_mj.shifts import kernels

    monkeypatch.setattr("numba.cuda.dispatcher.get_current_device", lambda: SimpleNamespace(compute_capability=(9, 0)))
    table, scene, doubles = int32[:, ::1], (float64[:, ::1], float32[:, ::1]), float64[:, ::1]
    shapes = int32[:, :, ::1], doubles, float32[:, :, ::1], int64[:, ::1], float64[:, :, ::1], table, int64[::1]
    every = types.Tuple((*shapes, uint8[:, ::1], int32[:, :, ::1], doubles, doubles))
    drawn = every, int64, float32[:, :, ::1], float32[:, ::1], int64, int64[::1], uint8[:, :, :, ::1]
    faults = types.Tuple((doubles, int8[:, ::1], float64[:, :, ::1]))
    spoilt = faults, int64[::1], int64, int64[::1], uint8[:, :, :, ::1]
    compiled = (accelerator.draw, drawn), (accelerator.segment, drawn), (accelerator.spoil, spoilt)
    for kernel, signature in compiled:
        assert ".visible .entry" in cuda.compile_ptx(kernel.py_func, signature, cc=(9, 0))[0]

    def rounded(scene, frames, view, x, y, line, light):  # noqa: ANN001, ANN202 - numba reads no annotations
        scanlines.place(scene, 0, frames, view, 96, x, y)
        kernels.relight_row(0, line, *light, (0.1, 0.2, 0.8, 0.6, 2.0))
        kernels.dirty_row(0, line, light[1][0], light[1][1], light[1][2])

    light = types.Tuple((table, float64[::1], float64[::1]))
    placed = types.Tuple((table, *scene)), doubles, types.UniTuple(float64, 5), int32[::1], int32[::1]
    code, _ = cuda.compile_ptx(rounded, (*placed, uint8[:, ::1], light), cc=(9, 0))
    assert re.search(r"\bmul\.rn\.f64", code)
    assert not re.search(r"\bfma\.", code)


def test_a_missing_extra_for_accelerators_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("magical_mj.utils.extras.find_spec", lambda name: None if name == "numba_cuda" else name)
    check_accelerator("cpu")
    with pytest.raises(MissingExtraError, match=r"pictures on an accelerator need numba_cuda: .*\[gpu\]"):
        check_accelerator("cuda:0")


def test_a_palette_has_room_for_bytes() -> None:
    """The accelerator stores the entry of a sample as one."""
    assert len(tables.palette(tables.library().model)) <= 256
