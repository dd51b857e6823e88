"""The software renderer: known pixels, beside OpenGL in all tasks, the same bytes everywhere, and without OpenGL."""

from __future__ import annotations

import hashlib
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numba import njit

import magical_mj
from magical_mj.assets import style
from magical_mj.assets.scene_mjcf import scene_mjcf
from magical_mj.rendering import scanlines
from magical_mj.rendering.backend import check_renderer, drawn_by
from magical_mj.rendering.opengl import OpenGLRenderer
from magical_mj.rendering.renderer import new_renderer
from magical_mj.rendering.software import BLOCK, FINGER, FLOOR, REGION, ROBOT, WALL, SoftwareRenderer, polygons_of
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene.bodies import Body
from magical_mj.utils.errors import RenderingError, UnknownNameError

VIEWS = ("ego", "allo")
HASHES = Path(__file__).parents[1] / "data" / "pictures.sha256"
BARE = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "MAGICAL_MJ_RENDERER")}
NO_DRIVER = {"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent"}
CORNER = Scene(Robot(0.5, 0.25, 0.0), (Block("square", "red", -0.5, 0.5, 0.0),), (GoalRegion("blue", -1, -1, 0, 0),))


def world(scene: Scene) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The compiled model of a scene, and its state at the start."""
    model = mujoco.MjModel.from_xml_string(scene_mjcf(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def covered(corners: list[tuple[float, float]], side: int = 8) -> np.ndarray:
    """The samples that a polygon covers, whose corners are given in samples. Shape (side, side), bottom row first."""
    x, y = (np.array([int(scanlines.GRID * corner[axis]) for corner in corners]) for axis in (0, 1))
    pixels, left, right = np.zeros((side, side), np.uint32), np.zeros(side, np.int64), np.zeros(side, np.int64)
    rows = (*scanlines.clip(x, y, len(corners), side), 0)
    scanlines.fill(x, y, len(corners), 1, rows, side, (pixels.reshape(-1), left, right))
    return pixels


# Which samples a polygon covers


def test_a_square_covers_the_samples_whose_centres_are_in_it() -> None:
    expected = np.zeros((8, 8), np.uint32)
    expected[1:4, 2:5] = 1
    np.testing.assert_array_equal(covered([(2, 1), (5, 1), (5, 4), (2, 4)]), expected)
    np.testing.assert_array_equal(covered([(1.6, 0.6), (5.4, 0.6), (5.4, 4.4), (1.6, 4.4)]), expected)


def test_a_triangle_covers_half_of_a_square() -> None:
    np.testing.assert_array_equal(covered([(0, 0), (8, 0), (0, 8)]), np.tril(np.ones((8, 8)), -1)[::-1] + 0)


def test_neighbours_share_no_sample_and_leave_none() -> None:
    """Also where their common edges pass through centres."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        middle = rng.integers(2, 13, 2) / 2  # on centres and between them
        ring = [(0.0, 0.0), (8.0, 0.0), (8.0, 8.0), (0.0, 8.0)]
        parts = [covered([ring[k], ring[(k + 1) % 4], tuple(middle)]) for k in range(4)]
        np.testing.assert_array_equal(sum(parts), np.ones((8, 8)))


def test_polygons_outside_the_picture_are_clipped() -> None:
    np.testing.assert_array_equal(covered([(-900, -900), (900, -900), (900, 900), (-900, 900)]), np.ones((8, 8)))
    assert covered([(-3, -3), (1, -3), (1, 1), (-3, 1)]).sum() == 1
    for beside in ((9, 0), (-9, 0), (0, 9), (0, -9)):
        assert not covered([(x + beside[0], y + beside[1]) for x, y in ((0, 0), (8, 0), (8, 8), (0, 8))]).any()


# Beside OpenGL


@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_pictures_are_those_of_opengl(task: str) -> None:
    """At most one pixel in two thousand differs, by one of its four samples."""
    rng = np.random.default_rng(0)
    different = pixels = 0
    for variant in ("Demo", "Dynamics" if task == "MoveToCorner" else "All"):
        model, data = world(magical_mj.sample_scene(task, variant, 1))
        opengl, software = OpenGLRenderer(model), SoftwareRenderer(model)
        for size in (96, 61):
            data.ctrl[:] = rng.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, 20)
            mujoco.mj_forward(model, data)
            for view in VIEWS:
                far = np.abs(software.draw(data, view, size).astype(int) - opengl.draw(data, view, size)).max(axis=2)
                different += np.count_nonzero(far)
                pixels += far.size
                assert far.max() <= 64
    assert different <= pixels / 2000


@pytest.mark.parametrize("size", [1, 2, 3, 97, 320])  # 320: drawn at 640, MuJoCo's default width
def test_any_size(size: int) -> None:
    model, data = world(CORNER)
    opengl, software = OpenGLRenderer(model), SoftwareRenderer(model)
    for view in VIEWS:
        far = np.abs(software.draw(data, view, size).astype(int) - opengl.draw(data, view, size)).max(axis=2)
        assert np.count_nonzero(far) <= 1 + size * size / 2000


ROUND = Body(tuple((0.2 * math.cos(angle), 0.2 * math.sin(angle)) for angle in np.arange(100) * math.pi / 50))


def test_a_body_with_more_corners_than_a_polygon_may_have_is_drawn_in_parts() -> None:
    model, data = world(Scene(Robot(0.1, 0.2, 0.3, body=f"{__name__}:ROUND")))
    table, _, _ = polygons_of(model)
    assert (table[:, scanlines.LAST] - table[:, scanlines.FIRST]).max() <= scanlines.MAX_CORNERS
    picture = SoftwareRenderer(model).draw(data, "allo", 96)
    assert np.count_nonzero((picture != OpenGLRenderer(model).draw(data, "allo", 96)).any(axis=2)) <= 5


def test_a_rewritten_model_is_drawn_anew() -> None:
    """Colours and regions are read from the model for each picture."""
    model, data = world(CORNER)
    software = SoftwareRenderer(model)
    software.draw(data, "allo", 64)
    model.geom_rgba[model.geom("block0_fill").id, :3] = np.array(style.BLOCK_FILL["green"]) / 255
    model.skin_vert[:4, 0] += 0.5
    after = software.draw(data, "allo", 64)
    np.testing.assert_array_equal(after, SoftwareRenderer(model).draw(data, "allo", 64))
    assert tuple(after[16, 16]) == style.BLOCK_FILL["green"]
    assert tuple(after[48, 40]) == style.REGION_FILL["blue"]


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 0, 1)], ids=["channels last", "channels first"])
def test_a_window_of_a_larger_array_is_written_in_place(order: tuple[int, int, int]) -> None:
    model, data = world(CORNER)
    software = SoftwareRenderer(model)
    stack = np.zeros((32, 32, 12), np.uint8).transpose(order)
    window = stack.transpose(np.argsort(order))[..., 3:6]
    assert software.draw(data, "ego", 32, window) is window
    np.testing.assert_array_equal(window, software.draw(data, "ego", 32))
    others = stack.transpose(np.argsort(order))[..., [0, 1, 2, 6, 7, 8, 9, 10, 11]]
    assert not others.any()


# Segmentation


def test_a_segmentation_says_what_is_where() -> None:
    model, data = world(CORNER)
    allo = SoftwareRenderer(model).draw(data, "allo-segmentation", 102)
    assert (allo.shape, allo.dtype) == ((102, 102), np.uint8)

    def at(x: float, y: float) -> int:
        return int(allo[int((0.5 - y / 2.04) * 102), int((0.5 + x / 2.04) * 102)])

    assert (at(-0.5, 0.5), at(-0.5, -0.5), at(0.5, 0.15), at(0.5, -0.5)) == (BLOCK, REGION, ROBOT, FLOOR)
    assert set(np.unique(allo)) == {FLOOR, WALL, ROBOT, FINGER, REGION, BLOCK}
    assert allo[0, 0] == WALL
    picture = SoftwareRenderer(model).draw(data, "allo", 102)
    assert (picture[allo == BLOCK][:, 0] > 200).all()  # red


def test_segmentations_are_views() -> None:
    engine, out = magical_mj.Engine.of_scene(CORNER), np.zeros((20, 20), np.uint8)
    assert engine.render("ego-segmentation", 20, out) is out
    assert out.any()
    with pytest.raises(ValueError, match="out"):
        engine.render("ego-segmentation", 20, np.zeros((20, 20, 3), np.uint8))


# The same bytes everywhere


HASH = """
import hashlib, sys
from tests.rendering.test_software import digest_of
print(digest_of(sys.argv[1]))
"""


def digest_of(task: str) -> str:
    """The SHA-256 of pictures and segmentations of scenes of a task, in states that are computed without physics."""
    digest = hashlib.sha256()
    for seed in range(4):
        model, data = world(magical_mj.sample_scene(task, "Demo" if seed == 0 else "Jitter", seed))
        software = SoftwareRenderer(model)
        for shift in range(5):
            data.qpos[:3] += 0.03125 * shift
            mujoco.mj_forward(model, data)
            for view in (*VIEWS, "ego-segmentation", "allo-segmentation"):
                digest.update(software.draw(data, view, (96, 97)[shift % 2]).tobytes())
    return digest.hexdigest()


@pytest.mark.parametrize("task", magical_mj.TASKS)
def test_pictures_have_the_hashes_that_were_published(task: str) -> None:
    hashes = dict(line.split() for line in HASHES.read_text().splitlines())
    assert digest_of(task) == hashes[task]


@pytest.mark.skipif(os.name != "posix", reason="permissions")
@pytest.mark.parametrize("mode", [0o700, 0o755])
def test_a_process_without_a_cache_draws_the_same(mode: int, tmp_path: Path) -> None:
    """The code is kept in a temporary folder, unless others could write machine code into it."""
    package, installed = Path(magical_mj.__file__).parent, tmp_path / "magical_mj"
    installed.mkdir()
    for part in package.iterdir():
        if part.name != "rendering":
            (installed / part.name).symlink_to(part)
    ignored = shutil.ignore_patterns("__pycache__")
    shutil.copytree(package / "rendering", installed / "rendering", ignore=ignored)
    (installed / "rendering" / "__pycache__").touch()  # a file, so that not even root can write into it
    folder = tmp_path / f"magical-mj-numba-{os.getuid()}"
    folder.mkdir(mode=mode)
    result = subprocess.run(
        [sys.executable, "-c", HASH, "MakeLine"],
        env=BARE | {"PYTHONPATH": str(tmp_path), "TMPDIR": str(tmp_path), "XDG_CACHE_HOME": f"{installed}/__init__.py"},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert result.stdout == f"{digest_of('MakeLine')}\n"
    assert any(folder.rglob("scanlines.draw_picture*")) == (mode == 0o700)


def test_no_instruction_fuses_a_product_with_a_sum() -> None:
    """It would round once where others round twice."""
    kernel = scanlines.draw_picture.dispatcher
    (code,) = njit(kernel.signatures[0])(kernel.py_func).inspect_asm().values()  # that of cached ones is not shown
    assert re.search(r"\bv?(mulsd|mulpd|fmul)", code)
    assert not re.search(r"\b(vfn?m(add|sub)|fn?m(add|sub|la|ls)\b)", code)


# The choice


def test_the_variable_chooses_for_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = world(CORNER)
    monkeypatch.setenv("MAGICAL_MJ_RENDERER", "software")
    assert (check_renderer(None), check_renderer("opengl"), drawn_by()) == ("software", "opengl", "software")
    expected = SoftwareRenderer(model).draw(data, "ego", 96)
    np.testing.assert_array_equal(new_renderer(model, "flat").draw(data, "ego", 96), expected)
    monkeypatch.setenv("MAGICAL_MJ_RENDERER", "hardware")
    with pytest.raises(UnknownNameError, match="hardware"):
        new_renderer(model, "flat")


def test_geoms_of_users_are_drawn_by_opengl_only() -> None:
    ball = '<geom name="ball" size="0.2" group="0" rgba="0 0 1 1" pos="0 0.5 0"/></worldbody>'
    model = mujoco.MjModel.from_xml_string(scene_mjcf(CORNER).replace("</worldbody>", ball, 1))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    with pytest.raises(RenderingError, match="ball"):
        SoftwareRenderer(model)
    assert tuple(new_renderer(model, "flat", "software").draw(data, "allo", 64)[16, 32]) == (0, 0, 255)


FALLBACK = """
import magical_mj.assets
import warnings
from tests.rendering.test_software import CORNER, world
from magical_mj.rendering.backend import drawn_by
from magical_mj.rendering.renderer import new_renderer
from magical_mj.utils.errors import RenderingError
model, data = world(CORNER)
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    pictures = [new_renderer(model, "flat").draw(data, "ego", 48) for _ in range(2)]
assert (pictures[0] == new_renderer(model, "flat", "software").draw(data, "ego", 48)).all()
print(len(said), said[0].message, drawn_by())
for view, kind, wanted in (("scene", "lit", None), ("ego", "flat", "opengl")):
    try:
        new_renderer(model, kind, wanted).draw(data, view, 48)
    except RenderingError:
        print("RenderingError")
"""


@pytest.mark.skipif(sys.platform != "linux", reason="hides the driver as Linux finds it")
@pytest.mark.parametrize(
    "variables",
    [{}, {"MUJOCO_GL": "nonsense"}],
    ids=str,
)
def test_without_opengl_flat_views_are_drawn_all_the_same(variables: dict[str, str]) -> None:
    """With one warning that says so."""
    result = subprocess.run(
        [sys.executable, "-c", FALLBACK],
        env=BARE | {"DISPLAY": "", "WAYLAND_DISPLAY": ""} | NO_DRIVER | variables,
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    warning, *errors = result.stdout.splitlines()
    assert warning.startswith("1 ")
    assert "software renderer" in warning
    assert warning.endswith("software")
    assert errors == ["RenderingError"] * 2
