"""The things of a scene as composer's entities: arena, robot and blocks, each with an MJCF tree of its own.

The trees are parsed from the text of which an engine's model is compiled. So together they compile to that model, apart
from names: those of the robot's and of a block's parts begin with "robot/" and "block0/", as composer has it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Final
from xml.etree.ElementTree import Element, tostring

from dm_control import composer, mjcf

from magical_mj.assets.block import block_mjcf, block_pair, pebble_library, pebble_mjcf, pebble_pair
from magical_mj.assets.contacts import SETTINGS, default_classes
from magical_mj.assets.mjcf import elements
from magical_mj.assets.region import regions_mjcf
from magical_mj.assets.robot import actuators_mjcf, robot_mjcf, robot_pairs, tendons_mjcf
from magical_mj.assets.world import APART, world_mjcf
from magical_mj.scene import Scene
from magical_mj.scene.bodies import body_named

NAMESPACES: Final = {"body": "body", "joint": "joint", "geom": "geom", "fixed": "tendon"}
"""The elements whose numbers and colours a scene determines -> what composer calls them."""
FIXED: Final = ("name", "class", "mesh")
"""Attributes of them that stay as they are."""


class Thing(composer.Entity):
    """A planar body: the robot, or a block. Its joints are in the frame by which it is attached to the arena."""

    def _build(self, name: str, mjcf_of: Callable[[Scene], str], scene: Scene, more: str = "") -> None:
        """Parses the tree of this name, from the thing's MJCF in a scene (its body, and its tendons) and some more."""
        self._mjcf_of = mjcf_of
        body, others = self._elements(scene)
        content = "".join(tostring(part, "unicode") for part in body if part.tag in ("geom", "body", "camera"))
        tendons = "".join(tostring(part, "unicode") for part in others)
        self._model = mjcf.from_xml_string(
            f'<mujoco model="{name}"><compiler angle="radian" autolimits="true"/><default>{default_classes()}</default>'
            f"<worldbody>{content}</worldbody><tendon>{tendons}</tendon>{more}</mujoco>"
        )

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree."""
        return self._model

    def attach_to(self, arena: Arena, scene: Scene) -> None:
        """Puts the thing into the arena, with its joints. Its meshes are those of the arena."""
        frame = arena.attach(self)
        body, others = self._elements(scene)
        joints = {part.get("name"): frame.add("joint", **_attributes(part)) for part in body.findall("joint")}
        for part in body.findall("inertial"):
            frame.add("inertial", **part.attrib)
        for tendon in others:  # those of the frame's joints would be searched in the tree
            for part, term in zip(tendon, self._model.find("tendon", tendon.get("name")).joint, strict=True):
                if part.get("joint") in joints:
                    term.joint = joints[part.get("joint")]
        for geom in self._model.find_all("geom", exclude_attachments=True):
            if isinstance(geom.mesh, str):
                geom.mesh = arena.mjcf_model.find("mesh", geom.mesh)

    def show(self, scene: Scene) -> None:
        """Writes the numbers and colours of the scene into the tree."""
        body, others = self._elements(scene)
        frame = mjcf.get_attachment_frame(self._model)
        frame.set_attributes(**{name: value for name, value in body.attrib.items() if name != "name"})
        joints = {joint.name: joint for joint in frame.find_all("joint", immediate_children_only=True)}
        for element in (*list(body.iter())[1:], *others):
            namespace, name = NAMESPACES.get(element.tag), element.get("name")
            target = joints.get(name) or (self._model.find(namespace, name) if namespace and name else None)
            if target is not None:
                target.set_attributes(**{key: value for key, value in element.attrib.items() if key not in FIXED})

    def _elements(self, scene: Scene) -> tuple[Element, list[Element]]:
        """The body and the tendons."""
        body, *others = _without_comments(self._mjcf_of(scene))
        return body, others


class Arena(composer.Entity):
    """The root entity: ground, walls, lights, the camera "allo", and the goal regions. Robot and blocks are attached.

    What users add to the trees stays there. A block has a tree of its own for each shape that it has had. The
    attributes `robot`, `blocks` and `pebbles` are in the order of the scene.
    """

    def _build(self, scene: Scene) -> None:
        body = scene.robot.body
        self._model = mjcf.from_xml_string(world_mjcf(scene, empty=True))
        self._model.size.memory = str(33 * 2**20)  # as dm_control writes it once trees are attached anew
        apart = APART if body_named(body).fingers else ""
        more = f"<actuator>{actuators_mjcf(body)}</actuator><contact>{apart}</contact>"
        self.robot = Thing("robot", _robot, scene, more)
        self.blocks: list[Thing] = []
        self.pebbles: list[Thing] = []
        self._things: dict[tuple[str, str], Thing] = {}  # all blocks so far: parsing one takes 40 ms
        self._pairs: list[Any] = []
        self._skins: list[Any] = []
        self._shapes: tuple[list[str], int] | None = None
        self.show(scene)

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree."""
        return self._model

    def show(self, scene: Scene) -> None:
        """Makes the trees those of this scene."""
        shapes = [str(block.shape) for block in scene.blocks], len(scene.pebbles)
        if shapes != self._shapes:
            self._replace_blocks(scene)
            self._shapes = shapes
        for thing in (*self.blocks, self.robot, *self.pebbles):
            thing.show(scene)
        for pair, attributes in zip(self._pairs, _pairs(scene), strict=True):
            pair.friction = attributes["friction"]
        for skin in self._skins:
            skin.remove()
        self._skins = []
        for element in elements(regions_mjcf(scene.regions)):
            skin = self._model.deformable.add("skin", **element.attrib)
            for bone in element:
                skin.add(bone.tag, **bone.attrib)
            self._skins.append(skin)

    def _replace_blocks(self, scene: Scene) -> None:
        """Attaches other blocks, and the robot after them: it is drawn over them."""
        for thing in self.blocks if self._shapes is None else (*self.blocks, self.robot, *self.pebbles):
            thing.detach()
        for pair in self._pairs:
            pair.remove()
        if scene.pebbles and self._model.find("mesh", "pebble_outline") is None:
            for mesh in elements(pebble_library()):
                self._model.asset.add("mesh", **mesh.attrib)
        loose = [(f"block{index}", block.shape, partial(_block, index)) for index, block in enumerate(scene.blocks)]
        loose += [(f"pebble{index}", "pebble", partial(_pebble, index)) for index in range(len(scene.pebbles))]
        feet: dict[str, Thing] = {}
        for name, shape, mjcf_of in loose:
            if (name, shape) not in self._things:
                self._things[name, shape] = Thing(name, mjcf_of, scene)
            feet[name] = self._things[name, shape]
        things = list(feet.values())
        self.blocks, self.pebbles = things[: len(scene.blocks)], things[len(scene.blocks) :]
        for thing in (*self.blocks, self.robot, *self.pebbles):
            thing.attach_to(self, scene)
        self._pairs = []
        for attributes in _pairs(scene):
            foot = attributes["geom2"]
            thing = feet.get(foot.removesuffix("_foot"), self.robot)
            geoms = {"geom1": self._model.find("geom", "floor"), "geom2": thing.mjcf_model.find("geom", foot)}
            self._pairs.append(self._model.contact.add("pair", **{**attributes, **geoms}))


def _robot(scene: Scene) -> str:
    robot = scene.robot
    return robot_mjcf(robot, SETTINGS, scene.half_width) + tendons_mjcf(robot, scene.dynamics, SETTINGS)


def _block(index: int, scene: Scene) -> str:
    return block_mjcf(index, scene.blocks[index], scene.dynamics, SETTINGS)


def _pebble(index: int, scene: Scene) -> str:
    return pebble_mjcf(index, scene.pebbles[index])


def _pairs(scene: Scene) -> list[dict[str, str]]:
    """The attributes of the contacts of feet with the floor."""
    feet = "".join(block_pair(index, block, scene.dynamics, SETTINGS) for index, block in enumerate(scene.blocks))
    feet += robot_pairs(scene.robot, scene.dynamics, SETTINGS)
    feet += "".join(pebble_pair(index, SETTINGS) for index in range(len(scene.pebbles)))
    return [_attributes(pair) for pair in _without_comments(feet)]


def _attributes(element: Element) -> dict[str, str]:
    """Those of an element, by dm_control's names."""
    return {"dclass" if name == "class" else name: value for name, value in element.attrib.items()}


def _without_comments(text: str) -> list[Element]:
    return [element for element in elements(text) if isinstance(element.tag, str)]
