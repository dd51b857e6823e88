"""What Python makes of many episodes, scores and pictures, for the JavaScript to be held against: cases.py FOLDER."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

import magical_mj
from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.scene import Scene
from magical_mj.web.page_data import drawing_style, scene_data

ROUGH: Final = 200
GLANCES: Final = (1, 20, 100)  # steps after which states are compared; and the last one
SCORED: Final = 10  # every so many states of the demonstrations are scored
GATHERED: Final = 30  # scored states of each environment
PICTURES: Final = 192  # pixels
EVERY: Final = 4  # environments from one whose pictures are compared to the next


def episodes() -> Iterator[dict[str, Any]]:
    """The shipped demonstrations, and drives that hold an action for a while: into blocks, walls and heaps."""
    for task in magical_mj.TASKS:
        for number, demo in enumerate(magical_mj.demos.load(task)):
            yield _played(f"demonstration {number} of {task}", task, demo.scene, demo.actions.tolist())
    rng = np.random.default_rng(0)
    for seed in range(ROUGH):
        task, variant = magical_mj.ENVIRONMENTS[seed % len(magical_mj.ENVIRONMENTS)]
        scene = magical_mj.sample_scene(task, variant, 1000 + seed)
        with_drive = [action for action in range(18) if action % 3]
        actions = np.repeat(rng.choice(with_drive, 40), rng.integers(2, 16, 40)).tolist()
        yield _played(f"rough drive {seed}, {task}-{variant}", task, scene, actions)


def _played(name: str, task: str, scene: Scene, actions: list[int]) -> dict[str, Any]:
    env = magical_mj.Engine(task, scene=scene)
    env.reset()
    mjcf = mjcf_text(env)
    glances = {}
    actions = actions[: env.horizon]
    for step, action in enumerate(actions, start=1):
        env.step(action)
        if step == len(actions) or step in GLANCES:
            glances[step] = scene_data(env.scene)
    score = env.score()
    env.close()
    return {
        "name": name,
        "task": task,
        "scene": scene_data(scene),
        "mjcf": mjcf,
        "actions": actions,
        "glances": glances,
        "score": score,
    }


def scores() -> Iterator[dict[str, Any]]:
    """States of the demonstrations, the reference's, and many of every environment, with their scores."""
    for task in magical_mj.TASKS:
        for demo in magical_mj.demos.load(task):
            for final in demo.scenes()[::SCORED]:
                yield _scored(task, demo.scene, final)
    reference = Path(__file__).parents[2] / "tests" / "data" / "score_cases.json"
    for task, cases in json.loads(reference.read_text()).items():
        if task in magical_mj.TASKS:
            demo_scene = magical_mj.sample_scene(task, "Demo", 0)
            for case in cases:
                scored = _scored(task, demo_scene, demo_scene.moved(case["robot"], case["blocks"]))
                yield {**scored, "reference": case["score"]}  # rounded to 9 digits

    rng = np.random.default_rng(0)
    for task, variant in magical_mj.ENVIRONMENTS:
        for seed in range(GATHERED):
            scene = magical_mj.sample_scene(task, variant, seed)
            yield _scored(task, scene, _gathered(scene, rng))


def _gathered(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with its things around a few places, so that scores between 0 and 1 occur, too."""
    places = [*(region.centre for region in scene.regions), *rng.uniform(-0.8, 0.8, (2, 2))]
    x, y = places[rng.integers(len(places))]
    blocks = [(*(places[rng.integers(len(places))] + rng.normal(0, 0.1, 2)), 0.0) for _ in scene.blocks]
    return scene.moved((x, y, 0.0), blocks)


def _scored(task: str, initial: Scene, final: Scene) -> dict[str, Any]:
    score = magical_mj.score(task, initial, final)
    return {"task": task, "initial": scene_data(initial), "final": scene_data(final), "score": score}


def pictures() -> Iterator[dict[str, Any]]:
    """What the renderer draws: red, green and blue of each pixel, from the top left, as hexadecimal digits."""
    for number, (task, variant) in enumerate(magical_mj.ENVIRONMENTS):
        if number % EVERY == 0:
            env = magical_mj.Engine(task, variant, seed=number)
            yield from (_pictured(env, view) for view in ("allo", "ego"))
            env.close()


def _pictured(env: Engine, view: str) -> dict[str, Any]:
    return {
        "scene": scene_data(env.scene),
        "view": view,
        "size": PICTURES,
        "pixels": env.render(view, PICTURES).tobytes().hex(),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    cases = {"episodes": list(episodes()), "scores": list(scores()), "pictures": list(pictures())}
    for name, content in {**cases, "look": drawing_style()}.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
