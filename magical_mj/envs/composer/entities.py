"""A scene as composer entities: arena, robot and blocks, each with its own MJCF tree.

The trees are parsed from the MJCF text of an engine's model. So together they compile to the same model, except for
names: as always in composer, the names of elements of the robot and the blocks begin with "robot/", "block0/" etc.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final
from xml.etree.ElementTree import Element, tostring

from dm_control import composer, mjcf

from magical_mj.actions import action_number
from magical_mj.assets.block import block_mjcf, block_pair, pebble_library, pebble_mjcf, pebble_pair
from magical_mj.assets.contacts import SETTINGS, TIMESTEP, default_classes
from magical_mj.assets.mjcf import elements
from magical_mj.assets.region import regions_mjcf
from magical_mj.assets.robot import (
    WHEELS,
    actuators,
    actuators_mjcf,
    controls,
    robot_mjcf,
    robot_pairs,
    tendons_mjcf,
)
from magical_mj.assets.scene_mjcf import APART, scene_mjcf
from magical_mj.assets.scene_model import FINGERS
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
from magical_mj.scene.bodies import body_named
from magical_mj.utils.errors import InvalidSceneError, SettingsError

NAMESPACES: Final = {"body": "body", "joint": "joint", "geom": "geom", "fixed": "tendon"}
"""Elements with attributes that the scene determines -> composer's names for them."""
OWNED: Final = {
    "body": ("quat",),
    "joint": ("axis", "ref", "frictionloss"),
    "geom": ("rgba",),
    "fixed": ("frictionloss",),
}
"""Element -> the attributes that the scene determines. Only a block's geoms vary; the robot's are constant."""
FRAME_POSE: Final = ("pos", "quat")
"""The attributes of an attachment frame that the scene determines."""

Pairs = dict[str, dict[str, str]]
"""Name of a contact pair -> its attributes."""


@dataclass
class Tree:
    """The MJCF tree of an entity in one of its forms."""

    root: mjcf.RootElement
    kept: tuple[dict[str, Any], list[tuple[str, dict[str, Any]]], list[dict[str, Any]]] | None = None
    """While the entity is detached, the attributes and children of its frame, and its contact pairs."""
    pairs: dict[str, Any] = field(default_factory=dict[str, Any])
    """Its contact pairs with the floor, by name."""


class SceneEntity(PlanarEntity):
    """A planar body of a scene: the robot, a block or a pebble. Its joints are in its attachment frame in the arena.

    It has a tree for each form that it has had so far, such as each shape of a block. Its hooks and observables are the
    same in all forms.
    """

    def _build(
        self,
        name: str,
        mjcf_of: Callable[[Scene], str],
        scene: Scene,
        form: Hashable = None,
        more: str = "",
        observed: type[PlanarObservables] = PlanarObservables,
    ) -> None:
        """Parses the entity's tree.

        Args:
            name: the name of the entity and its tree.
            mjcf_of: returns the MJCF of its body and tendons in a scene.
            scene: the scene.
            form: its form in the scene.
            more: further elements of the tree, as MJCF.
            observed: the class of its observables.
        """
        self.name, self._mjcf_of, self._more, self._observed = name, mjcf_of, more, observed
        self._trees: dict[Hashable, Tree] = {}
        self.take_form(form, scene)

    def _build_observables(self) -> PlanarObservables:
        return self._observed(self)

    def take_form(self, form: Hashable, scene: Scene) -> None:
        """Selects the tree of a form, which is the entity's form in the scene. It must be detached."""
        if form not in self._trees:
            self._trees[form] = Tree(self._parsed(scene))
        self.form, self._tree = form, self._trees[form]

    def _parsed(self, scene: Scene) -> mjcf.RootElement:
        body, others = self._elements(scene)
        content = "".join(tostring(child, "unicode") for child in body if child.tag in ("geom", "body", "camera"))
        tendons = "".join(tostring(tendon, "unicode") for tendon in others)
        content = f"<worldbody>{content}</worldbody><tendon>{tendons}</tendon>{self._more}"
        return mjcf.from_xml_string(
            f'<mujoco model="{self.name}"><compiler angle="radian" autolimits="true"/>'
            f"<default>{_classes_in(content)}</default>{content}</mujoco>"
        )

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree, with the values of the current episode's scene."""
        if isinstance(self.parent, Arena):
            self.parent.refresh()
        return self._tree.root

    @property
    def frame(self) -> Any:
        """The attachment frame: the body in the arena's tree with the entity's joints."""
        return mjcf.get_attachment_frame(self._tree.root)

    def join(self, arena: Arena, scene: Scene, pairs: Pairs, index: int | None = None) -> None:
        """Attaches the entity to the arena, with its joints and contact pairs. Its meshes are in the arena's tree.

        `index` is its position among the children of the arena's `worldbody`; None: at the end.
        """
        if arena.mjcf_model.namescope.has_identifier("namescope", self.name):
            raise SettingsError(
                f"an attached entity is named {self.name!r}, like an object of this scene: rename it. The names "
                '"robot", and "block" or "pebble" with a number, are reserved'
            )
        frame = _attach(arena, self, index)
        if self._tree.kept is None:
            self._join_first(arena, scene, pairs, frame)
        else:
            attributes, children, contacts = self._tree.kept
            frame.set_attributes(**attributes)
            for tag, values in children:
                frame.add(tag, **values)
            self._tree.pairs = {
                contact["name"]: arena.mjcf_model.contact.add("pair", **contact) for contact in contacts
            }

    def _join_first(self, arena: Arena, scene: Scene, pairs: Pairs, frame: Any) -> None:
        body, others = self._elements(scene)
        joints = {joint.get("name"): frame.add("joint", **_attributes(joint)) for joint in body.findall("joint")}
        for inertial in body.findall("inertial"):
            frame.add("inertial", **inertial.attrib)
        for tendon in others:  # their joints in the frame are outside the entity's tree, so they are set explicitly
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
        """Detaches the entity from the arena. Users' additions and changes are kept until it is attached again."""
        frame, pairs = self.frame, self._tree.pairs.values()
        own = [child for child in frame.all_children() if child.namescope is frame.namescope]
        children = [(child.tag, child.get_attributes()) for child in own]
        self._tree.kept = frame.get_attributes(), children, [pair.get_attributes() for pair in pairs]
        for pair in pairs:
            pair.remove()
        self.detach()

    def show(self, scene: Scene, pairs: Pairs, owned: Owned) -> None:
        """Writes the attributes that the scene determines into the tree."""
        body, others = self._elements(scene)
        frame = self.frame
        owned.write(frame, {name: body.attrib[name] for name in FRAME_POSE})
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
        """The entity's body and tendons in the scene."""
        body, *tendons = _without_comments(self._mjcf_of(scene))
        return body, tendons


class RobotEntity(SceneEntity):
    """The robot."""

    @property
    def fingers(self) -> list[Any]:
        """The joints of the left and the right finger; empty without fingers."""
        joints = [self._tree.root.find("joint", name) for name in FINGERS]
        return [joint for joint in joints if joint is not None]

    def apply_action(self, physics: Any, action: Any, random_state: Any = None) -> None:
        """Writes the controls of one of the 18 actions, for use in your own tasks.

        Raises:
            InvalidActionError: if the action is not one of the 18.
        """
        del random_state
        robot, dynamics = self.parent.scene.robot, self.parent.scene.dynamics
        motors = [self._tree.root.find("actuator", name) for name in actuators(robot.body)]
        physics.bind(motors).ctrl = controls(robot.body, dynamics.veer)[action_number(action)]


def _attach(arena: Arena, entity: SceneEntity, index: int | None) -> Any:
    """Attaches an entity at an index of `worldbody`, or at the end, and returns its frame.

    composer attaches at the end, or at a site after other frames. So temporary sites mark the index.
    """
    if index is None:
        return arena.attach(entity)
    worldbody = arena.mjcf_model.worldbody
    sites = [worldbody.insert("site", index) for _ in range(2)]
    frame = arena.attach(entity, sites[1])
    for site in sites:
        site.remove()
    return frame


class Arena(composer.Arena):
    """The root entity: ground, walls, lights, the camera "allo", and the goal regions. Robot and blocks are attached.

    Users' additions to the trees persist. A block has a separate tree for each shape that it has had, and the same
    hooks and observables for all shapes. The attributes `robot`, `blocks` and `pebbles` are in the order of the scene.

    The blocks come first, then the robot, which is drawn over them, then the entities that users attach. So the order
    of MuJoCo's vectors depends on the scene and the users' additions, not on earlier episodes.
    """

    def _build(self, scene: Scene) -> None:
        body = scene.robot.body
        self._model = mjcf.from_xml_string(scene_mjcf(scene, empty=True))
        self._model.size.memory = str(33 * 2**20)  # as dm_control writes it after attaching again
        self.scene = self._shown = scene
        self.compiling = True
        self._watch: Watch | None = None
        self._owned = Owned()
        fingers = body_named(body).fingers
        more = f"<actuator>{actuators_mjcf(body)}</actuator><contact>{APART if fingers else ''}</contact>"
        observed = GripperObservables if fingers else RobotObservables
        self.robot = RobotEntity("robot", _robot, scene, more=more, observed=observed)
        self.robot.join(self, scene, _pairs(scene))
        self.blocks: list[SceneEntity] = []
        self.pebbles: list[SceneEntity] = []
        self._entities: dict[str, SceneEntity] = {}  # all blocks and pebbles so far
        self._skins: list[Any] = []
        self.show(scene)

    def _build_observables(self) -> ArenaObservables:
        return ArenaObservables(self)

    @property
    def absent(self) -> list[SceneEntity]:
        """The blocks and pebbles of earlier episodes that are not in the current scene."""
        return [entity for entity in self._entities.values() if entity.parent is None]

    @property
    def mjcf_model(self) -> mjcf.RootElement:
        """The tree, with the values of the current episode's scene. Read it again after a reset."""
        self.refresh()
        return self._model

    def refresh(self) -> None:
        """Writes the current scene into the trees if they still show an earlier one, and watches for users' changes."""
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
        """Records that the current trees have been compiled."""
        if self.compiling:
            self.compiling = False
            self._watch = None if self._watch is None else Watch(self._model)

    def check_owned(self) -> None:
        """If users have changed attributes that the scene determines, restores them and raises a `SettingsError`."""
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
                    f"the {what} {new!r} in this scene, and {present!r} in this environment: load another environment"
                )

    def refuse_variations(self) -> None:
        """Raises a `SettingsError` if users' entities have hooks that are only called with recompilation."""
        for entity in self.iter_entities():
            if type(entity).initialize_episode_mjcf is not composer.Entity.initialize_episode_mjcf:
                raise SettingsError(
                    f"{type(entity).__name__}.initialize_episode_mjcf is only called when the tree is compiled: load "
                    "the environment with recompile_mjcf_every_episode=True"
                )

    def show(self, scene: Scene) -> None:
        """Writes a scene into the trees.

        Afterwards, it raises a `SettingsError` if users had changed attributes that the scene determines.
        """
        edited, pairs = self._owned.changed(), _pairs(scene)
        self._owned = Owned()
        self.scene = self._shown = scene
        self._replace_blocks(scene, pairs)
        for entity in (*self.blocks, self.robot, *self.pebbles):
            entity.show(scene, pairs, self._owned)
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
        """Attaches the scene's blocks and pebbles. Leading ones that are already attached stay."""
        if scene.pebbles and self._model.find("mesh", "pebble_outline") is None:
            for mesh in elements(pebble_library()):
                self._model.asset.add("mesh", **mesh.attrib)
        wanted: list[tuple[SceneEntity, Hashable]] = []
        for index, block in enumerate(scene.blocks):
            name, form = f"block{index}", (block.shape, block.mass)
            if name not in self._entities:
                arguments = name, partial(_block, index), scene, form
                self._entities[name] = SceneEntity(*arguments, observed=BlockObservables)
            wanted.append((self._entities[name], form))
        for index in range(len(scene.pebbles)):
            name = f"pebble{index}"
            if name not in self._entities:
                self._entities[name] = SceneEntity(name, partial(_pebble, index), scene)
            wanted.append((self._entities[name], None))
        self._exchange(wanted, scene, pairs)
        entities = [entity for entity, _ in wanted]
        self.blocks, self.pebbles = entities[: len(scene.blocks)], entities[len(scene.blocks) :]

    def _exchange(self, wanted: list[tuple[SceneEntity, Hashable]], scene: Scene, pairs: Pairs) -> None:
        """Attaches the wanted entities in their forms: blocks before the robot, pebbles after it.

        From the first difference on, all entities are attached again, so that the tree does not depend on earlier
        episodes.
        """
        attached = [*self.blocks, *self.pebbles]
        same = 0
        for entity, target in zip(attached, wanted, strict=False):
            if (entity, entity.form) != target:
                break
            same += 1
        for entity in attached[same:]:
            entity.leave()
        frame, blocks = self.robot.frame, len(scene.blocks)
        for number, (entity, form) in enumerate(wanted[same:], same):
            entity.take_form(form, scene)
            index = next(k for k, child in enumerate(self._model.worldbody.all_children()) if child is frame)
            entity.join(self, scene, pairs, index if number < blocks else index + 1 + number - blocks)


def _robot(scene: Scene) -> str:
    robot = scene.robot
    return robot_mjcf(robot, SETTINGS, scene.half_width) + tendons_mjcf(robot, scene.dynamics, SETTINGS)


def _block(index: int, scene: Scene) -> str:
    return block_mjcf(index, scene.blocks[index], scene.dynamics, SETTINGS)


def _pebble(index: int, scene: Scene) -> str:
    return pebble_mjcf(index, scene.pebbles[index])


def _pairs(scene: Scene) -> Pairs:
    """The contact pairs of the blocks, the pebbles and the robot's wheels with the floor."""
    text = "".join(block_pair(index, block, scene.dynamics, SETTINGS) for index, block in enumerate(scene.blocks))
    text += robot_pairs(scene.robot, scene.dynamics, SETTINGS)
    text += "".join(pebble_pair(index, SETTINGS) for index in range(len(scene.pebbles)))
    return {pair.attrib["name"]: _attributes(pair) for pair in _without_comments(text)}


def _classes_in(content: str) -> str:
    """The default classes that MJCF uses, with those that contain them. dm_control takes a millisecond for each."""
    used = {element.get("class") for part in elements(content) for element in part.iter()}
    (root,) = elements(default_classes())
    for parent in (*root.findall("default"), root):
        for child in parent.findall("default"):
            if child.get("class") not in used and child.find("default") is None:
                parent.remove(child)
    return tostring(root, "unicode")


def _attributes(element: Element) -> dict[str, str]:
    """An element's attributes by dm_control's names."""
    return {"dclass" if name == "class" else name: value for name, value in element.attrib.items()}


def _without_comments(text: str) -> list[Element]:
    return [element for element in elements(text) if isinstance(element.tag, str)]
