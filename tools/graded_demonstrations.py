"""Makes the graded demonstrations: 25 of each task, and in SweepToTop of each body, with scores from 0 to 1.

    python tools/graded_demonstrations.py [--tasks MoveToRegion,...] [--histogram docs/graded.png]

Three kinds of demonstrators fail or succeed in part, for whole episodes:

stopped     plays a shipped demonstration up to a random step, and then does nothing
disturbed   plays a shipped demonstration in which random actions replace one to three stretches
mistaken    is the expert with a wrong goal in the same scene: another region or corner, other colours, or another task;
            in SweepToTop, the demonstration of another scene

Of many candidates, those are chosen that fill the quartiles of the score evenly, as far as scores lie there. All draws
come from fixed seeds. Tasks that are not named keep their demonstrations. MuJoCo's version can change scores.
"""

from __future__ import annotations

import argparse
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, Demonstrator
from magical_mj.demos.recording import replayed
from magical_mj.demos.shipped import FILES, load, stored_rows
from magical_mj.engine import Engine
from magical_mj.experts import Expert
from magical_mj.scene import GoalRegion, Scene
from magical_mj.scene.constants import COLOURS, Colour
from magical_mj.tasks import KNOWN, SPECS
from magical_mj.tasks.registry import task_spec
from tools.pack_demonstrations import pack_rows

COUNT: Final = 25
BINS: Final = 4
CANDIDATES, LONG_CANDIDATES = 150, 50
"""The number of stopped and disturbed candidates each; in the long episodes of the Cluster tasks."""
MISTAKEN, LONG_MISTAKEN = 10, 7
"""The number of mistaken candidates, of which some may turn out equal."""
LONG: Final = 200  # steps
LONGEST: Final = 12  # steps of a disturbance

Actions = NDArray[Any]


def still(demo: Demonstration, steps: int) -> Actions:
    """The actions of a demonstration, with no-ops up to the end of an episode."""
    rest = np.zeros((steps - len(demo.actions), *demo.actions.shape[1:]), demo.actions.dtype)
    return np.concatenate([demo.actions, rest])


def stopped(demo: Demonstration, steps: int, rng: np.random.Generator) -> Actions:
    """Up to a random step."""
    actions = still(demo, steps)
    acting = int(np.flatnonzero(demo.acts)[-1]) + 1
    actions[int(acting * rng.uniform(0.1, 1.0)) :] = 0
    return actions


def disturbed(demo: Demonstration, steps: int, rng: np.random.Generator) -> Actions:
    """With random actions in one to three stretches."""
    actions = still(demo, steps)
    acting = int(np.flatnonzero(demo.acts)[-1]) + 1
    for _ in range(rng.integers(1, 4)):
        start, length = rng.integers(acting), rng.integers(1, LONGEST)
        if actions.ndim == 1:
            actions[start : start + length] = rng.integers(0, 18)
        else:
            actions[start : start + length] = rng.uniform(-1, 1, actions.shape[1])
    return actions


def recoloured(scene: Scene, rng: np.random.Generator, colours: tuple[Colour, ...]) -> Scene:
    """The blocks get the colours in random order."""
    drawn = rng.permutation(len(colours)).tolist()
    blocks = (replace(block, colour=colours[number]) for block, number in zip(scene.blocks, drawn, strict=True))
    return replace(scene, blocks=tuple(blocks))


def region(rng: np.random.Generator, scene: Scene, colour: Colour) -> GoalRegion:
    """A goal region anywhere, in which no block and not the robot is."""
    while True:
        x, y = rng.uniform(-0.95, 0.25, 2).tolist()
        drawn = GoalRegion(colour, x, y, x + 0.7, y + 0.7)
        if not any(drawn.contains(item) for item in (scene.robot, *scene.blocks)):
            return drawn


def wrong_goal(task: str, rng: np.random.Generator) -> tuple[str, Scene]:
    """A task, and a scene of it with the poses and shapes of the real one."""
    scene = SPECS[task].demo
    colours = tuple(block.colour for block in scene.blocks)
    match task:
        case "MoveToRegion":
            return task, replace(scene, regions=(region(rng, scene, "blue"),))
        case "MoveToCorner":
            return "MatchRegions", replace(scene, regions=(region(rng, scene, "red"),))
        case "MatchRegions":
            others = [colour for colour in COLOURS if colour in colours and colour != scene.regions[0].colour]
            wanted = others[rng.integers(len(others))]
            return task, replace(scene, regions=(replace(scene.regions[0], colour=wanted),))
        case "FindDupe":  # all blocks of a wrong colour
            wanted: Any = str(rng.choice(sorted({*colours[:5]})))
            return "MatchRegions", replace(scene, regions=(replace(scene.regions[0], colour=wanted),))
        case "FixColour":
            odd = int(rng.integers(2))
            own = [area.colour for area in scene.regions]
            own[odd] = next(other for other in COLOURS if other != own[odd])
            blocks = (replace(block, colour=colour) for block, colour in zip(scene.blocks, own, strict=True))
            return task, replace(scene, blocks=tuple(blocks))
        case "MakeLine":
            return "ClusterColour", recoloured(scene, rng, ("red", "red", "blue", "blue"))
        case "ClusterColour":
            return "ClusterShape", scene
        case _:
            return "ClusterColour", scene


def mistaken(task: str, number: int, steps: int) -> Actions:
    """The actions of an expert with a wrong goal."""
    other, scene = wrong_goal(task, np.random.default_rng([zlib.crc32(task.encode()), number]))
    with closing(Engine(other, scene=scene)) as engine:
        expert, actions = Expert(engine, other, number), list[int]()
        while not engine.over and len(actions) < steps:
            actions.append(expert())
            engine.step(actions[-1])
    return np.array(actions + [0] * (steps - len(actions)), np.uint8)


def candidates(task: str, body: str) -> Iterator[tuple[Demonstrator, int, Actions]]:
    """Kind, seed of the scene, and actions of all candidates."""
    shipped, steps = load(task, body=body), task_spec(task).horizon(body=body)
    rng = np.random.default_rng(zlib.crc32(f"{task} {body}".encode()))
    makers: dict[Demonstrator, Callable[..., Actions]] = {"stopped": stopped, "disturbed": disturbed}
    count, wrong = (LONG_CANDIDATES, LONG_MISTAKEN) if steps > LONG else (CANDIDATES, MISTAKEN)
    for number in range(count):
        for kind, make in makers.items():
            demo = shipped[rng.integers(len(shipped))]
            yield kind, demo.scene_seed, make(demo, steps, rng)
        if number < wrong and not task_spec(task).speeds:
            yield "mistaken", shipped[0].scene_seed, mistaken(task, number, steps)
        elif number < wrong:
            one, other = rng.choice(len(shipped), 2, replace=False)
            yield "mistaken", shipped[one].scene_seed, still(shipped[other], steps)


def chosen(task: str, body: str) -> list[Demonstration]:
    """25 demonstrations, evenly over the quartiles of the score as far as there are any, and over the kinds."""
    bins: dict[int, dict[str, list[Demonstration]]] = defaultdict(lambda: defaultdict(list))
    seen = set()
    for kind, seed, actions in candidates(task, body):
        if (key := (seed, actions.tobytes())) not in seen:
            seen.add(key)
            variant = "Layout" if task_spec(task).speeds else "Demo"
            demo = replayed(task, variant, seed, actions, kind, body=body)
            bins[min(int(demo.score * BINS), BINS - 1)][kind].append(demo)
    picked: list[Demonstration] = []
    while len(picked) < COUNT and any(any(kinds.values()) for kinds in bins.values()):
        for quartile in sorted(bins):
            kinds = {kind: group for kind, group in bins[quartile].items() if group}
            if kinds and len(picked) < COUNT:
                fewest = min(sorted(kinds), key=lambda kind: sum(demo.demonstrator == kind for demo in picked))
                picked.append(kinds[fewest].pop(0))
    return sorted(picked, key=lambda demo: demo.score)


def histogram(picture: Path) -> None:
    """Draws how many demonstrations of each task have which score."""
    names = list(KNOWN)
    figure = Figure((9.0, 4.5), layout="constrained", dpi=100)
    for axes, task in zip(figure.subplots(2, 5, sharex=True).flat, names, strict=False):
        bodies = task_spec(task).bodies if task_spec(task).speeds else ("gripper",)
        demos = [demo for body in bodies for demo in load(task, body=body, set="graded")]
        kinds = ("stopped", "disturbed", "mistaken")
        scores = [[demo.score for demo in demos if demo.demonstrator == kind] for kind in kinds]
        axes.hist(scores, bins=np.linspace(0, 1.0001, 13).tolist(), stacked=True, label=list(kinds))
        axes.set_title(task if len(bodies) == 1 else f"{task}, {len(bodies)} bodies", fontsize=9)
    figure.axes[-1].set_axis_off()
    figure.supxlabel("score")
    figure.supylabel("demonstrations")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="lower right", fontsize=9)
    figure.savefig(picture)


def main() -> None:
    """Makes those of the tasks named, or draws the histograms."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--tasks", default=",".join(KNOWN))
    parser.add_argument("--histogram", type=Path)
    options = parser.parse_args()
    if options.histogram:
        histogram(options.histogram)
        return
    for task in options.tasks.split(","):
        for body in task_spec(task).bodies if task_spec(task).speeds else ("gripper",):
            demos = chosen(task, body)
            kept = [row for row in stored_rows(FILES["graded"]) if (row.task, row.body) != (task, body)]
            pack_rows(FILES["graded"], kept, demos)
            quartiles = np.bincount([min(int(demo.score * BINS), BINS - 1) for demo in demos], minlength=BINS)
            kinds = {
                kind: sum(demo.demonstrator == kind for demo in demos) for kind in ("stopped", "disturbed", "mistaken")
            }
            print(f"{task}, {body}: {len(demos)}, by quartile {quartiles.tolist()}, {kinds}", flush=True)


if __name__ == "__main__":
    main()
