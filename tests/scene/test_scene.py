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
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, sample_scene
from magical_mj.utils.errors import InvalidSceneError, MagicalError

SCENE = Scene(
    robot=Robot(0.1, -0.2, math.pi, fingers=(0.1, -0.3)),
    blocks=(Block("star", "red", 0.1 + 0.2, 1e-17, -7.5), Block("circle", "blue", -0.5, 0.5, 0.0)),
    regions=(GoalRegion("green", -0.9, -0.8, -0.3, 1 / 3),),
    dynamics=Dynamics(drive_force=2.345678901234567),
)


def test_a_scene_is_an_immutable_hashable_value() -> None:
    twin = Scene.from_json(SCENE.to_json())
    assert twin == SCENE
    assert hash(twin) == hash(SCENE)
    assert len({twin, SCENE}) == 1
    with pytest.raises(dataclasses.FrozenInstanceError):
        SCENE.robot.x = 0.0  # type: ignore[misc]


@pytest.mark.parametrize("scene", [SCENE, Scene(Robot(0, 0, 0)), *(sample_scene(task, "All", 3) for task in TASKS)])
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
    found = {scene.to_json(): scene for name in variants for scene in (sample_scene(task, name, s) for s in range(30))}
    changed = [scene.moved(robot=(scene.robot.x, 0.0, 1.0)) for scene in found.values()]
    found |= {scene.to_json(): scene for scene in changed}
    assert len({scene.digest() for scene in found.values()}) == len(found)


@dataclass(frozen=True, slots=True)
class Labelled(Block):
    """A block of a later version, which has one more field."""

    label: str = ""


def test_a_field_that_is_added_later_stays_when_things_move_and_changes_no_digest() -> None:
    pose = ("star", "red", 0.5, 0.5, 0.0)
    plain, same, other = (Scene(Robot(0, 0, 0), (b,)) for b in (Block(*pose), Labelled(*pose), Labelled(*pose, "a")))
    assert same.digest() == plain.digest() != other.digest()
    assert other.moved(blocks=[(0.1, 0.2, 0.3)]).blocks == (Labelled("star", "red", 0.1, 0.2, 0.3, "a"),)
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
    ("make", "arguments", "message"),
    [
        (Block, ("hexagon", "red", 0, 0, 0), "Block.shape is 'hexagon'; it must be one of square"),
        (Block, ("star", "pink", 0, 0, 0), "Block.colour is 'pink'; it must be one of red"),
        (Robot, (math.nan, 0, 0), "Robot.x must be finite"),
        (Robot, (0, "1", 0), "Robot.y must be a number, not '1'"),
        (Robot, (0, True, 0), "Robot.y must be a number, not True"),
        (Robot, (0, np.True_, 0), "Robot.y must be a number, not np.True_"),
        (Robot, (0, np.array([1.0]), 0), r"Robot.y must be a number, not array\(\[1.\]\)"),
        (Robot, (0, 1j, 0), "Robot.y must be a number, not 1j"),
        (Robot, (0, np.complex64(1), 0), "Robot.y must be a number, not np.complex64"),
        (Robot, (0, None, 0), "Robot.y must be a number, not None"),
        (Robot, (0, "7" * 10_000, 0), r"Robot.y must be a number, not '7{79}\.\.\.$"),
        (Robot, (10**400, 0, 0), r"Robot.x must be finite and at most 1e\+10, not 10{79}\.\.\.$"),
        (Robot, (10**5000, 0, 0), r"Robot.x must be finite and at most 1e\+10, not a value of type int$"),
        (Robot, (0, 0, 1e308), r"Robot.angle must be finite and at most 1e\+10, not 1e\+308"),
        (Robot, (0, 0, -math.inf), "Robot.angle must be finite"),
        (Robot, (0, 0, 0, (math.nan, 0)), "Robot.fingers must be finite"),
        (Robot, (0, 0, 0, "ab"), r"Robot.fingers must be two angles \(left, right\), not 'ab'"),
        (GoalRegion, ("red", -1e300, 0, 1e300, 1), "GoalRegion.x_min must be finite and at most"),
        (Block, (["star"], "red", 0, 0, 0), r"Block.shape is \['star'\]"),
        (Block, (np.array(["star", "star"]), "red", 0, 0, 0), "Block.shape is array"),
        (Robot, (0, 0, 0, (0.1,)), "two angles"),
        (GoalRegion, ("red", 0.5, 0, 0.5, 1), "is empty"),
        (Dynamics, (3, 0), "Dynamics.turn_torque must be positive"),
        (Scene, ((0, 0, 0),), "needs a Robot"),
        (Scene, (Robot(0, 0, 0), [Robot(0, 0, 0)]), "needs a Block"),
        (Scene, (Robot(0, 0, 0), (), "red"), "must be a sequence of GoalRegion"),
        (Scene, (Robot(0, 0, 0), {Block("star", "red", 0, 0, 0)}), "must be a sequence of Block"),
        (SCENE.moved, (None, [(0, 0, 0)]), "2 blocks need 2 poses, not"),
        (SCENE.moved, ((0, 0),), "a pose is"),
        (SCENE.moved, (5,), "a pose is"),
        (SCENE.moved, (None, 5), "2 blocks need 2 poses, not 5"),
        (SCENE.moved, (None, [(0, 0, 0), (0, math.nan, 0)]), "Block.y must be finite"),
    ],
)
def test_what_is_not_a_scene_is_refused(make: Callable[..., Any], arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        make(*arguments)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "must be JSON"),
        ("[]", "must be a JSON object"),
        (None, "must be JSON"),
        (b"\xff", "must be JSON"),
        ("[" * 100_000, "must be JSON"),
        ('{"a":' * 100_000, "must be JSON"),
        ("1" * 5000, "must be JSON"),
        ('{"format": true}', '"format": 1'),
        ('{"format": 1.0}', '"format": 1'),
        ('{"format": [1]}', '"format": 1'),
        ('{"format": 1, "robot": {"x": 0, "x": 1, "y": 0, "angle": 0}}', "'x' occurs twice in one object"),
        ('{"format": 1, "robot": {"x": 1e400, "y": 0, "angle": 0}}', "Robot.x must be finite"),
        (f'{{"format": 1, "robot": {{"x": 1{"0" * 400}, "y": 0, "angle": 0}}}}', "Robot.x must be finite"),
        ('{"format": 1, "robot": {"x": true, "y": 0, "angle": 0}}', "Robot.x must be a number, not True"),
        ('{"format": 1, "robot": {"x": [0], "y": 0, "angle": 0}}', r"Robot.x must be a number, not \[0\]"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0, "fingers": [NaN, 0]}}', "Robot.fingers must be finite"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0, "fingers": 1}}', "must be two angles"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0}, "blocks": [null]}', "Block must be a JSON object"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0}, "dynamics": null}', "Dynamics must be a JSON object"),
        (
            '{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0}, "dynamics": {"drive_force": -1}}',
            "Dynamics.drive_force must be positive",
        ),
        ("{}", '"format": 1'),
        ('{"format": 2}', '"format": 1'),
        ('{"format": 1}', "lacks the field 'robot'"),
        ('{"format": 1, "robot": []}', "Robot must be a JSON object"),
        ('{"format": 1, "robot": {"x": 0, "y": 0}}', "lacks the field 'angle'"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0, "z": 0}}', "no field 'z'; it has x, y, angle, fingers"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": NaN}}', "must be finite"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0}, "blocks": {}}', "must be a list"),
        ('{"format": 1, "robot": {"x": 0, "y": 0, "angle": 0}, "walls": 4}', "no field 'walls'"),
    ],
)
def test_malformed_json_is_refused(text: Any, message: str) -> None:
    with pytest.raises(InvalidSceneError, match=message):
        Scene.from_json(text)


def test_users_can_catch_every_error_as_one_kind() -> None:
    assert issubclass(InvalidSceneError, MagicalError)
    assert issubclass(InvalidSceneError, ValueError)
