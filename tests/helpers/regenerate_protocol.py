"""Fingerprints of everything that a protocol number guarantees; see docs/protocol.md.

To regenerate them, raise `PROTOCOL` (or, for the demonstrations, `DEMONSTRATIONS`) in magical_mj/protocol.py.
Then run from the repository's root:

    python -m tests.helpers.regenerate_protocol --because "blocks are placed before the robot now"

Without a reason, it only prints the changed parts. The reason is stored in the data file. Add a line to
docs/protocol.md as well.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
from pathlib import Path
from typing import Any, Final

import mujoco
import numpy as np

import magical_mj
from magical_mj.assets.robot import controls
from magical_mj.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks import RULES
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, sample_scene, score, task_spec

DATA: Final = Path(__file__).parents[1] / "data" / "protocol.json"
EVALUATED: Final = range(100)  # seeds of the test scenes
FINALS: Final = 40  # final scenes with compared scores, for each initial scene
MOVED: Final = 0.4  # share of the blocks that are moved in a final scene
PHYSICS: Final = {  # kind of element -> arrays of a compiled model, without those for drawing
    "opt": "timestep integrator cone jacobian solver iterations tolerance ls_iterations ls_tolerance impratio gravity "
    "density viscosity disableflags enableflags noslip_iterations sleep_tolerance",
    "body": "mass inertia",
    "dof": "armature damping frictionloss solref solimp",
    "jnt": "type axis limited range margin stiffness solref solimp",
    "pair": "dim friction solref solreffriction solimp margin gap",
    "tendon": "limited range margin stiffness damping frictionloss lengthspring "
    "solref_fri solimp_fri solref_lim solimp_lim",
    "wrap": "type prm",
    "actuator": "trntype gear dyntype dynprm gaintype gainprm biastype biasprm ctrllimited ctrlrange "
    "forcelimited forcerange",
    "geom": "type contype conaffinity size pos condim friction solref solimp margin gap priority solmix",
}


def scenes(task: str, variant: str) -> str:
    """The digest of the scenes of seeds 0 to 99."""
    return _digest([sample_scene(task, variant, seed).digest() for seed in EVALUATED])


def horizons(task: str) -> dict[str, int]:
    """The number of actions in an episode, by each set of rules."""
    return {rules: task_spec(task).horizon(rules) for rules in RULES}


def scores(task: str) -> str:
    """The digest of the scores of final scenes with some moved bodies, by each set of rules."""
    rng = np.random.Generator(np.random.PCG64(0))
    found = []
    for variant in (name for other, name in ENVIRONMENTS if other == task):
        initial = sample_scene(task, variant, 0)
        for _ in range(FINALS):
            poses = [_elsewhere(rng) if rng.random() < MOVED else block.pose for block in initial.blocks]
            final = initial.moved(_elsewhere(rng), poses)
            found += [round(score(task, initial, final, rules), 9) for rules in RULES]
    return _digest(found)


def physics(task: str) -> str:
    """The digest of the compiled model of a scene of All, the substeps of an action, and each action's `ctrl`."""
    env = magical_mj.Engine(task, "All", scene=sample_scene(task, "All", 0))
    env.reset()
    model = env.model
    found = model_digest(model), round(1 / CONTROL_RATE / model.opt.timestep), controls().tolist()
    env.close()
    return _digest(found)


def model_digest(model: mujoco.MjModel) -> str:
    """The digest of a compiled model, without the parts that are only drawn."""
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    touching[model.pair_geom1] = touching[model.pair_geom2] = True
    found = []
    for kind, names in PHYSICS.items():
        for name in names.split():
            value = getattr(model.opt, name) if kind == "opt" else getattr(model, f"{kind}_{name}")
            value = value[touching] if kind == "geom" else value
            found.append((kind, name, [f"{number:.6e}" for number in np.ravel(np.asarray(value, float))]))
    return _digest(found)


def demonstrations(task: str) -> str:
    """The digest of the shipped demonstrations."""
    return _digest([demo.digest for demo in magical_mj.demos.load(task)])


def present() -> dict[str, Any]:
    """The current fingerprints of everything that `PROTOCOL` guarantees, and of the demonstrations."""
    return {
        "scenes": {f"{task}-{variant}": scenes(task, variant) for task, variant in ENVIRONMENTS},
        "horizons": {task: horizons(task) for task in TASKS},
        "scores": {task: scores(task) for task in TASKS},
        "physics": {task: physics(task) for task in TASKS},
        "mujoco": mujoco.__version__.partition(".")[0],
        "demonstrations": {task: demonstrations(task) for task in TASKS},
    }


def golden() -> dict[str, Any]:
    """The data file: "numbers" (of protocol and demonstrations), "changes" (the reasons), and stored fingerprints."""
    return json.loads(DATA.read_text())


def main() -> None:
    """Write the file, or print the changed parts and the number that must be raised first."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--because", default="", help="the reason for the change, which is stored")
    reason = parser.parse_args().because.strip()
    old, new = golden(), present()
    numbers = {"protocol": PROTOCOL, "demonstrations": DEMONSTRATIONS}
    changed = [part for part in new if new[part] != old[part]]
    needed = {"demonstrations" if part == "demonstrations" else "protocol" for part in changed}
    sys.stdout.writelines(f"{part} changed\n" for part in changed)
    for number in sorted(needed):
        if numbers[number] == old["numbers"][number]:
            parser.exit(1, f"{number.upper()} in magical_mj/protocol.py is still {numbers[number]}: raise it first\n")
    if not reason or numbers == old["numbers"]:
        parser.exit(message="nothing was written\n")
    DATA.write_text(json.dumps({"numbers": numbers, "changes": [*old["changes"], reason], **new}, indent=1) + "\n")


def _elsewhere(rng: np.random.Generator) -> tuple[float, float, float]:
    x, y = (2 * rng.random(2) - 1).tolist()
    return x, y, 0.0


def _digest(found: Any) -> str:
    return hashlib.sha256(json.dumps(found).encode()).hexdigest()[:32]


if __name__ == "__main__":
    main()
