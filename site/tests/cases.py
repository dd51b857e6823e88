"""Writes episodes, scores and pictures from Python, for comparison with JavaScript: cases.py FOLDER."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import json
import sys
import tempfile
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import dm_control.suite
import gymnasium
import mujoco
import numpy as np

sys.path.append(str(Path(__file__).parents[1]))
from shifted import SUITE, SWEPT, described, offered, scenes

import magical_mj
from magical_mj.actions import ACTIONS
from magical_mj.engine import Engine
from magical_mj.engine.export import mjcf_text
from magical_mj.intents import SETS, Intent
from magical_mj.intents.ambiguity import all_conjuncts
from magical_mj.intents.names import tasks_in
from magical_mj.intents.relations import RELATIONS
from magical_mj.intents.scenes import missing
from magical_mj.intents.selectors import REST
from magical_mj.learners import load_settings, train
from magical_mj.learners.policy import export_policy
from magical_mj.policies.interface import actions_of, histories
from magical_mj.policies.models import onnx_runtime
from magical_mj.scene import Block, GoalRegion, Scene
from magical_mj.scene.bodies import BODIES, GRIPPER
from magical_mj.scene.constants import BLOCK_MASS, COLOURS, SHAPES
from magical_mj.scene.geometry import check_scene
from magical_mj.tasks.registry import task_spec
from magical_mj.utils.errors import IntentError, InvalidSceneError, MagicalError
from magical_mj.web.inspection import model_files
from magical_mj.web.page_data import HINTS, drawing_style, sample_models, scene_data, solid_shapes
from magical_mj.web.pursued import demonstrated_data, pursued
from magical_mj.web.puzzles import first_reached, goal_data

ROUGH: Final = 60
SHIPPED: Final = slice(None, None, 5)  # of each task's demonstrations
STEPS: Final = 100
GLANCES: Final = (1, 20, 100)  # numbers of steps before states are compared. The last state is compared as well
SCORED: Final = 10  # one of this number of demonstration states is scored
GATHERED: Final = 30  # scored states of each environment
INTENTS: Final = 25  # of each kind, scored in each state
READ: Final = 5  # one of this number of them is also read and grounded
TEXTS: Final = 1_000  # of intents, each also with an error
PURSUITS: Final = 8  # last scenes of each environment, for comparing what was pursued
WATCHED: Final = "state-bc"
"""The entry whose episodes of these tasks are watched."""
ENDED: Final = ("FindDupe", "MatchRegions", "MoveToRegion")
SITE: Final = Path(__file__).parents[2] / "out" / "site"
SEEN: Final = 25  # states of each task for comparing state vectors and policies
POLICIES: Final = Path(__file__).parents[1] / "policies"
PICTURES: Final = 192  # pixels
EVERY: Final = 4  # pictures of one of this number of environments are compared
LOOKS: Final = 4  # compared policies' pictures of each environment
LOOK_SIZE: Final = 96  # pixels
LOOKING: Final = {"LoRes4E": "FindDupe", "LoRes4A": "MakeLine", "LoRes3EA": "MatchRegions"}
"""Preset of pictures -> the task of its trained policy."""
LOOKED: Final = 200  # the number of pictures for these policies, for all presets together
EDITS: Final = 4  # edited scenes of each environment and seed
POSE: Final = ("x", "y", "angle")
VEERING: Final = [(("FindDupe", "Dynamics"), "friction:4,clutter:3"), (("MakeLine", "Demo"), "clutter:4")]
BRIEF: Final = {
    "augment": "none",
    "bc.batches": 80,
    "demonstrations": 1,
    "evaluations": 0,
    "checkpoints": 1,
    "network.first_channels": 8,
    "network.channels": 16,
    "network.hidden": 64,
}
"""The settings of a short training, long enough for a policy to choose different actions."""


def episodes() -> Iterator[dict[str, Any]]:
    """Demonstrations, and drives with held actions into blocks, walls and heaps."""
    for task in magical_mj.TASKS:
        for number, demo in enumerate(magical_mj.demos.load(task)[SHIPPED]):
            yield _played(f"demonstration {number} of {task}", Engine(task, scene=demo.scene), demo.actions.tolist())
    rng = np.random.default_rng(0)
    for seed in range(ROUGH):
        task, variant = magical_mj.ENVIRONMENTS[seed % len(magical_mj.ENVIRONMENTS)]
        scene = magical_mj.sample_scene(task, variant, 1000 + seed)
        yield _played(f"rough drive {seed}, {task}-{variant}", Engine(task, scene=scene), _drive(rng))
    for pair in (*((task, "Demo") for task in magical_mj.TASKS), *SUITE):
        for axis, levels in offered(*pair).items():
            shift = f"{axis}:{levels[len(levels) // 2]}"
            engine = Engine(*pair, seed=0, shifts=shift)
            yield _played(f"shifted drive of {'-'.join(pair)}, {shift}", engine, _drive(rng))
    for pair, body in itertools.product(SUITE, BODIES):
        shift = "" if body == GRIPPER else f"body:{body}"
        (entry, *_) = scenes(*pair, [shift])[0]["scenes"]
        yield _played(f"expert of {'-'.join(pair)}, {body}", Engine(*pair, seed=0, body=body), entry["expert"])


def _drive(rng: np.random.Generator) -> list[int]:
    """Random actions, each repeated for some steps."""
    with_drive = [action for action in range(18) if action % 3]
    return np.repeat(rng.choice(with_drive, 40), rng.integers(2, 16, 40)).tolist()


def _played(name: str, env: Engine, actions: list[Any]) -> dict[str, Any]:
    start = {"name": name, "task": env.task, "mjcf": mjcf_text(env, rounded=False), **described(env)}
    glances = {}
    actions = actions[: env.horizon]
    for step, action in enumerate(actions, start=1):
        env.step(action)
        if step == len(actions) or step in GLANCES:
            glances[step] = scene_data(env.scene)
    score = env.score()
    env.close()
    return {**start, "actions": actions, "glances": glances, "score": score}


COMBINED: Final = (
    ("FindDupe", "Demo", 2, "clutter:3,slip:4,friction:5"),
    ("FindDupe", "All", 1, "pose:3,latency:5,slip:2"),
    ("FindDupe", "Dynamics", 0, "latency:2,slip:5,friction:1"),
)


def combined() -> Iterator[dict[str, Any]]:
    """Short drives in scenes with several shifts."""
    rng = np.random.default_rng(1)
    for task, variant, seed, shifts in COMBINED:
        engine, actions = Engine(task, variant, seed=seed, shifts=shifts), _drive(rng)[:40]
        for action in actions:
            engine.step(action)
        final = scene_data(engine.scene)
        engine.close()
        yield {"task": task, "variant": variant, "seed": seed, "shifts": shifts, "actions": actions, "final": final}


def scores() -> Iterator[dict[str, Any]]:
    """States of the demonstrations, of the reference, and of each environment, with their scores."""
    for task in magical_mj.TASKS:
        for demo in magical_mj.demos.load(task)[SHIPPED]:
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
    for task, variant in (*magical_mj.ENVIRONMENTS, *SUITE):
        for seed in range(GATHERED):
            scene = magical_mj.sample_scene(task, variant, seed)
            yield _scored(task, scene, _gathered(scene, rng))


def goals() -> Iterator[dict[str, Any]]:
    """States of scenes with intents: single relations, pairs and those of the eight tasks, with their scores."""
    rng = np.random.default_rng(2)
    singles = [Intent((conjunct,)) for conjunct in all_conjuncts() if conjunct.selector != REST]
    drawn = [task.intent for name in SETS for task in tasks_in(name)]
    for task, variant in magical_mj.ENVIRONMENTS:
        for seed in range(GATHERED // 3):
            initial = magical_mj.sample_scene(task, variant, seed)
            final = _gathered(initial, rng) if seed % 3 else initial
            some = [magical_mj.intents.EIGHT[task]]
            for intents in (singles, drawn):
                some += [intents[place] for place in rng.integers(len(intents), size=INTENTS)]
            judged = [
                {
                    "intent": str(intent),
                    "goal": goal_data(intent, initial),
                    "score": intent.score(initial, final),
                    "held": intent.holds(initial, final),
                    "starts": not missing(intent, initial) if number % READ == 0 else None,
                }
                for number, intent in enumerate(some)
            ]
            yield {"initial": scene_data(initial), "final": scene_data(final), "goals": judged}


def language() -> Iterator[tuple[str, str | None, str | None]]:
    """Texts with the canonical text and the sentence of their intents, or None: relations in any number and order.

    In half of them, a character is added or removed.
    """
    rng = np.random.default_rng(4)
    relations = [str(Intent((conjunct,))) for conjunct in all_conjuncts()]
    of = {name: [text for text in relations if text.startswith(f"{name}(")] for name in RELATIONS}
    for number in range(TEXTS):
        some = of[str(rng.choice(list(of)))] if number % 2 else relations  # similar ones may follow from each other
        text = " & ".join(some[place] for place in rng.integers(len(some), size=rng.integers(1, 6)))
        at = int(rng.integers(len(text)))
        for one in (text, text[:at] + str(rng.choice(["", *"(),&= !a1"])) + text[at + 1 :]):
            try:
                intent = magical_mj.intents.parse(one)
                yield one, str(intent), intent.sentence
            except IntentError:
                yield one, None, None


def _gathered(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with its objects gathered around a few positions, so that scores between 0 and 1 occur as well."""
    places = [*(region.centre for region in scene.regions), *rng.uniform(-0.8, 0.8, (2, 2))]
    x, y = places[rng.integers(len(places))]
    blocks = [(*(places[rng.integers(len(places))] + rng.normal(0, 0.1, 2)), 0.0) for _ in scene.blocks]
    return scene.moved((x, y, 0.0), blocks)


def _scored(task: str, initial: Scene, final: Scene) -> dict[str, Any]:
    score = magical_mj.score(task, initial, final)
    return {"task": task, "initial": scene_data(initial), "final": scene_data(final), "score": score}


def pursuits() -> Iterator[dict[str, Any]]:
    """First and last scenes of each environment, with up to three blocks moved, and the pursued goal."""
    rng = np.random.default_rng(3)
    written = json.loads((SITE / "play" / "rivals.json").read_text())
    rivals = {task: [magical_mj.intents.parse(text) for text in texts] for task, texts in written.items()}
    for number, (task, variant) in enumerate(magical_mj.ENVIRONMENTS * PURSUITS):
        initial = magical_mj.sample_scene(task, variant, number)
        regions = (*initial.regions, *task_spec(task).demo.regions)
        places = [*(region.centre for region in regions), *rng.uniform(-1, 1, (2, 2))]
        poses = [block.pose for block in initial.blocks]
        for index in rng.permutation(len(poses))[: rng.integers(4)]:
            poses[index] = (*(places[rng.integers(len(places))] + rng.normal(0, 0.05, 2)), 0.0)
        robot = [initial.robot.pose, (*places[rng.integers(len(places))], 0.0)][rng.integers(2)]
        final = initial.moved(robot, poses)
        scored = _scored(task, initial, final)
        rival = first_reached(rivals[task], initial, final)
        told = dataclasses.asdict(pursued(task, initial, final, scored["score"]))
        yield {**scored, "pursued": told, "rival": rival.sentence if rival else ""}


def watched() -> Iterator[dict[str, Any]]:
    """An episode of some tasks that moved wrong blocks only, and what it and a robot that stays pursued."""
    stored = json.loads((SITE / "play" / "replays" / f"{WATCHED}.json").read_text())
    for task in ENDED:
        yield next(case for item in stored[f"{task}-Layout"].items() if (case := _watched(task, *item)))


def _watched(task: str, seed: str, letters: str) -> dict[str, Any] | None:
    """The case of one stored episode; none if it has a score or moved an intended block."""
    with closing(Engine(task, "Layout", seed=int(seed))) as engine:
        for action in actions_of(letters):
            engine.step(action)
        initial, final, score = engine.initial_scene, engine.scene, engine.score()
    told = pursued(task, initial, final, score)
    if score > 0 or (initial.blocks and (not told.moved or {*told.moved} & {*told.intended})):
        return None
    return {
        "address": f"{task}-Layout-{seed}",
        "watched": told.sentence,
        "played": pursued(task, initial, initial, 0.0).sentence,
    }


def pictures() -> Iterator[dict[str, Any]]:
    """The renderer's pictures: red, green and blue of each pixel, from the top left, as hexadecimal digits."""
    for number, (task, variant) in enumerate(magical_mj.ENVIRONMENTS):
        if number % EVERY == 0:
            env = magical_mj.Engine(task, variant, seed=number)
            yield from (_pictured(env, view) for view in ("allo", "ego"))
            env.close()
    others = [Engine(*pair, seed=0, body=body) for pair in SUITE for body in offered(*pair)["body"]]
    for env in (Engine(SWEPT, "All", seed=1), Engine("MakeLine", seed=0, shifts="clutter:5"), *others):
        yield from (_pictured(env, view) for view in ("allo", "ego"))
        env.close()


def _pictured(env: Engine, view: str) -> dict[str, Any]:
    return {
        "scene": described(env)["scene"],
        "view": view,
        "size": PICTURES,
        "pixels": env.render(view, PICTURES).tobytes().hex(),
    }


def policies() -> Iterator[dict[str, Any]]:
    """The first states of a demonstration of each task, and the outputs of the site's policy."""
    for task in magical_mj.TASKS:
        demo = magical_mj.demos.load(task)[0]
        played = _played(task, Engine(task, scene=demo.scene), demo.actions[:SEEN].tolist())
        states = np.asarray(magical_mj.demos.observations(demo, "State"))[:SEEN]
        session = onnx_runtime().InferenceSession(POLICIES / f"{task}.onnx")
        (logits,) = session.run(None, {"observations": histories(states)})
        best = np.asarray(logits).argmax(1).tolist()
        yield {**played, "states": states.tolist(), "best": best}


def looks() -> Iterator[dict[str, Any]]:
    """States of each environment, and a hash of the software renderer's picture of each in both views."""
    rng = np.random.default_rng(0)
    shifted = [(*pair, f"body:{body}") for pair in SUITE for body in offered(*pair)["body"]]
    for seed, (*pair, shift) in enumerate([*((*pair, "") for pair in (*magical_mj.ENVIRONMENTS, *SUITE)), *shifted]):
        env = Engine(*pair, seed=seed, shifts=shift or None, renderer="software")
        name, start = "-".join((*pair, str(seed), shift)), {"mjcf": mjcf_text(env, rounded=False), **described(env)}
        moments = []
        for action in rng.integers(len(ACTIONS), size=LOOKS).tolist():
            for _ in range(5):
                env.step(action)
            hashes = {
                view: hashlib.sha256(env.render(view, LOOK_SIZE).tobytes()).hexdigest() for view in ("ego", "allo")
            }
            moments.append({"qpos": env.data.qpos.tolist(), **hashes})
        env.close()
        yield {"name": name, **start, "moments": moments}


def looking(folder: Path) -> Iterator[dict[str, Any]]:
    """The outputs of policies from images along a demonstration. The policies are written to the folder."""
    for preset, task in LOOKING.items():
        demo, count = magical_mj.demos.load(task)[0], -(-LOOKED // len(LOOKING))
        env = Engine(task, scene=demo.scene)
        start = {"mjcf": mjcf_text(env, rounded=False), **described(env), "actions": demo.actions[:count].tolist()}
        env.close()
        with tempfile.TemporaryDirectory() as run:
            train(load_settings("bc", task, quick=True, preset=preset, **BRIEF), run)
            file = export_policy(run, folder / f"{preset}.onnx", overwrite=True)
        seen = np.asarray(magical_mj.demos.observations(demo, preset, renderer="software"))[:count]
        (logits,) = onnx_runtime().InferenceSession(file).run(None, {"observations": seen})
        yield {"preset": preset, **start, "best": np.asarray(logits).argmax(1).tolist()}


def edits() -> Iterator[dict[str, Any]]:
    """Scenes as the editor makes them: each with its fault, what it lacks for each task, and the model of some."""
    rng = np.random.default_rng(2)
    pairs = [*magical_mj.ENVIRONMENTS, *SUITE]
    starts = [magical_mj.sample_scene(*pair, seed) for seed in range(3) for pair in pairs]
    shifted = [(pair, f"body:{body}") for pair in SUITE for body in offered(*pair)["body"]]
    for environment, shift in (*shifted, *VEERING):
        with closing(Engine(*environment, seed=1, shifts=shift)) as engine:
            starts.append(engine.initial_scene)
    for number, start in enumerate(starts):
        for scene in (start, *(_edited(start, rng) for _ in range(EDITS))):
            try:
                check_scene(scene)
                fault = None
            except InvalidSceneError as error:
                fault = str(error)
            case = {"scene": scene.to_json(), "fault": fault, "lacks": {task: _lack(task, scene) for task in HINTS}}
            if number % 8 == 0 and fault is None:
                case["mjcf"] = mjcf_text(scene, rounded=False)
            yield case


def texts() -> dict[str, list[str]]:
    """Texts that `Scene.from_json` accepts and refuses: a scene with one field changed, removed or added."""
    plain = json.loads(magical_mj.sample_scene("FindDupe", "All", 3).to_json())
    changes = [(key, value) for key in plain for value in (None, 1, "x", [], {}, [1])]
    changes += [("half_width", value) for value in (0.5, 0.4, 2.5, True)]
    changes += [("pebbles", value) for value in ([], [{"x": 0, "y": 0}], [{"x": 0}], [{"x": 0, "y": 0, "z": 0}])]
    changes += [("dynamics", value) for value in ({"veer": -1}, {"drive_force": -1}, {"drive_force": 2}, {"mass": 1})]
    for name, values in {
        "x": (1e10, 1e11, "0", None),
        "shape": ("star", "stars"),
        "mass": (1, 0),
        "size": (1,),
    }.items():
        changes += [("blocks", [{**plain["blocks"][0], name: value}]) for value in values]
    for name, values in {"x_min": (3, -3), "border": ("solid", "none"), "colour": ("red", "pink")}.items():
        changes += [("regions", [{**plain["regions"][0], name: value}]) for value in values]
    for name, values in {"fingers": ([0, 0], [0], 0), "body": ("longstick", "stick", "x:Y"), "angle": (1, "")}.items():
        changes += [("robot", {**plain["robot"], name: value}) for value in values]
    all_texts = ["", "[]", "{}", *(json.dumps({**plain, key: value}) for key, value in changes)]
    all_texts += [json.dumps({key: value for key, value in plain.items() if key != left_out}) for left_out in plain]
    sorted_texts: dict[str, list[str]] = {"accepted": [], "refused": []}
    for text in all_texts:
        try:
            Scene.from_json(text)
            sorted_texts["accepted"].append(text)
        except MagicalError:
            sorted_texts["refused"].append(text)
    return sorted_texts


def _edited(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with some objects moved, changed, added and removed."""
    half = scene.half_width

    def pose() -> list[float]:
        return [*rng.uniform(-half, half, 2), rng.uniform(-3, 3)]

    robot = scene.robot
    if rng.random() < 0.5:
        robot = dataclasses.replace(robot, **dict(zip(POSE, pose(), strict=True)))
    mass = scene.blocks[0].mass if scene.blocks else BLOCK_MASS
    blocks: list[Any] = [block for block in scene.blocks if rng.random() < 0.8]
    for _ in range(rng.integers(3)):
        shape, colour = str(rng.choice(SHAPES)), str(rng.choice(COLOURS))
        blocks += [Block(shape, colour, *pose(), mass)]  # type: ignore[arg-type]
    regions = [region for region in scene.regions if rng.random() < 0.8]
    if rng.random() < 0.4:
        x, y, width, height = *rng.uniform(-half, 0.4, 2), *rng.uniform(0.1, 0.8, 2)
        border = "solid" if rng.random() < 0.3 else "dashed"
        regions.append(GoalRegion(str(rng.choice(COLOURS)), x, y, x + width, y + height, border))  # type: ignore[arg-type]
    return dataclasses.replace(scene, robot=robot, blocks=blocks, regions=regions)


def _lack(task: str, scene: Scene) -> str | None:
    """What the scene lacks for a task: the end of the message."""
    try:
        task_spec(task).check(scene)
    except InvalidSceneError as error:
        return str(error).partition("it needs ")[2]
    return None


def stepped() -> Iterator[dict[str, Any]]:
    """Models, some from other sources with further files, and their states after 100 steps with maximum controls."""
    for task, variant in magical_mj.ENVIRONMENTS[::7]:
        env = magical_mj.Engine(task, variant, seed=1)
        controls = [0.8, 0.8, 2.5, 2.5, 1.0, 1.0]  # the largest values of all actions
        yield _stepped(f"{task}-{variant}-1", {f"{task}-{variant}-1.xml": mjcf_text(env).encode()}, controls)
        env.close()
    locomotion, suite = (Path(module.__file__ or "").parent for module in (gymnasium, dm_control.suite))
    locomotion /= "envs/mujoco/assets"
    for path in (locomotion / "ant.xml", locomotion / "walker2d_v5.xml", suite / "cartpole.xml"):
        yield _stepped(path.name, model_files(path))
    files = {"tetrahedron.xml": TETRAHEDRON.encode(), "tetrahedron.obj": OBJ.encode()}
    yield _stepped("tetrahedron.xml", files)


TETRAHEDRON: Final = """<mujoco>
  <compiler meshdir="shapes"/>
  <asset><mesh file="tetrahedron.obj"/></asset>
  <worldbody>
    <geom type="plane" size="2 2 .1"/>
    <!-- It falls on a corner -->
    <body name="stone" pos="0 0 .6" euler="30 40 0"><freejoint/><geom type="mesh" mesh="tetrahedron"/></body>
  </worldbody>
</mujoco>
"""
OBJ: Final = """v 0 0 0
v .3 0 0
v 0 .3 0
v 0 0 .3
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def _stepped(name: str, contents: dict[str, bytes], controls: list[float] | None = None) -> dict[str, Any]:
    main, *others = contents
    text = contents[main].decode()
    model = mujoco.MjModel.from_xml_string(text, {other: contents[other] for other in others})
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    data.ctrl[:] = model.actuator_ctrlrange[:, 1] if controls is None else controls
    for _ in range(STEPS):
        mujoco.mj_step(model, data)
    return {
        "name": name,
        "files": {path: content.decode() for path, content in contents.items()},
        "qpos": data.qpos.tolist(),
        "qvel": data.qvel.tolist(),
    }


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    cases = {
        "stepped": list(stepped()),
        "episodes": list(episodes()),
        "policies": list(policies()),
        "scores": list(scores()),
        "goals": list(goals()),
        "language": list(language()),
        "pursuits": list(pursuits()),
        "watched": list(watched()),
        "combined": list(combined()),
        "pictures": list(pictures()),
        "looks": list(looks()),
        "looking": list(looking(folder)),
        "edits": list(edits()),
    }
    fixed = {"demonstrated": {task: demonstrated_data(task) for task in magical_mj.TASKS}}
    fixed |= {"texts": texts(), "look": drawing_style(), "solids": solid_shapes(), "samples": sample_models()}
    for name, content in {**cases, **fixed}.items():
        (folder / f"{name}.json").write_text(json.dumps(content))
