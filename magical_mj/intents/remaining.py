"""The remaining distance of an intent, for dense rewards, by the same formulas as those of the benchmark's tasks.

It is the sum over the relations. Each object for which a relation does not hold adds `WRONG` and the distance to where
it would hold. If one block of several is enough, the nearest counts. The distance is 0 exactly if the intent holds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from magical_mj.intents.intent import Intent
from magical_mj.intents.places import slack_of
from magical_mj.intents.relations import HOME, RELATIONS, Conjunct
from magical_mj.intents.selectors import homes, the_region
from magical_mj.scene import Block, Robot, Scene
from magical_mj.tasks import cluster, make_line
from magical_mj.tasks.rules import WRONG, way_in, way_out


def distance(intent: Intent, initial: Scene, final: Scene) -> float:
    """How far an intent is from holding in the final scene (world units).

    Raises:
        UngroundedError: if a relation means nothing in the initial scene.
    """
    parts = zip(intent.conjuncts, intent.blocks(initial), intent.parts(initial, final), strict=True)
    return sum(_way(conjunct, blocks, initial, final) for conjunct, blocks, holds in parts if not all(holds))


def _way(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> float:
    """What a relation adds that does not hold."""
    chosen = [final.blocks[index] for index in blocks]
    match conjunct.relation:
        case "exactly":
            return _to_number(conjunct.number, chosen, final)
        case "line":
            return make_line.distance(initial, replace(final, blocks=tuple(chosen)))
        case "clustered":
            ways = cluster.ways(final, "colour" if conjunct.argument == "colour" else "shape")
            return sum(ways[index] for index in blocks)
        case "robot in" | "robot near" | "robot wall":
            return _of_object(conjunct, None, blocks, initial, final)
    each = RELATIONS[conjunct.relation].each
    flags = each(conjunct.argument, initial, final) if each else _apart(conjunct, blocks, initial, final)
    about = [index for index in blocks if flags[index] is not None]
    ways = [0.0 if flags[index] else _of_object(conjunct, index, blocks, initial, final) for index in about]
    return min(ways) if conjunct.any_of else sum(ways)


def _apart(conjunct: Conjunct, blocks: tuple[int, ...], initial: Scene, final: Scene) -> list[bool | None]:
    """Whether the relation `apart` holds, for each block of the scene."""
    parts = dict(zip(blocks, RELATIONS["apart"].together(conjunct, blocks, initial, final), strict=True))
    return [parts.get(index) for index in range(len(final.blocks))]


def _to_number(number: int, blocks: list[Block], final: Scene) -> float:
    """The way of the nearest blocks into the region until there are enough, or out of it if there are too many."""
    region = the_region(final)
    ways = sorted(way_in(region, block) for block in blocks)
    surplus = ways.count(0.0) - number
    outward = sorted(way_out(region, block, final.half_width) for block in blocks if region.contains(block))
    return sum(outward[:surplus]) if surplus > 0 else sum(ways[:number])


def _of_object(conjunct: Conjunct, index: int | None, blocks: tuple[int, ...], initial: Scene, final: Scene) -> float:
    """What a block, or the robot, adds for which the relation does not hold."""
    item: Block | Robot = final.robot if index is None else final.blocks[index]
    if conjunct.relation == "in" and conjunct.argument == HOME and index is not None:
        return way_in(final.regions[homes(initial)[index] or 0], item)
    if conjunct.relation in ("in", "robot in"):
        return min(way_in(region, item) for region in final.regions)
    if conjunct.relation == "out":
        return sum(way_out(region, item, final.half_width) for region in final.regions)
    slack = slack_of(conjunct, initial, index, blocks)(final, np.array([[item.x, item.y]]))
    return WRONG + max(-float(slack[0]), 0.0)
