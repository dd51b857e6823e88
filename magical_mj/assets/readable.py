"""Makes MJCF files readable: materials instead of colours, no unused meshes, rounded coordinates, indented text.

None of this changes the dynamics. A program that must draw exactly the environment's pictures should not round:
rounding moves visual coordinates by up to 5e-7 units, which changes a few pixels.
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
ROUNDED: Final = """Coordinates of visual geoms are rounded to 6 decimals. Outlines of blocks are not rounded: a block
    sleeps below a speed that depends on its size. Numbers of the physics have all digits"""
DRAWN: Final = ("visual", "solid")
"""The classes of visual geoms."""
FARTHEST: Final = tuple(f"{kind}_outline" for kind in (*SHAPES, "pebble"))
"""The meshes of geoms that reach farthest from the centre of a body with a hinge."""
COORDINATES: Final = ("pos", "quat", "size")
"""The attributes of geoms that are coordinates."""

INDENT: Final = "  "
LINE: Final = 120
"""The longest line of an indented file, in characters."""
GROUPS: Final = {"vertex": 3, "face": 3}
"""Attribute -> how many of its numbers form one entry, such as the 3 coordinates of a vertex."""


def name_colours(root: Element) -> None:
    """Replaces the colours of geoms by materials, and adds those materials to the assets."""
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
    """Removes the meshes that no geom uses."""
    used = {geom.get("mesh") for geom in root.iter("geom")}
    for assets in root.iter("asset"):
        for mesh in assets.findall("mesh"):
            if mesh.get("name") not in used:
                assets.remove(mesh)


def round_coordinates(root: Element) -> None:
    """Rounds the coordinates of visual geoms, and adds a comment about it before `worldbody`.

    The geom that reaches farthest from the centre of a body with a hinge is not rounded. MuJoCo takes this distance as
    the body's size, and a body sleeps once it turns slower than a limit that depends on its size.
    """
    for mesh in root.iter("mesh"):
        if mesh.get("name") not in FARTHEST:
            _round(mesh, "vertex")
    for geom in root.iter("geom"):
        if geom.get("class") in DRAWN:
            for name in COORDINATES:
                _round(geom, name)
    index = list(root).index(cast("Element", root.find("worldbody")))
    root.insert(index, Comment(ROUNDED))


def _round(element: Element, name: str) -> None:
    if name in element.attrib:
        element.set(name, numbers(*(round(float(word), DECIMALS) + 0.0 for word in element.attrib[name].split())))


def indented(element: Element, depth: int = 0) -> str:
    """Indented text: one element per line, blank lines between sections, long lists of numbers wrapped."""
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
    """The attributes of an element; lines that would be too long are wrapped."""
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
    """The lines of a wrapped list of numbers; groups are never split."""
    entries = value.split()
    row = ""
    for start in range(0, len(entries), group):
        item = " ".join(entries[start : start + group])
        if row and len(row) + len(item) + 2 > width:
            yield row
            row = ""
        row += ("  " if row and group > 1 else " " if row else "") + item
    yield row
