"""The cases of each kind. `python tools/fuzz` runs this, and reads a line of JSON for each case from standard output.

python tools/fuzz/cases.py KIND FIRST:END SECONDS FOLDER [--loud]
"""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import random
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TextIO

from clients import clients, states
from costs import costs
from gymnasium.error import Error as GymnasiumError
from inputs import damaged_files, hostile_command
from values import FindError, json_value, spoilt_tree, value

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.observations import CAMERAS
from magical_mj.utils.errors import MagicalError

sys.path.append(str(Path(__file__).parents[2]))  # Python adds only the folder of this file
from tests.helpers.hostile import WORST, worst

PATIENCE: Final = 300.0  # seconds for one case
Case = Callable[[random.Random, Path], None]


def scenes(rng: random.Random, folder: Path) -> None:
    """A scene's JSON with a few changes must be refused, or be valid for drawing, playing, writing and exporting."""
    task, variant = rng.choice(magical_mj.ENVIRONMENTS)
    first = magical_mj.sample_scene(task, variant, rng.randrange(1000))
    tree = spoilt_tree(json.loads(first.to_json()), rng) if rng.random() < 0.97 else json_value(rng)
    text = "[" * 10**5 if rng.random() < 0.005 else json.dumps(tree)
    scene = magical_mj.Scene.from_json(text)
    env = magical_mj.Engine.of_scene(scene)
    try:
        env.reset()
        for camera in CAMERAS:
            env.render(camera, 32)
        for _ in range(5):
            env.step(rng.randrange(len(ACTIONS)))
        now = env.scene
        if magical_mj.Scene.from_json(now.to_json()) != now:
            raise FindError("a scene differs from its JSON")
        magical_mj.export_mjcf(env, folder / "scene.xml")
    finally:
        env.close()


def hands(rng: random.Random, _folder: Path) -> None:
    """In an episode of violent random actions, no body may break, leave the arena, or penetrate another one."""
    number = rng.randrange(10**6)
    for name, size in worst(number).items():
        if size > TAIL * WORST[name]:
            raise FindError(f"{name} is {size:g} in the episode {number} of violent actions")


def calls(rng: random.Random, _folder: Path) -> None:
    """A public function with one or two hostile arguments."""
    name = rng.choice(list(CALLS))
    call, arguments = CALLS[name]
    given = dict(arguments)
    others = [key for key, usual in arguments.items() if not isinstance(usual, bool)]  # any object is a valid bool
    for key in rng.sample(others, k=min(len(others), rng.choice((1, 1, 2)))):
        given[key] = value(rng)
    env = call(**given)
    if hasattr(env, "reset"):
        env.reset()
        env.step(0)
        env.close()


def _episode(preset: str, seed: Any, options: Any, action: Any) -> None:
    env = gymnasium_env(preset)
    env.reset(seed=seed, options=options)
    env.step(action)
    env.close()


def gymnasium_env(preset: str, **settings: Any) -> Any:
    """An environment with Gymnasium's own checks."""
    import gymnasium

    return gymnasium.make(magical_mj.env_id("FindDupe", "All", preset), **settings)


def _draw(view: Any, size: Any) -> None:
    env = magical_mj.Engine("MoveToRegion")
    env.render(view, size)
    env.close()


def _moved(robot: Any, blocks: Any) -> None:
    scene = magical_mj.sample_scene("FixColour", "Demo", 0).moved(robot, blocks)
    magical_mj.score("FixColour", scene, scene)


def _expert(task: Any, seed: Any) -> None:
    env = magical_mj.Engine("MoveToRegion")
    env.step(magical_mj.experts.Expert(env, task, seed)())


def _learn(task: Any, preset: Any) -> None:
    magical_mj.demos.transitions(magical_mj.demos.load(task)[:1], preset)


def _settings(**given: Any) -> None:
    from magical_mj.evaluation import EvaluationSettings

    EvaluationSettings(**given)


def _training(**given: Any) -> None:
    from magical_mj.learners import load_settings

    known = {key: given.pop(key) for key in ("method", "tasks", "quick")}
    load_settings(known["method"], known["tasks"], quick=known["quick"], **{str(given["name"]): given["given"]})


SETTINGS: Final[dict[str, Any]] = {"image_size": 96, "reward": "none", "rules": "paper"}
CALLS: Final[dict[str, tuple[Callable[..., Any], dict[str, Any]]]] = {
    "sample_scene": (magical_mj.sample_scene, {"task": "FindDupe", "variant": "All", "seed": 0}),
    "score": (
        magical_mj.score,
        {
            "task": "MoveToRegion",
            **dict.fromkeys(("initial", "final"), magical_mj.sample_scene("MoveToRegion", "Demo", 0)),
        },
    ),
    "load": (
        magical_mj.load,
        {"task": "FindDupe", "variant": "All", "seed": 0, "scene": None, "observations": ("ego",), **SETTINGS},
    ),
    "load_scene": (
        magical_mj.load_scene,
        {"scene": magical_mj.sample_scene("FindDupe", "All", 0), "seed": 1, "observations": (), "image_size": 16},
    ),
    "env_id": (magical_mj.env_id, {"task": "FindDupe", "variant": "All", "preset": "State"}),
    "make": (
        gymnasium_env,
        {"preset": "LoRes4E", "action": "discrete", "render_view": "ego", "render_size": 32, "score_every_step": True}
        | SETTINGS,
    ),
    "episode": (_episode, {"preset": "State", "seed": 1, "options": None, "action": 0}),
    "render": (_draw, {"view": "ego", "size": 16}),
    "moved": (_moved, {"robot": (0, 0, 0), "blocks": None}),
    "robot": (magical_mj.Robot, {"x": 0, "y": 0, "angle": 0, "fingers": (0, 0)}),
    "block": (magical_mj.Block, {"shape": "star", "colour": "red", "x": 0, "y": 0, "angle": 0}),
    "region": (magical_mj.GoalRegion, {"colour": "red", "x_min": 0, "y_min": 0, "x_max": 1, "y_max": 1}),
    "dynamics": (magical_mj.Dynamics, {"drive_force": 1.0, "turn_torque": 1.0}),
    "scene": (magical_mj.Scene, {"robot": magical_mj.Robot(0, 0, 0), "blocks": (), "regions": ()}),
    "from_json": (magical_mj.Scene.from_json, {"text": "{}"}),
    "expert": (_expert, {"task": "MoveToRegion", "seed": 0}),
    "transitions": (_learn, {"task": "MoveToRegion", "preset": "State"}),
    "recording": (magical_mj.demos.from_recording, {"text": "{}"}),
    "evaluation": (
        _settings,
        {"tasks": "all", "variants": "all", "episodes": 3, "preset": "", "rules": "paper", "jobs": 1, "run": 0}
        | {"backend": "local", "address": None, "time_limit": 3.0},
    ),
    "training": (
        _training,
        {"method": "bc", "tasks": "MoveToRegion", "quick": True, "name": "bc.batches", "given": 3},
    ),
}

TAIL: Final = 3
"""The limit, as a multiple of the worst values in the 2,000 episodes of docs/physics.md. Few other episodes exceed
these, by .027 at most."""

KINDS: Final[dict[str, Case]] = {
    "calls": calls,
    "scenes": scenes,
    "states": states,
    "hands": hands,
    "files": damaged_files,
    "commands": hostile_command,
    "clients": clients,
    "costs": costs,
}


def result(kind: str, number: int, folder: Path, *, loud: bool) -> dict[str, str]:
    """Runs a case. Its result is "fine", "refused" (with a clear error) or "find"."""
    rng = random.Random(f"{kind} {number}")  # noqa: S311  no secret
    directory = Path(tempfile.mkdtemp(dir=folder))
    before = Path.cwd()
    os.chdir(directory)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore" if not loud else "default")
            KINDS[kind](rng, directory)
    except (MagicalError, GymnasiumError) as error:
        kind_of_result = "refused" if str(error).strip() else "find"
        outcome = {"result": kind_of_result, "what": type(error).__name__, "said": str(error)}
    except Exception as error:  # noqa: BLE001  any other error is a finding
        if loud:
            traceback.print_exc()
        frames = [frame for frame in traceback.extract_tb(error.__traceback__) if "tools/fuzz" not in frame.filename]
        ours = [frame for frame in frames if "/magical_mj/" in frame.filename] or frames
        where = f" at {Path(ours[-1].filename).name}:{ours[-1].lineno} in {ours[-1].name}" if ours else ""
        what = str(error)[:80] if isinstance(error, FindError) else f"{type(error).__name__}{where}"
        outcome = {"result": "find", "what": what, "said": str(error)}
    else:
        outcome = {"result": "fine", "what": "", "said": ""}
    finally:
        os.chdir(before)
        shutil.rmtree(directory, ignore_errors=True)
    return outcome


def main(kind: str, numbers: str, seconds: str, folder: str, *rest: str) -> None:
    """Runs the cases with these numbers until the time is over, at least one. Prints a line of JSON for each."""
    end = time.monotonic() + float(seconds)
    out: TextIO = os.fdopen(os.dup(1), "w")
    with contextlib.redirect_stdout(sys.stderr):
        os.dup2(2, 1)  # output of libraries must not mix with the results
        for number in range(*map(int, numbers.split(":"))):
            faulthandler.dump_traceback_later(PATIENCE, exit=True)  # shows the call that hangs
            outcome = result(kind, number, Path(folder), loud="--loud" in rest)
            faulthandler.cancel_dump_traceback_later()
            print(json.dumps(outcome), file=out, flush=True)
            if time.monotonic() > end:
                return


if __name__ == "__main__":
    main(*sys.argv[1:])
