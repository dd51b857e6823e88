"""Scenes: immutable values with an exact JSON form, and clear errors for what is not a scene."""

from __future__ import annotations

import dataclasses
import json
import math
import pickle
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from magical_mj.scene import Block, Dynamics, GoalRegion, Robot, Scene
from magical_mj.scene.bodies import Body
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, sample_scene
from magical_mj.utils.errors import InvalidSceneError, MagicalError

SCENE = Scene(
    robot=Robot(0.1, -0.2, math.pi, fingers=(0.1, -0.3)),
    blocks=(Block("star", "red", 0.1 + 0.2, 1e-17, -7.5), Block("circle", "blue", -0.5, 0.5, 0.0)),
    regions=(GoalRegion("green", -0.9, -0.8, -0.3, 1 / 3),),
    dynamics=Dynamics(drive_force=2.345678901234567),
)


@pytest.mark.parametrize("wrong", ["pentagram", "beside the origin"])
def test_bodies_are_convex_and_around_the_origin(wrong: str) -> None:
    turns = {"pentagram": 2, "beside the origin": 1}[wrong]
    angles = 2 * np.pi * turns * np.arange(5) / 5
    corners = 0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=1) + 0.2 * (wrong != "pentagram")
    with pytest.raises(InvalidSceneError, match="convex polygon around the origin"):
        Body(tuple(map(tuple, corners.tolist())))


def test_a_scene_is_an_immutable_hashable_value() -> None:
    twin = Scene.from_json(SCENE.to_json())
    assert twin == SCENE
    assert hash(twin) == hash(SCENE)
    assert len({twin, SCENE}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        SCENE.robot.x = 0.0  # type: ignore[misc]


@pytest.mark.parametrize(
    "scene",
    [SCENE, Scene(Robot(0, 0, 0)), Scene(Robot(1e-320, 0, 0)), *(sample_scene(task, "All", 3) for task in TASKS)],
)
def test_json_and_pickle_give_the_same_scene_bit_for_bit(scene: Scene) -> None:
    for copy in (Scene.from_json(scene.to_json()), Scene.from_json(scene.to_json().encode())):
        assert copy == scene
        assert copy.to_json() == scene.to_json()
    assert pickle.loads(pickle.dumps(scene)) == scene


def test_the_json_is_plain_and_says_its_format() -> None:
    data = json.loads(SCENE.to_json())
    assert data["format"] == 1
    assert data["blocks"][1] == {"shape": "circle", "colour": "blue", "x": -0.5, "y": 0.5, "angle": 0.0}
    del data["blocks"], data["regions"], data["dynamics"]
    assert Scene.from_json(json.dumps(data)) == Scene(SCENE.robot)


def test_digests_are_equal_exactly_for_equal_scenes() -> None:
    assert Scene(Robot(0.0, -0.0, 0)).digest() == Scene(Robot(0, 0.0, -0.0)).digest()
    assert SCENE.moved(robot=(0.1, -0.2, math.nextafter(math.pi, 4))).digest() != SCENE.digest()


@pytest.mark.parametrize("task", TASKS)
def test_digests_without_defaults_tell_the_same_scenes_apart_as_the_whole_text(task: str) -> None:
    """Digests were once those of `to_json`, in which every field stands."""
    variants = [variant for name, variant in ENVIRONMENTS if name == task]
    scenes = {scene.to_json(): scene for name in variants for scene in (sample_scene(task, name, s) for s in range(30))}
    changed = [scene.moved(robot=(scene.robot.x, 0.0, 1.0)) for scene in scenes.values()]
    scenes |= {scene.to_json(): scene for scene in changed}
    assert len({scene.digest() for scene in scenes.values()}) == len(scenes)


@dataclass(frozen=True, slots=True)
class Labelled(Block):
    """A block of a later version, which has one more field."""

    label: str = ""


def test_a_field_that_is_added_later_stays_when_things_move_and_changes_no_digest() -> None:
    pose = ("star", "red", 0.5, 0.5, 0.0)
    plain, same, other = (
        Scene(Robot(0, 0, 0), (b,)) for b in (Block(*pose), Labelled(*pose), Labelled(*pose, label="a"))
    )
    assert same.digest() == plain.digest() != other.digest()
    assert other.moved(blocks=[(0.1, 0.2, 0.3)]).blocks == (Labelled("star", "red", 0.1, 0.2, 0.3, label="a"),)
    assert other.moved(robot=(0.1, 0.2, 0.3)).blocks == other.blocks


def test_numbers_of_any_kind_become_plain_floats() -> None:
    robot = Robot(np.float32(0.5), np.int64(1), 2, fingers=np.array([0.25, -0.25]))  # type: ignore[arg-type]
    assert robot == Robot(0.5, 1.0, 2.0, (0.25, -0.25))
    assert {type(value) for value in (robot.x, robot.y, robot.angle, *robot.fingers)} == {float}
    assert Robot(Fraction(1, 2), Decimal("0.25"), np.array(1.5)) == Robot(0.5, 0.25, 1.5)  # type: ignore[arg-type]
    block = Block(np.str_("star"), np.str_("red"), 0, 0, 0)  # type: ignore[arg-type]
    assert {type(block.shape), type(block.colour)} == {str}


def test_moved_changes_poses_only() -> None:
    moved = SCENE.moved(robot=(0.0, 0.5, 1.0), blocks=[(0.7, 0.7, 0.1), (-0.7, 0.7, 0.2)])
    assert moved.robot == Robot(0.0, 0.5, 1.0, SCENE.robot.fingers)
    assert [block.pose for block in moved.blocks] == [(0.7, 0.7, 0.1), (-0.7, 0.7, 0.2)]
    assert [(block.shape, block.colour) for block in moved.blocks] == [("star", "red"), ("circle", "blue")]
    assert (moved.regions, moved.dynamics) == (SCENE.regions, SCENE.dynamics)
    assert SCENE.moved() == SCENE
    assert SCENE.moved(robot=moved.robot.pose).blocks == SCENE.blocks


def test_a_region_contains_centres_borders_included() -> None:
    region = GoalRegion("red", -0.5, -0.25, 0.5, 0.25)
    assert (region.width, region.height, region.centre) == (1.0, 0.5, (0.0, 0.0))
    for x, y, inside in [
        (0, 0, True),
        (0.5, 0.25, True),
        (-0.5, -0.25, True),
        (math.nextafter(0.5, 1), 0, False),
        (0, math.nextafter(-0.25, -1), False),
    ]:
        assert region.contains(Block("circle", "red", x, y, 0)) is inside
        assert region.contains(Robot(x, y, 0)) is inside


@pytest.mark.parametrize(
    ("make", "arguments", "word"),
    [
        (Block, ("hexagon", "red", 0, 0, 0), "shape"),
        (Block, (["star"], "red", 0, 0, 0), "shape"),
        (Block, ("star", "pink", 0, 0, 0), "colour"),
        *(
            (Robot, (0, wrong, 0), "number")
            for wrong in ("1", True, np.True_, np.array([1.0]), 1j, np.complex64(1), None)
        ),
        *((Robot, (wrong, 0, 0), "finite") for wrong in (math.nan, -math.inf, 1e308, 10**400, 10**5000)),
        (Robot, (0, 0, 0, (math.nan, 0)), "fingers"),
        (Robot, (0, 0, 0, "ab"), "two angles"),
        (Robot, (0, 0, 0, (0.1,)), "two angles"),
        (GoalRegion, ("red", -1e300, 0, 1e300, 1), "finite"),
        (GoalRegion, ("red", 0.5, 0, 0.5, 1), "empty"),
        (Dynamics, (3, 0), "positive"),
        (Scene, ((0, 0, 0),), "Robot"),
        (Scene, (Robot(0, 0, 0), [Robot(0, 0, 0)]), "Block"),
        (Scene, (Robot(0, 0, 0), (), "red"), "GoalRegion"),
        (Scene, (Robot(0, 0, 0), {Block("star", "red", 0, 0, 0)}), "sequence"),
        (SCENE.moved, (None, [(0, 0, 0)]), "2 poses"),
        (SCENE.moved, (5,), "pose"),
        (SCENE.moved, (None, [(0, 0, 0), (0, math.nan, 0)]), "finite"),
    ],
)
def test_malformed_scenes_are_refused(make: Callable[..., Any], arguments: tuple[Any, ...], word: str) -> None:
    with pytest.raises(InvalidSceneError, match=word) as caught:
        make(*arguments)
    assert len(str(caught.value)) < 250


ROBOT = '"robot": {"x": 0, "y": 0, "angle": 0}'


@pytest.mark.parametrize(
    ("text", "word"),
    [
        *((text, "JSON") for text in ("{", "[]", None, b"\xff", "[" * 100_000, '{"a":' * 100_000, "1" * 5000)),
        *(
            (text, "format")
            for text in ("{}", '{"format": 2}', '{"format": true}', '{"format": 1.0}', '{"format": [1]}')
        ),
        ('{"format": 1}', "robot"),
        ('{"format": 1, "robot": []}', "JSON object"),
        ('{"format": 1, "robot": {"x": 0, "y": 0}}', "angle"),
        ('{"format": 1, "robot": {"x": 0, "x": 1, "y": 0, "angle": 0}}', "twice"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0, "z": 0}}', "'z'"),
        ('{"format": 1, "robot": {"x": 1e400, "y": 0, "angle": 0}}', "finite"),
        ('{"format": 1, "robot": {"x": [0], "y": 0, "angle": NaN}}', "number"),
        (f'{{"format": 1, {ROBOT}, "blocks": [null]}}', "JSON object"),
        (f'{{"format": 1, {ROBOT}, "blocks": {{}}}}', "list"),
        (f'{{"format": 1, {ROBOT}, "dynamics": null}}', "JSON object"),
        (f'{{"format": 1, {ROBOT}, "dynamics": {{"drive_force": -1}}}}', "positive"),
        (f'{{"format": 1, {ROBOT}, "walls": 4}}', "'walls'"),
    ],
)
def test_malformed_json_is_refused(text: Any, word: str) -> None:
    with pytest.raises(InvalidSceneError, match=word):
        Scene.from_json(text)


def test_users_can_catch_every_error_as_one_kind() -> None:
    assert issubclass(InvalidSceneError, MagicalError)
    assert issubclass(InvalidSceneError, ValueError)
