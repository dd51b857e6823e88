"""The pictures of the task pages: an expert at work, initial scenes, and examples of scores."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from PIL import Image

import magical_mj
from magical_mj import demos
from magical_mj.engine import Engine
from magical_mj.scene import Scene, geometry
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.utils.errors import InvalidSceneError

ANIMATION, FILM, SCENE, EXAMPLE = 224, 192, 112, 160  # pixels
PERIOD: Final = 1000 // CONTROL_RATE  # milliseconds from action to action
SEEDS: Final = 3
FRAMES: Final = 130  # of an animation, at most


def animation(task: str, path: Path) -> None:
    """A demonstration from both sides, as an animated WebP that goes round; a long one at several times its speed."""
    demo = demos.load(task)[0]
    frames = demos.render_demo(demo, ("allo", "ego"), ANIMATION)
    shown = itertools.islice(frames, 0, None, 1 + len(demo.actions) // FRAMES)
    frames = [Image.fromarray(np.hstack([views["allo"], views["ego"]])) for views in shown]
    frames += [frames[-1]] * CONTROL_RATE
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=PERIOD, loop=0, quality=55, method=4)


def film(env: Engine, actions: Sequence[Any], path: Path, size: int = FILM, frames: int = 36) -> tuple[str, str]:
    """An episode, played again from its actions, as an animated WebP that goes round, and its first picture.

    Args:
        env: where the actions are taken; closed at the end.
        actions: all of the episode.
        path: of the files, without an ending.
        size: pixels per side.
        frames: at most so many.

    Returns:
        The names of the still and of the moving picture.
    """
    every = 1 + len(actions) // frames
    shown: list[Image.Image] = []
    for step, action in enumerate(actions):
        if step % every == 0:
            shown.append(Image.fromarray(env.render("allo", size)))
        env.step(action)
    shown += [Image.fromarray(env.render("allo", size))] * CONTROL_RATE
    env.close()
    names = f"{path.name}-still.webp", f"{path.name}.webp"
    shown[0].save(path.with_name(names[0]), quality=70, method=4)
    period = max(60, every * PERIOD // 4)
    shown[0].save(
        path.with_name(names[1]),
        save_all=True,
        append_images=shown[1:],
        duration=period,
        loop=0,
        quality=55,
        method=4,
    )
    return names


def picture(scene: Scene, path: Path, size: int) -> None:
    """A scene from above as a small PNG."""
    env = magical_mj.Engine.of_scene(scene)
    Image.fromarray(env.render("allo", size)).quantize(64).save(path, optimize=True)
    env.close()


def scenes(task: str, variant: str, folder: Path) -> list[Path]:
    """Pictures of the initial scenes of the first seeds; of Demo, which has one, of that."""
    found = []
    for seed in range(1 if variant == "Demo" else SEEDS):
        path = folder / f"{task}-{variant}-{seed}.png"
        picture(magical_mj.sample_scene(task, variant, seed), path, SCENE)
        found.append(path)
    return found


def examples(task: str, folder: Path) -> list[tuple[float, Path]]:
    """Pictures of final states of the Demo variant with score 0, with one in between if there is one, and with 1."""
    initial = magical_mj.sample_scene(task, "Demo", 0)
    by_score: dict[float, Scene] = {}
    for final in _final_scenes(task):
        by_score.setdefault(magical_mj.score(task, initial, final), final)
    between = [score for score in by_score if 0 < score < 1]
    chosen = [0.0, *sorted(between, key=lambda score: abs(score - 0.5))[:1], 1.0]
    found = []
    for score in chosen:
        path = folder / f"{task}-score-{100 * score:.0f}.png"
        picture(by_score[score], path, EXAMPLE)
        found.append((score, path))
    return found


def _final_scenes(task: str) -> Iterator[Scene]:
    """States of demonstrations from their ends back; then solved ones in which a stray block lies in a region."""
    shipped = demos.load(task)[:5]
    for demo in shipped:
        yield from reversed(demo.scenes())
    solved = shipped[0].scenes()[-1]
    for stray, region in itertools.product(range(len(solved.blocks)), solved.regions):
        for x, y in itertools.product(
            np.linspace(region.x_min, region.x_max, 12), np.linspace(region.y_min, region.y_max, 12)
        ):
            poses = [block.pose for block in solved.blocks]
            poses[stray] = (float(x), float(y), 0.0)
            moved = solved.moved(blocks=poses)
            try:
                geometry.check_scene(moved)
            except InvalidSceneError:
                continue
            yield moved
