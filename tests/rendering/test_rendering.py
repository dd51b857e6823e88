"""Pictures: their geometry and colours, the reference images, sharing one canvas, and machines without OpenGL."""

from __future__ import annotations

import threading
from pathlib import Path

import mujoco
import numpy as np
import pytest
from PIL import Image

import magical_mj
from magical_mj.assets import style
from magical_mj.engine.export import mjcf_text
from magical_mj.engine.simulation import Simulation
from magical_mj.rendering.opengl import CANVASES, KEPT, OpenGLRenderer, on_white
from magical_mj.rendering.picture import DRAWN_GROUPS, LARGEST, check_size
from magical_mj.scene import Block, GoalRegion, Robot, Scene
from magical_mj.scene import constants as c
from magical_mj.utils.errors import RenderingError

IMAGES = Path(__file__).parents[1] / "data" / "images"
VIEWS = ("ego", "allo")

GALLERY = Scene(
    Robot(0.1, -0.6, 0.0),
    tuple(
        Block(shape, colour, x, 0.1, 0.4)
        for shape, colour, x in zip(c.SHAPES, c.COLOURS, (-0.75, -0.25, 0.25, 0.75), strict=True)
    ),
    tuple(GoalRegion(colour, x, 0.4, x + 0.5, 0.9) for colour, x in (("red", -0.9), ("blue", -0.25), ("green", 0.4))),
)


def draw(scene: Scene, view: str, size: int = 96) -> np.ndarray:
    return Simulation.of(scene).draw(view, size)


def allo_pixel(x: float, y: float, size: int) -> tuple[int, int]:
    """Row and column of a point of the world."""
    return int((0.5 - y / c.VISIBLE_SIZE) * size), int((0.5 + x / c.VISIBLE_SIZE) * size)


def centre_of(picture: np.ndarray, rgb: style.Rgb) -> np.ndarray:
    """Mean position of the pixels of a colour: (row, column) as fractions of the picture."""
    places = np.argwhere((picture == rgb).all(axis=2))
    assert len(places)
    return (places.mean(axis=0) + 0.5) / len(picture)


def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.abs(one.astype(float) - other)


# What is seen


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize("task", [task for task in magical_mj.TASKS if list(IMAGES.glob(f"{task}-Demo-*"))])
def test_demo_looks_like_the_original(task: str, view: str) -> None:
    with Image.open(IMAGES / f"{task}-Demo-{view}-96.png") as reference:
        expected = np.asarray(reference.convert("RGB"))
    found = draw(magical_mj.sample_scene(task, "Demo", 0), view)
    assert difference(found, expected).mean() <= 3.0


@pytest.mark.parametrize("size", [192, 384])
def test_allo_shows_every_point_in_its_place_and_exact_colour(size: int) -> None:
    picture = draw(GALLERY, "allo", size)
    for block in GALLERY.blocks:
        assert tuple(picture[allo_pixel(block.x, block.y, size)]) == style.BLOCK_FILL[block.colour]
    for region in GALLERY.regions:
        assert tuple(picture[allo_pixel(*region.centre, size)]) == style.REGION_FILL[region.colour]
    robot = GALLERY.robot
    assert tuple(picture[allo_pixel(robot.x, robot.y - c.ROBOT_RADIUS / 2, size)]) == style.GREY
    assert tuple(picture[allo_pixel(0, -0.2, size)]) == style.WHITE
    assert tuple(picture[0, 0]) == style.LIGHT_GREY


@pytest.mark.parametrize(("x", "y", "angle"), [(0, 0, 0), (0.4, -0.3, 0.7), (-0.5, 0.2, -2.5)])
def test_ego_keeps_the_robot_in_place_and_heading_up(x: float, y: float, angle: float) -> None:
    def world(right: float, ahead: float) -> tuple[float, float]:
        """A point that is so far to the right of the robot and ahead of it."""
        cosine, sine = np.cos(angle), np.sin(angle)
        return x + cosine * right - sine * ahead, y + sine * right + cosine * ahead

    block = Block("circle", "blue", *world(0.25, 0.4), 0)
    picture = draw(Scene(Robot(x, y, angle), (block,)), "ego", 384)
    assert tuple(picture[int(0.87 * 384), 192]) == style.GREY
    edges = np.argwhere((picture[int(0.85 * 384)] == style.GREY).all(axis=1))
    assert (edges.min() + edges.max() + 1) / 2 / 384 == pytest.approx(0.5, abs=0.005)
    centre = centre_of(picture, style.BLOCK_FILL["blue"])
    np.testing.assert_allclose(centre, (0.85 - 0.4 / c.VISIBLE_SIZE, 0.5 + 0.25 / c.VISIBLE_SIZE), atol=0.005)
    assert centre_of(picture, style.BLACK)[0] < 0.85  # it looks ahead


def test_later_things_hide_earlier_ones() -> None:
    """Regions lie below blocks; fingers and body above."""
    scene = Scene(Robot(0, -0.2, 0), (Block("square", "red", 0, 0.4, 0),), (GoalRegion("green", -0.4, -0.4, 0.4, 0.6),))
    picture = draw(scene, "allo")
    assert tuple(picture[allo_pixel(0, 0.4, 96)]) == style.BLOCK_FILL["red"]
    assert tuple(picture[allo_pixel(0, -0.3, 96)]) == style.GREY
    assert tuple(picture[allo_pixel(-0.3, 0.1, 96)]) == style.REGION_FILL["green"]


@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize("task", ["FixColour", "FindDupe", "ClusterShape"])
def test_any_mujoco_viewer_shows_the_same(task: str, rounded: bool) -> None:
    """MuJoCo's own renderer, with a depth buffer, if told to show what the task cameras see and to light it evenly.

    Rounded coordinates, as files have them, are seen in at most one of 10,000 pixels.
    """
    scene = magical_mj.sample_scene(task, "Demo", 0)
    model = mujoco.MjModel.from_xml_string(mjcf_text(scene, rounded=rounded))
    model.vis.global_.offwidth = model.vis.global_.offheight = 768
    model.vis.quality.offsamples = 0
    model.light_active[:] = 0
    model.geom("workspace").group = style.TASK_GROUP  # the white that we paint on
    model.vis.headlight.ambient[:], model.vis.headlight.diffuse[:] = 1, 0
    option = mujoco.MjvOption()
    option.geomgroup[:] = option.skingroup[:] = [group in DRAWN_GROUPS for group in range(6)]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    renderer = mujoco.Renderer(model, 768, 768)
    for view in VIEWS:
        renderer.update_scene(data, view, option)
        theirs = renderer.render().astype(float).reshape(384, 2, 384, 2, 3).mean(axis=(1, 3))
        assert (difference(theirs, draw(scene, view, 384)) > 1.0).mean() <= (1e-4 if rounded else 0)
    renderer.close()


def test_the_solid_view_shows_everything_with_light_and_shadow() -> None:
    picture = draw(GALLERY, "scene", 128).astype(int)
    for palette, colour in ((style.BLOCK_FILL, "yellow"), (style.REGION_FILL, "blue"), (style.BLOCK_FILL, "red")):
        assert (np.abs(picture - palette[colour]).max(axis=2) <= 4).sum() > 20  # a lit top has its palette's colour
    assert (picture == 255).all(axis=2).mean() > 0.1  # the workspace
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100  # sides and shadows; flat views have 20 colours inside
    border = np.concatenate([picture[0], picture[-1], picture[:, 0], picture[:, -1]])
    assert np.ptp(border, axis=0).max() <= 3  # nothing but ground: all is in sight, and no shadow has speckles


def test_the_first_picture_of_the_scene_is_as_the_next() -> None:
    """The headlight is at the camera, also in the first one."""
    engine = magical_mj.Engine("MoveToRegion", seed=0)
    np.testing.assert_array_equal(engine.render("scene", 384), engine.render("scene", 384))


def test_the_solid_view_does_not_change_other_pictures() -> None:
    simulation = Simulation.of(GALLERY)
    before = {view: simulation.draw(view, 96) for view in VIEWS}
    solid = simulation.draw("scene", 64)
    for view in VIEWS:
        np.testing.assert_array_equal(simulation.draw(view, 96), before[view])
    np.testing.assert_array_equal(draw(GALLERY, "scene", 64), solid)
    CANVASES.close()
    np.testing.assert_array_equal(simulation.draw("scene", 64), solid)


def test_averaging_is_exact_on_white_paper() -> None:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (24, 16, 4), np.uint8)
    pixels[..., 3] = 255 * rng.integers(0, 2, (24, 16))
    pixels[pixels[..., 3] == 0] = 0
    sums = pixels[::-1].reshape(12, 2, 8, 2, 4).sum(axis=(1, 3))
    averages = (sums + 2) // 4  # rounded
    expected = averages[..., :3] + 255 - averages[..., 3:]
    places = np.zeros((12, 8, 7), np.uint8)
    on_white(pixels, places[..., 2:5])
    np.testing.assert_array_equal(places[..., 2:5], expected)
    assert not places[..., [0, 1, 5, 6]].any()


@pytest.mark.parametrize("size", [1, 3, 97, LARGEST])
def test_pictures_of_any_size_are_fresh_arrays(size: int) -> None:
    simulation = Simulation.of(GALLERY)
    first, second = (simulation.draw("ego", size) for _ in range(2))
    assert first.shape == (size, size, 3)
    assert first.flags.c_contiguous
    first[:] = 1
    assert (second != 1).any()


@pytest.mark.parametrize("size", [0, -1, LARGEST + 1, 9.5, True, "96", None])
def test_sizes_are_checked(size: object) -> None:
    with pytest.raises(ValueError, match="image_size"):
        check_size(size)


# One canvas for all


def test_interleaved_simulations_draw_what_each_draws_alone() -> None:
    scenes = [magical_mj.sample_scene(task, "All", 1) for task in magical_mj.TASKS]
    alone = {
        (k, view, size): draw(scene, view, size)
        for k, scene in enumerate(scenes)
        for view in VIEWS
        for size in (96, 64, 200)
    }
    CANVASES.close()
    simulations = [Simulation.of(scene) for scene in scenes]
    keys = list(alone)
    for choice in np.random.default_rng(0).integers(len(keys), size=300):
        k, view, size = keys[choice]
        np.testing.assert_array_equal(simulations[k].draw(view, size), alone[keys[choice]])
    assert CANVASES.draw(lambda canvas: len(canvas.drawings)) <= 4  # as many as numbers of regions


def test_foreign_models_are_drawn_too_and_disturb_nobody() -> None:
    ours = Simulation.of(GALLERY)
    before = ours.draw("allo", 96)
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><asset><texture name="t" type="2d" builtin="checker" width="8" height="8" rgb1="1 0 0" rgb2="0 1 0"/>'
        '<material name="t" texture="t"/></asset><worldbody><camera name="c" pos="0 0 3"/>'
        '<geom type="plane" size="1 1 .1" material="t"/></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    red, green, blue = OpenGLRenderer(model).draw(data, "c", 96).reshape(-1, 3).mean(axis=0)
    assert min(red, green) > blue
    np.testing.assert_array_equal(ours.draw("allo", 96), before)


def test_drawing_contexts_are_few_however_many_kinds_of_models_are_drawn() -> None:
    """Each of these has a mesh of its own; those whose context was freed are drawn as before."""

    def shown(width: float) -> int:
        corners = f"{-width} -.5 0  {width} -.5 0  {width} .5 0  {-width} .5 0  0 0 .01"
        model = mujoco.MjModel.from_xml_string(
            f'<mujoco><asset><mesh name="m" vertex="{corners}"/></asset><worldbody>'
            '<camera name="c" pos="0 0 3"/><geom type="mesh" mesh="m" rgba="1 0 0 1"/></worldbody></mujoco>'
        )
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return int((OpenGLRenderer(model).draw(data, "c", 96) == (255, 0, 0)).all(axis=2).sum())

    widths = np.linspace(0.1, 0.9, KEPT + 4)
    areas = [shown(width) for width in widths]
    assert sorted(set(areas)) == areas
    assert [shown(width) for width in widths] == areas
    assert CANVASES.draw(lambda canvas: len(canvas.drawings)) == KEPT


def test_things_that_users_add_are_drawn() -> None:
    pytest.importorskip("dm_control", reason="dm_control does not install here")
    env = magical_mj.load_scene(Scene(Robot(0.5, -0.5, 0)))
    look = {"size": [0.2], "rgba": [0, 0, 1, 1], "group": 0}
    env.task.root_entity.mjcf_model.worldbody.add("geom", name="ball", type="sphere", pos=[-0.5, 0.5, 0], **look)
    picture = env.reset().observation["allo"]
    assert tuple(picture[allo_pixel(-0.5, 0.5, 96)]) == (0, 0, 255)


def test_drawing_does_not_disturb_dm_control() -> None:
    """It expects its OpenGL context to stay current."""
    pytest.importorskip("dm_control", reason="dm_control does not install here")
    env = magical_mj.load_scene(GALLERY, image_size=64)
    ours, theirs = env.reset().observation["ego"], env.physics.render(64, 64, "robot/ego")
    for _ in range(3):
        np.testing.assert_array_equal(env.render("ego", 64), ours)
        np.testing.assert_array_equal(env.physics.render(64, 64, "robot/ego"), theirs)
    env.close()
    np.testing.assert_array_equal(draw(GALLERY, "ego", 64), ours)


def test_drawing_does_not_disturb_mujocos_renderers() -> None:
    """They free their things in whichever OpenGL context is current, sometimes ours."""
    env = magical_mj.Engine.of_scene(GALLERY)
    ours = env.render("ego", 64)
    renderers = [mujoco.Renderer(env.model, 64, 64) for _ in range(3)]
    for renderer in renderers:
        renderer.update_scene(env.data, "ego")
        theirs = renderer.render()
        np.testing.assert_array_equal(env.render("ego", 64), ours)
        np.testing.assert_array_equal(renderer.render(), theirs)
    for renderer in reversed(renderers):
        renderer.close()
        np.testing.assert_array_equal(env.render("ego", 64), ours)


def test_the_canvas_can_be_closed_and_opened_again() -> None:
    simulation = Simulation.of(GALLERY)
    before = simulation.draw("ego", 96)
    CANVASES.close()
    CANVASES.close()
    np.testing.assert_array_equal(simulation.draw("ego", 96), before)


def test_each_thread_has_a_canvas_of_its_own() -> None:
    expected = draw(GALLERY, "ego")
    found = []

    def work() -> None:
        found.append(draw(GALLERY, "ego"))
        CANVASES.close()

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    for picture in found:
        np.testing.assert_array_equal(picture, expected)


def test_translucent_geoms_are_refused_in_flat_views_and_blend_in_three_dimensions() -> None:
    env = magical_mj.load("MoveToRegion", observations=())
    glass = {"type": "box", "size": [0.3, 0.3, 0.05], "pos": [0, 0, 0.5], "rgba": [0, 0, 1, 0.5]}
    env.task.root_entity.mjcf_model.worldbody.add("geom", name="glass", **glass)
    env.reset()
    with pytest.raises(RenderingError, match="translucent: glass"):
        env.render("allo", 32)
    seen = env.render("scene", 64).astype(int)
    changed = seen[(seen != magical_mj.Engine("MoveToRegion").render("scene", 64)).any(axis=2)]
    bluer = changed[:, 2] - changed[:, 0]
    assert bluer.max() > 100
    assert np.mean(bluer >= 0) > 0.95
