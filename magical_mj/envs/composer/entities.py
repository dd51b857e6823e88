"""The things of a scene as composer's entities: arena, robot and blocks, each with an MJCF tree of its own.

The trees are parsed from the text of which an engine's model is compiled. So together they compile to that model, apart
from names: those of the robot's and of a block's parts begin with "robot/" and "block0/", as composer has it.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from itertools import takewhile
from typing import Any, Final
from xml.etree.ElementTree import Element, tostring

from dm_control import composer, mjcf

from magical_mj.assets.block import block_mjcf, block_pair, pebble_library, pebble_mjcf, pebble_pair
from magical_mj.assets.contacts import SETTINGS, TIMESTEP, default_classes
from magical_mj.assets.coordinates import FINGERS
from magical_mj.assets.mjcf import elements
from magical_mj.assets.region import regions_mjcf
from magical_mj.assets.robot import (
    WHEELS,
    actuators,
    actuators_mjcf,
    control_signal,
    robot_mjcf,
    robot_pairs,
    tendons_mjcf,
)
from magical_mj.assets.world import APART, world_mjcf
from magical_mj.envs.composer.observables import (
    ArenaObservables,
    BlockObservables,
    GripperObservables,
    PlanarObservables,
    RobotObservables,
)
from magical_mj.envs.composer.planar import PlanarEntity
from magical_mj.envs.composer.tree import Owned, Watch, refuse
from magical_mj.scene import Scene
from magical_mj.scene.actions import action_number
from magical_mj.scene.bodies import body_named
from magical_mj.utils.errors import InvalidSceneError, SettingsError

NAMESPACES: Final = {"body": "body", "joint": "joint", "geom": "geom", "fixed": "tendon"}
"""The elements of a thing of which the scene determines attributes -> what composer calls them."""
OWNED: Final = {
    "body": ("quat",),
    "joint": ("axis", "ref", "frictionloss"),
    "geom": ("rgba",),
    "fixed": ("frictionloss",),
}
"""The attributes of each. Those of geoms are a block's; the robot's are always the same."""
PLACE: Final = ("pos", "quat")
"""Those of a thing's frame."""

Pairs = dict[str, dict[str, str]]
"""The attributes of contacts, by their names."""


@dataclass
class Tree:
    """The MJCF tree of a thing in one of its forms.

    Attributes:
        root: its root.
        kept: of its frame the attributes, the parts and the contacts, since it has left the arena.
        pairs: the contacts of its feet.
    """

    root: mjcf.RootElement
    kept: tuple[dict[str, Any], list[tuple[str, dict[str, Any]]], list[dict[str, Any]]] | None = None
    pairs: dict[str, Any] = field(default_factory=dict[str, Any])


class Thing(PlanarEntity):
    """A planar body: the robot, or a block. Its joints are in the frame by which it is attached to the arena.

    It has a tree for each form that it has had in a scene, such as each shape of a block, and the same hooks and
    observables in all of them.
    """

    def _build(
        self, name: str, mjcf_of: Callable[[Scene], str], scene: Scene, form: Hashable = None, more: str = ""
    ) -> None:
        """Parses the tree of this name, from the thing's MJCF in a scene (its body, and its tendons) and some more."""
        self.name, self._mjcf_of, self._more = name, mjcf_of, more
        self._trees: dict[Hashable, Tree] = {}
        self.take_form(form, scene)

    def _build_observables(self) -> PlanarObservables:
        return PlanarObservables(self)

    def take_form(self, form: Hashable, scene: Scene) -> None:
        """Makes its tree the one of a form, which it has in the scene. It must not be attached."""
        if form not in self._trees:
            self._trees[form] = Tree(self._parsed(scene))
        self.form, self._tree = form, self._trees[form]

    def _parsed(self, scene: Scene) -> mjcf.RootElement:
        body, others = self._elements(scene)
        content = "".join(tostring(part, "unicode") for part in body if part.tag in ("geom", "body", "camera"))
        tendons = "".join(tostring(part, "unicode") for part in others)
        return mjcf.from_xml_string(
            f'<mujoco model="{self.name}"><compiler angle="radian" autolimits="true"/>'
            f"<default>{default_classes()}</default><worldbody>{content}</worldbody><tendon>{tendons}</tendon>"
            f"{self._more}</mujoco>"
        )

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree, as it is in the present episode's scene."""
        if isinstance(self.parent, Arena):
            self.parent.refresh()
        return self._tree.root

    @property
    def frame(self) -> Any:
        """The body by which it is attached, with its joints."""
        return mjcf.get_attachment_frame(self._tree.root)

    def join(self, arena: Arena, scene: Scene, pairs: Pairs, place: int | None = None) -> None:
        """Puts the thing into the arena, with its joints and the contacts of its feet. Its meshes are the arena's.

        Args:
            arena: where to.
            scene: the scene.
            pairs: its contacts of feet.
            place: its number among the children of the arena's `worldbody`; None: the last.
        """
        if arena.mjcf_model.namescope.has_identifier("namescope", self.name):
            raise SettingsError(
                f"an entity of yours is called {self.name!r}, and this scene has a part of that name: give it "
                'another one, which is not "robot", nor "block" or "pebble" with a number'
            )
        frame = _attach(arena, self, place)
        if self._tree.kept is None:
            self._join_first(arena, scene, pairs, frame)
        else:
            attributes, parts, contacts = self._tree.kept
            frame.set_attributes(**attributes)
            for tag, values in parts:
                frame.add(tag, **values)
            self._tree.pairs = {
                contact["name"]: arena.mjcf_model.contact.add("pair", **contact) for contact in contacts
            }

    def _join_first(self, arena: Arena, scene: Scene, pairs: Pairs, frame: Any) -> None:
        body, others = self._elements(scene)
        joints = {part.get("name"): frame.add("joint", **_attributes(part)) for part in body.findall("joint")}
        for part in body.findall("inertial"):
            frame.add("inertial", **part.attrib)
        for tendon in others:  # those of the frame's joints would be searched in the tree
            for part, term in zip(tendon, self._tree.root.find("tendon", tendon.get("name")).joint, strict=True):
                if part.get("joint") in joints:
                    term.joint = joints[part.get("joint")]
        for geom in self._tree.root.find_all("geom", exclude_attachments=True):
            if isinstance(geom.mesh, str):
                geom.mesh = arena.mjcf_model.find("mesh", geom.mesh)
        floor = arena.mjcf_model.find("geom", "floor")
        for name in WHEELS if self.name == "robot" else (f"{self.name}_foot",):
            geoms = {"geom1": floor, "geom2": self._tree.root.find("geom", name)}
            self._tree.pairs[name] = arena.mjcf_model.contact.add("pair", **{**pairs[name], **geoms})

    def leave(self) -> None:
        """Takes the thing out of the arena. It keeps what users have added or changed, for when it joins again."""
        frame = self.frame
        own = [child for child in frame.all_children() if child.namescope is frame.namescope]
        parts = [(child.tag, child.get_attributes()) for child in own]
        self._tree.kept = frame.get_attributes(), parts, [pair.get_attributes() for pair in self._tree.pairs.values()]
        for pair in self._tree.pairs.values():
            pair.remove()
        self.detach()

    def show(self, scene: Scene, pairs: Pairs, owned: Owned) -> None:
        """Writes what the scene determines into the tree."""
        body, others = self._elements(scene)
        frame = self.frame
        owned.write(frame, {name: body.attrib[name] for name in PLACE})
        joints = {joint.name: joint for joint in frame.find_all("joint", immediate_children_only=True)}
        for element in (*list(body.iter())[1:], *others):
            names = [name for name in OWNED.get(element.tag, ()) if name in element.attrib]
            if not element.get("name") or not names or (element.tag == "geom" and not self.name.startswith("block")):
                continue
            name = element.get("name")
            target = joints.get(name) or self._tree.root.find(NAMESPACES[element.tag], name)
            owned.write(target, {name: element.attrib[name] for name in names})
        for name, pair in self._tree.pairs.items():
            owned.write(pair, {"friction": pairs[name]["friction"]})

    def _elements(self, scene: Scene) -> tuple[Element, list[Element]]:
        """The body and the tendons."""
        body, *others = _without_comments(self._mjcf_of(scene))
        return body, others


class BlockEntity(Thing):
    """A block."""

    def _build_observables(self) -> BlockObservables:
        return BlockObservables(self)


class RobotEntity(Thing):
    """The robot."""

    @property
    def fingers(self) -> list[Any]:
        """The joints of the left and the right finger, if it has any."""
        joints = [self._tree.root.find("joint", name) for name in FINGERS]
        return [joint for joint in joints if joint is not None]

    def apply_action(self, physics: Any, action: Any, random_state: Any = None) -> None:
        """Writes the controls of one of the 18 actions, for tasks of one's own.

        Raises:
            InvalidActionError: if it is not one of these.
        """
        del random_state
        robot, dynamics = self.parent.scene.robot, self.parent.scene.dynamics
        motors = [self._tree.root.find("actuator", name) for name in actuators(robot.body)]
        physics.bind(motors).ctrl = control_signal(action_number(action), robot.body, dynamics.veer)

    def _build_observables(self) -> RobotObservables:
        return GripperObservables(self) if self.fingers else RobotObservables(self)


def _attach(arena: Arena, thing: Thing, place: int | None) -> Any:
    """Attaches a thing to the arena at a place. composer attaches at the end, or after a site and other frames."""
    if place is None:
        return arena.attach(thing)
    world = arena.mjcf_model.worldbody
    marks = [world.insert("site", place) for _ in range(2)]
    frame = arena.attach(thing, marks[1])
    for mark in marks:
        mark.remove()
    return frame


class Arena(composer.Arena):
    """The root entity: ground, walls, lights, the camera "allo", and the goal regions. Robot and blocks are attached.

    What users add to the trees stays there. A block has a tree of its own for each shape that it has had, and its hooks
    and observables are the same for all. The attributes `robot`, `blocks` and `pebbles` are in the order of the scene.

    Robot and blocks always come before what users attach, and the robot after the blocks: it is drawn over them. So the
    order of MuJoCo's vectors follows from the scene and from the users' parts alone, not from earlier episodes.
    """

    def _build(self, scene: Scene) -> None:
        body = scene.robot.body
        self._model = mjcf.from_xml_string(world_mjcf(scene, empty=True))
        self._model.size.memory = str(33 * 2**20)  # as dm_control writes it once trees are attached anew
        self.scene = self._shown = scene
        self.compiling = True
        self._watch: Watch | None = None
        self._owned = Owned()
        apart = APART if body_named(body).fingers else ""
        more = f"<actuator>{actuators_mjcf(body)}</actuator><contact>{apart}</contact>"
        self.robot = RobotEntity("robot", _robot, scene, more=more)
        self.robot.join(self, scene, _pairs(scene))
        self.blocks: list[Thing] = []
        self.pebbles: list[Thing] = []
        self._things: dict[str, Thing] = {}  # all blocks and pebbles so far
        self._skins: list[Any] = []
        self.show(scene)

    def _build_observables(self) -> ArenaObservables:
        return ArenaObservables(self)

    @property
    def absent(self) -> list[Thing]:
        """The blocks and pebbles of earlier episodes that the present one lacks."""
        return [thing for thing in self._things.values() if thing.parent is None]

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree, as it is in the present episode's scene. Read it again after a reset."""
        self.refresh()
        return self._model

    def refresh(self) -> None:
        """Writes the present scene into the trees if that is still to be done, and watches what users do to them."""
        if self.compiling:
            return
        if self.scene is not self._shown:
            edited = self.edited
            self.compiling = True
            try:
                self.show(self.scene)
            finally:
                self.compiling = False
            if not edited:
                self._watch = None
        if self._watch is None:
            self._watch = Watch(self._model)

    @property
    def edited(self) -> bool:
        """Whether users have changed the trees since they were compiled."""
        return self._watch is not None and self._watch.changed()

    def compiled(self) -> None:
        """Takes note that the trees are compiled as they are now."""
        if self.compiling:
            self.compiling = False
            self._watch = None if self._watch is None else Watch(self._model)

    def check_owned(self) -> None:
        """Raises a `SettingsError` if users have changed what the scene determines, and writes it anew."""
        if self._owned.changed():
            self.show(self.scene)

    def check(self, scene: Scene) -> None:
        """Raises an `InvalidSceneError` unless the arena can show the scene."""
        for what, new, present in (
            ("robot has the body", scene.robot.body, self.scene.robot.body),
            ("arena has the half width", scene.half_width, self.scene.half_width),
        ):
            if new != present:
                raise InvalidSceneError(
                    f"the {what} {new!r} in this scene, and {present!r} in this environment: load another one for it"
                )

    def refuse_variations(self) -> None:
        """Raises a `SettingsError` if users' entities have hooks that would never be called."""
        for entity in self.iter_entities():
            if type(entity).initialize_episode_mjcf is not composer.Entity.initialize_episode_mjcf:
                raise SettingsError(
                    f"{type(entity).__name__}.initialize_episode_mjcf is called only when the tree is compiled: load "
                    "the environment with recompile_mjcf_every_episode=True"
                )

    def show(self, scene: Scene) -> None:
        """Makes the trees those of this scene.

        Raises:
            SettingsError: if users have changed what the scene determines; the trees are those of the scene even so.
        """
        edited, pairs = self._owned.changed(), _pairs(scene)
        self._owned = Owned()
        self.scene = self._shown = scene
        self._replace_blocks(scene, pairs)
        for thing in (*self.blocks, self.robot, *self.pebbles):
            thing.show(scene, pairs, self._owned)
        self._show_regions(scene)
        self._owned.write(self._model.option, {"timestep": TIMESTEP})
        refuse(edited)

    def _show_regions(self, scene: Scene) -> None:
        skins = elements(regions_mjcf(scene.regions))
        for skin in self._skins[len(skins) :]:
            skin.remove()
        del self._skins[len(skins) :]
        for index, element in enumerate(skins):
            if index == len(self._skins):
                self._skins.append(self._model.deformable.add("skin", **element.attrib))
                self._skins[index].add("bone", **element[0].attrib)
            skin = self._skins[index]
            self._owned.write(skin, {name: element.attrib[name] for name in ("rgba", "vertex", "face")})
            skin.bone[0].set_attributes(**element[0].attrib)

    def _replace_blocks(self, scene: Scene, pairs: Pairs) -> None:
        """Attaches other blocks and pebbles; the first ones stay if they are the same."""
        if scene.pebbles and self._model.find("mesh", "pebble_outline") is None:
            for mesh in elements(pebble_library()):
                self._model.asset.add("mesh", **mesh.attrib)
        wanted = [
            self._thing(BlockEntity, f"block{index}", (block.shape, block.mass), partial(_block, index), scene)
            for index, block in enumerate(scene.blocks)
        ]
        wanted += [
            self._thing(Thing, f"pebble{index}", None, partial(_pebble, index), scene)
            for index in range(len(scene.pebbles))
        ]
        self._exchange(wanted, scene, pairs)
        things = [thing for thing, _ in wanted]
        self.blocks, self.pebbles = things[: len(scene.blocks)], things[len(scene.blocks) :]

    def _thing(
        self, kind: type[Thing], name: str, form: Hashable, mjcf_of: Callable[[Scene], str], scene: Scene
    ) -> tuple[Thing, Hashable]:
        """The thing of this name, and the form that it is to have."""
        if name not in self._things:
            self._things[name] = kind(name, mjcf_of, scene, form)
        return self._things[name], form

    def _exchange(self, wanted: list[tuple[Thing, Hashable]], scene: Scene, pairs: Pairs) -> None:
        """Attaches the wanted things in their forms: the blocks before the robot, and then the pebbles after it.

        From the first one that differs, all are attached anew: the tree does not depend on earlier episodes.
        """
        present = [*self.blocks, *self.pebbles]
        staying = takewhile(lambda pair: (pair[0], pair[0].form) == pair[1], zip(present, wanted, strict=False))
        same = len(list(staying))
        for thing in present[same:]:
            thing.leave()
        frame, blocks = self.robot.frame, len(scene.blocks)
        for index, (thing, form) in enumerate(wanted[same:], same):
            thing.take_form(form, scene)
            place = next(k for k, child in enumerate(self._model.worldbody.all_children()) if child is frame)
            thing.join(self, scene, pairs, place if index < blocks else place + 1 + index - blocks)


def _robot(scene: Scene) -> str:
    robot = scene.robot
    return robot_mjcf(robot, SETTINGS, scene.half_width) + tendons_mjcf(robot, scene.dynamics, SETTINGS)


def _block(index: int, scene: Scene) -> str:
    return block_mjcf(index, scene.blocks[index], scene.dynamics, SETTINGS)


def _pebble(index: int, scene: Scene) -> str:
    return pebble_mjcf(index, scene.pebbles[index])


def _pairs(scene: Scene) -> Pairs:
    """The contacts of feet with the floor."""
    feet = "".join(block_pair(index, block, scene.dynamics, SETTINGS) for index, block in enumerate(scene.blocks))
    feet += robot_pairs(scene.robot, scene.dynamics, SETTINGS)
    feet += "".join(pebble_pair(index, SETTINGS) for index in range(len(scene.pebbles)))
    return {pair.attrib["name"]: _attributes(pair) for pair in _without_comments(feet)}


def _attributes(element: Element) -> dict[str, str]:
    """Those of an element, by dm_control's names."""
    return {"dclass" if name == "class" else name: value for name, value in element.attrib.items()}


def _without_comments(text: str) -> list[Element]:
    return [element for element in elements(text) if isinstance(element.tag, str)]
