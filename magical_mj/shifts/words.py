"""Words: other sentences for the same thing to do, 25 for each task of the benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from magical_mj.shifts.shift import Factor, Shift
from magical_mj.tasks.registry import task_name

_TEXTS: Final = {
    "MoveToCorner": """
move the block into the top left corner
shove the block into the top left corner
bring the block into the top left corner
get the block into the top left corner
take the block into the top left corner

the block should end up in the upper left corner
put the one block up into the left corner
leave the block in the corner at the top left
make the block sit in the upper left corner
carry the block to the corner that is up and left

into the upper left corner is where the block should go
the top left corner is missing its block
let the upper left corner hold the block
the block's place is the corner up on the left
up and to the left, where two walls meet, the block must lie

park the object where the upper and the left wall meet
wedge the shape between the top and left edges
the object wants to be as high and as far left as it can
slide the lone piece to the north-west end
stow the shape in the north-western nook

as far north and west as the walls allow, that is where it goes
tidy it away to where ten o'clock would be
leave nothing but that nook at the north-west filled
it should touch the wall above and the one at left
make it lie as high as possible, and as near to the left as possible
""",
    "MoveToRegion": """
go into the goal region
move into the goal region
enter the goal region
get into the goal region
steer into the goal region

the robot should end up inside the goal region
be in the goal region when time is up
bring yourself into the coloured region
take the robot to the goal region and stay
come to a stop within the goal region

in the goal region is where you should be found
the goal region is waiting for the robot
let the coloured region hold you at the end
your place is within the dashed border
cross the dashed line and stay on its inner side

park on the coloured patch
make the tinted rectangle your resting place
stand on the painted area
halt on the coloured ground
settle down within the marked rectangle

finish your trip on the only ground that is not white
white ground is not where you should be at the end
let your middle come to lie over the tint
stop once paint is below you
what is marked out by the dashes should have you within it
""",
    "MatchRegions": """
move all blocks of the region's colour, and no others, into the goal region
push all blocks of the region's colour, and no others, into the goal region
gather all blocks of the region's colour, and no others, in the goal region
take all blocks of the region's colour, and no others, into the goal region
collect all blocks of the region's colour, and no others, in the goal region

fill the goal region with just those blocks that have its colour
every block that has the colour of the region belongs into it, the rest stay out
the goal region should hold the blocks of its own colour only
put the blocks that match the region's colour into it, all of them and nothing else
leave in the region exactly the blocks that are coloured as it is

into the region with whatever is coloured like it; out with whatever is not
like goes to like: blocks of the same colour as the region go into it
the region wants its colour complete and unmixed
sort by colour: what matches the region goes inside
only its own colour may be in the region, and all of that

bring home the objects that share the tint of the marked patch
the patch should own all pieces of its hue
collect on the coloured patch the shapes that look like it
matching hues belong together on the ground
the marked area keeps what has its tint and nothing besides

whatever would vanish against the paint on the ground should lie upon it
let hue decide: what agrees with the floor's paint rests there, what does not keeps off
pale patch, strong pieces: unite those of one hue
no stranger on the patch, no relative off it
make the paint and everything that is akin to it one pile, with nobody else
""",
    "MakeLine": """
put all blocks in a line, anywhere and at any angle
place all blocks in a line, anywhere and at any angle
set all blocks in a line, anywhere and at any angle
lay all blocks in a line, anywhere and at any angle
bring all blocks into a line, anywhere and at any angle

line up all the blocks, wherever you like
all blocks should end up in one straight line
form a line of all blocks, in any direction
make a line with every block in it
let the blocks make up a line; where does not matter

a straight row is what the blocks should become
one line, no matter which, must have all blocks on it
from any arrangement of blocks make a row
the blocks want to be in a row, evenly spaced
turn this scatter of blocks into a row

arrange the shapes like beads on a taut string
have the pieces queue
make the objects stand in single file
align everything that is loose
row up the shapes, slanted or not

a ruler laid somewhere should touch them all
no piece may be off the straight path through the others
one look along them from the end, and only the first is seen
set them up as soldiers on parade
pearls on a thread is what they ought to look like
""",
    "FindDupe": """
move a duplicate of the block in the goal region into the region
push a duplicate of the block in the goal region into the region
take a duplicate of the block in the goal region into the region
add a duplicate of the block in the goal region to the region
fetch a duplicate of the block in the goal region into the region

find a block that equals the one in the region, and put it beside it
another block with the shape and the colour of the one in the region should join it
the region should hold two equal blocks
look for the same block as in the region, and bring it there
put a second one of the block in the region next to it

the block in the region has a double outside: unite them
make a pair of the block in the region
same shape, same colour: into the region with that block
give the block in the region its twin
what lies in the region also exists outside; bring that in

reunite the twins on the coloured patch
the lone piece on the patch is missing its copy
match the sample on the marked ground
bring the sample's look-alike home
find what is identical to the sample, and lay it beside

one is a loner on paint; its mirror image should not be far from it
what you see upon the paint, let there be two of
double what is shown to you
give company of its own kind to the one on the patch
a second helping of the very same thing, please
""",
    "FixColour": """
move the block whose colour differs from its goal region's out of it
take the block whose colour differs from its goal region's out of it
bring the block whose colour differs from its goal region's out of it
get the block whose colour differs from its goal region's out of it
drag the block whose colour differs from its goal region's out of it

one block is in a region of another colour: remove it
clear the region whose block has the wrong colour
the block that does not match its region must leave it
put the block with the wrong colour outside of its region
no region may hold a block of another colour

a block and its region disagree; part them
out with the block that does not suit its region
where colours clash, the block has to go
colours of region and block must agree: take away what does not
leave each region empty or with its own colour

evict the misfit from its patch
one piece lies on the wrong paint: get it off
put right the patch with the odd piece
remove the intruder from the marked area
mend the mismatch

a single mistake was made here; undo it
one of them should be on plain white instead
spot the pair that clashes, and break it up
somebody sits where somebody else's tint is
harmony, except for one: send that one off
""",
    "ClusterColour": """
move the blocks into clusters by colour
bring the blocks into clusters by colour
put the blocks into clusters by colour
gather the blocks in clusters by colour
sort the blocks into clusters by colour

group the blocks by colour, each group apart from the others
blocks of one colour should lie together
make one cluster of each colour
each colour gets a cluster of its own
put every block next to those of its colour

part the colours, and unite what has the same
let colour decide which blocks lie together
a heap for every colour
no colour may lie among another one's blocks
by colour, not by shape: group them

separate the hues into heaps
pile up the pieces hue by hue
birds of one tint flock together
give each tint its own corner
sort the laundry

mixed paints should become pure ones
undo the mixing of the tints, whatever outlines they have
at the end each heap could be named by one crayon
outline does not matter; hue does: make heaps
whoever looks alike from afar, blurred, should be neighbours
""",
    "ClusterShape": """
move the blocks into clusters by shape
bring the blocks into clusters by shape
put the blocks into clusters by shape
gather the blocks in clusters by shape
sort the blocks into clusters by shape

group the blocks by shape, each group apart from the others
blocks of one shape should lie together
make one cluster of each shape
each shape gets a cluster of its own
put every block next to those of its shape

part the shapes, and unite what has the same
let shape decide which blocks lie together
a heap for every shape
no shape may lie among another one's blocks
by shape, not by colour: group them

separate the outlines into heaps
pile up the pieces form by form
stars to stars, circles to circles
give each form its own corner
let those with as many corners meet

hue does not matter; outline does: make heaps
a blind hand should feel no difference within a heap
count their corners, and let equal numbers be neighbours
what fits the same hole goes on the same heap
at the end each heap could be cut out with one cutter
""",
}

SENTENCES: Final[Mapping[str, list[list[str]]]] = MappingProxyType(
    {task: [part.split("\n") for part in text.strip().split("\n\n")] for task, text in _TEXTS.items()}
)
"""Task -> five sentences for each strength, from another verb to a description without the task's words."""


class Words(Shift):
    """The sentence that says what is to be done is another one: `info["instruction"]`, and in dicts of pictures."""

    name = "words"
    summary = "the sentence that says what is to be done"
    factors = (
        Factor(
            "distance",
            "1 another verb, 2 and 3 other sentences, 4 other nouns, 5 a description",
            (1, 2, 3, 4, 5),
            "exact",
        ),
        Factor("sentence", "which one of that distance", (5, 5, 5, 5, 5), "choice"),
    )

    @classmethod
    def supports(cls, task: str) -> str | None:
        """Tasks that have sentences."""
        return None if task_name(task) in SENTENCES else "it has no other sentences"

    def instruction(self, instruction: str, task: str) -> str:
        """The sentence."""
        distance = int(self.values["distance"])
        return SENTENCES[task_name(task)][distance - 1][int(self.values["sentence"])] if distance else instruction
