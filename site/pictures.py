"""The pictures of the task pages: demonstrations, initial scenes, and examples of scores."""

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
PERIOD: Final = 1000 // CONTROL_RATE  # milliseconds between actions
SEEDS: Final = 3
FRAMES: Final = 130  # the maximum number of frames of an animation


def animation(task: str, path: Path) -> str:
    """Writes a demonstration in both views as a looping animated WebP. Long ones are shown faster.

    Its first picture is written as well. Returns the name of this.
    """
    demo = demos.load(task)[0]
    frames = demos.render_demo(demo, ("allo", "ego"), ANIMATION)
    shown = itertools.islice(frames, 0, None, 1 + len(demo.actions) // FRAMES)
    frames = [Image.fromarray(np.hstack([views["allo"], views["ego"]])) for views in shown]
    frames += [frames[-1]] * CONTROL_RATE
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=PERIOD, loop=0, quality=55, method=4)
    still = path.with_name(f"{path.stem}-still.webp")
    frames[0].save(still, quality=70, method=4)
    return still.name


def film(env: Engine, actions: Sequence[Any], path: Path, size: int = FILM, frames: int = 36) -> tuple[str, str]:
    """Writes an episode as a looping animated WebP, and its first picture.

    Args:
        env: the engine in which the actions are replayed. It is closed at the end.
        actions: the actions of the whole episode.
        path: the path of the files without a suffix.
        size: pixels per side.
        frames: the maximum number of frames.

    Returns:
        The names of the first picture and of the animation.
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
    """Writes a scene from above as a small PNG."""
    env = magical_mj.Engine.of_scene(scene)
    Image.fromarray(env.render("allo", size)).quantize(64).save(path, optimize=True)
    env.close()


def scenes(task: str, variant: str, folder: Path) -> list[Path]:
    """Writes pictures of the initial scenes of the first seeds, or of Demo's only scene. Returns their paths."""
    found = []
    for seed in range(1 if variant == "Demo" else SEEDS):
        path = folder / f"{task}-{variant}-{seed}.png"
        picture(magical_mj.sample_scene(task, variant, seed), path, SCENE)
        found.append(path)
    return found


def examples(task: str, folder: Path) -> list[tuple[float, Path]]:
    """Writes pictures of final states in Demo with score 0, with a score in between if one is found, and with 1."""
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
    """Yields the states of demonstrations in reverse, and then solved states with a moved block inside a region."""
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
