"""Models as people read them: an MJCF tree with materials, without meshes that nothing shows, as indented text.

Nothing of this changes how a model moves. A program that must draw exactly what environments draw leaves visual
coordinates as they are: rounded ones differ by up to 5e-7 units, which here and there is another pixel.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, cast
from xml.etree.ElementTree import Comment, Element, SubElement
from xml.sax.saxutils import quoteattr

from magical_mj.assets.mjcf import numbers
from magical_mj.assets.style import MATERIALS, rgba
from magical_mj.scene.constants import SHAPES

DECIMALS: Final = 6
"""Of visual coordinates, in world units."""
ROUNDED: Final = """Coordinates of what is only drawn are rounded to 6 decimals, apart from outlines of blocks,
    since MuJoCo puts a block to sleep at a speed that depends on its size. Numbers of the physics have all digits"""
DRAWN: Final = ("visual", "solid")
"""The classes of geoms that are only drawn."""
FARTHEST: Final = tuple(f"{kind}_outline" for kind in (*SHAPES, "pebble"))
"""The meshes of geoms that reach farthest from the centre of a body with a hinge."""
PLACE: Final = ("pos", "quat", "size")
"""The attributes of geoms that are coordinates."""

INDENT: Final = "  "
LINE: Final = 120
"""The longest line of an indented file, in characters."""
GROUPS: Final = {"vertex": 3, "face": 3}
"""Attribute -> how many numbers of its list form one entry, such as 3 coordinates of a vertex."""


def name_colours(root: Element) -> None:
    """Gives the geoms materials instead of colours, and lists those materials among the assets."""
    names = {rgba(rgb): name for name, rgb in MATERIALS.items()}
    used = set[str]()
    for geom in root.iter("geom"):
        colour = geom.attrib.pop("rgba", None)
        if colour is not None:
            geom.set("material", names[colour])
            used.add(names[colour])
    assets = cast("Element", root.find("asset"))
    for name in filter(used.__contains__, MATERIALS):
        SubElement(assets, "material", {"name": name, "rgba": rgba(MATERIALS[name])})


def drop_unused_meshes(root: Element) -> None:
    """Removes the meshes that no geom shows."""
    used = {geom.get("mesh") for geom in root.iter("geom")}
    for assets in root.iter("asset"):
        for mesh in assets.findall("mesh"):
            if mesh.get("name") not in used:
                assets.remove(mesh)


def round_coordinates(root: Element) -> None:
    """Rounds the coordinates of what is only drawn, and says so in a comment before the world.

    The geom that reaches farthest from the centre of a body with a hinge is left as it is: MuJoCo takes its reach as
    the size of the body, and a body sleeps once it turns slower than a limit that depends on its size.
    """
    for mesh in root.iter("mesh"):
        if mesh.get("name") not in FARTHEST:
            _round(mesh, "vertex")
    for geom in root.iter("geom"):
        if geom.get("class") in DRAWN:
            for name in PLACE:
                _round(geom, name)
    place = list(root).index(cast("Element", root.find("worldbody")))
    root.insert(place, Comment(ROUNDED))


def _round(element: Element, name: str) -> None:
    if name in element.attrib:
        element.set(name, numbers(*(round(float(word), DECIMALS) + 0.0 for word in element.attrib[name].split())))


def indented(element: Element, depth: int = 0) -> str:
    """An element as indented text: one per line, blank lines between sections, long lists of numbers wrapped."""
    pad = INDENT * depth
    if element.tag is Comment:
        return f"{pad}<!-- {str(element.text).strip()} -->\n"
    start = f"{pad}<{element.tag}{_attributes(element, pad)}"
    if not len(element):
        return f"{start}/>\n"
    content, before = "", None
    for child in element:
        is_section = depth == 0 and child.tag is Comment and before is not Comment
        content += ("\n" if is_section else "") + indented(child, depth + 1)
        before = child.tag
    return f"{start}>\n{content}{pad}</{element.tag}>\n"


def _attributes(element: Element, pad: str) -> str:
    """The attributes of an element, wrapped where the line would be too long."""
    text, width, deeper = "", len(pad) + len(str(element.tag)) + 1, pad + 2 * INDENT
    line_break = f"\n{deeper}"
    for name, value in element.items():
        entry = f"{name}={quoteattr(value).replace('&#10;', line_break)}"
        if "\n" not in value and len(deeper) + len(entry) > LINE and value[:1] in "-.0123456789":
            rows = _wrapped(value, GROUPS.get(name, 1), LINE - len(deeper) - 3)
            entry = f'{name}="{line_break}{line_break.join(rows)}"'
        if width + 3 + len(entry.partition("\n")[0]) > LINE:
            text, width = f"{text}\n{deeper}{entry}", len(deeper) + len(entry)
        else:
            text, width = f"{text} {entry}", width + 1 + len(entry)
    return text


def _wrapped(value: str, group: int, width: int) -> Iterator[str]:
    """A list of numbers as lines; groups of numbers are never split."""
    entries = value.split()
    row = ""
    for start in range(0, len(entries), group):
        item = " ".join(entries[start : start + group])
        if row and len(row) + len(item) + 2 > width:
            yield row
            row = ""
        row += ("  " if row and group > 1 else " " if row else "") + item
    yield row
