"""Fits the `PhysicsSettings` to recordings of the original simulation.

    python tools/research/fit_physics.py FOLDER                    # print the errors of the current settings
    python tools/research/fit_physics.py FOLDER --minutes 20       # search for better settings (needs nevergrad)

FOLDER holds `probes.npz` and `human_replays.npz`: short rollouts, and human action sequences with the poses that they
led to in the original. The loss is a sum of three terms, each about 1 for a good fit:

- probes: error divided by aim, averaged over families of rollouts, for the end of a rollout and for its mean;
- windows: the error over ten steps from a recorded state, when a human moves a block, in 0.02 units;
- starts: the error over the first 80 steps of each human sequence, in 0.05 units.

The search does not use every second probe of a family and every second human sequence. It prints the loss of both
halves, so that overfitting is visible. It prints final scores but does not optimise them: each is nearly 0 or 1, and
depends on chance.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from rollouts import (
    AIMS,
    REPLAY_AIMS,
    Array,
    Case,
    Rollouts,
    chosen,
    demo_scene,
    family_errors,
    final_score,
    recordings,
    replays,
    task_means,
)

from magical_mj.assets.contacts import SETTINGS, PhysicsSettings
from magical_mj.scene.constants import CONTROL_RATE

SPACE: Final[dict[str, tuple[float, float]]] = {
    "friction_finger_block": (0.8, 2.6),
    "friction_block": (0.15, 0.3),
    "impratio": (0.02, 2.0),
    "contact_stiffness": (400.0, 5000.0),
    "contact_damping": (0.6, 1.4),
    "finger_stiffness": (400.0, 5000.0),
    "finger_damping": (0.8, 1.5),
    "finger_overlap": (0.001, 0.006),
    "body_overlap": (0.0005, 0.004),
    "finger_armature": (0.003, 0.03),
    "loaded_share": (0.1, 0.45),
    "loaded_turn_share": (0.1, 0.5),
    "loaded_forward": (0.6, 0.8),
    "loaded_backward": (0.35, 0.6),
    "loaded_turn": (1.7, 2.5),
}
"""Setting -> the bounds of its search, on a logarithmic scale."""
SPACE_SOFT: Final[dict[str, tuple[float, float]]] = {
    "contact_impedance": (0.0005, 0.02),
    "finger_impedance": (0.001, 0.05),
    "motor_impedance": (0.02, 0.3),
}
"""The same for settings near 1. The search varies the difference from 1 between these bounds."""
WINDOW: Final = 10
TASKS_WITH_BLOCKS: Final = [task for task in REPLAY_AIMS if demo_scene(task).blocks]


def is_kept_out(name: str, cases: Mapping[str, Case]) -> bool:
    """Whether the search must not use a case, which is every second case of a family or task."""
    family = name.split("/", maxsplit=1)[0] + "/"
    return sorted(case for case in cases if case.startswith(family)).index(name) % 2 == 1


def windows(case: Case) -> list[int]:
    """The first steps of windows with a moving block, if all velocities were constant before the window."""
    poses, fingers = case["poses"].astype(float), case["fingers"].astype(float)
    bend, bent = np.abs(np.diff(poses, 2, axis=0)), np.abs(np.diff(fingers, 2, axis=0))
    found, step = [], 2
    while step + WINDOW < len(poses):
        even = bend[step - 2, :, :2].max() < 0.002 and bend[step - 2, :, 2].max() < 0.01 and bent[step - 2].max() < 0.01
        shift = (poses[step + WINDOW] - poses[step])[1:, :2]
        if even and np.hypot(shift[:, 0], shift[:, 1]).max() > 0.04:
            found.append(step)
            step += WINDOW // 2
        step += 1
    return found


def window_errors(cases: Mapping[str, Case], settings: PhysicsSettings) -> list[float]:
    """The mean error of the worst body in each window. 0.1 rad count like 0.01 units."""
    worlds = {task: Rollouts(demo_scene(task), settings) for task in TASKS_WITH_BLOCKS}
    errors = []
    for name, case in cases.items():
        task = name.split("/")[0]
        if task not in worlds:
            continue
        poses, fingers = case["poses"].astype(float), case["fingers"].astype(float)
        for at in windows(case):
            speed, bending = ((x[at] - x[at - 1]) * CONTROL_RATE for x in (poses, fingers))
            worlds[task].place(poses[at], fingers[at], speed, bending, int(case["actions"][at - 1]))
            apart = worlds[task].go(case["actions"][at : at + WINDOW].tolist())[0] - poses[at : at + WINDOW + 1]
            error = np.hypot(apart[..., 0], apart[..., 1]) + 0.1 * np.minimum(np.abs(apart[..., 2]), 1)
            errors.append(float(np.minimum(error.max(axis=1), 0.15).mean()))
    return errors


def start_errors(cases: Mapping[str, Case], settings: PhysicsSettings) -> list[float]:
    """The mean distance of the worst body in the first 80 steps of each sequence. Distances are clipped at 0.2."""
    tracks = replays(chosen(cases, lambda name: name.split("/")[0] in TASKS_WITH_BLOCKS), settings, 80)
    errors = []
    for name, track in tracks.items():
        apart = track - cases[name]["poses"][: len(track)]
        errors.append(float(np.minimum(np.hypot(apart[..., 0], apart[..., 1]).max(axis=1), 0.2).mean()))
    return errors


def terms(folder: Path, settings: PhysicsSettings, kept_out: bool) -> dict[str, float]:
    """The terms of the loss, on the half of the recordings that the search uses, or on the other half."""
    probes, sequences = (recordings(folder / name) for name in ("probes.npz", "human_replays.npz"))
    sequences = chosen(sequences, lambda name: is_kept_out(name, sequences) == kept_out)
    errors = family_errors(chosen(probes, lambda name: is_kept_out(name, probes) == kept_out), settings)
    ratios = [min(errors[family][i] / AIMS[family][i], 4.0) for family in errors for i in (0, 1)]
    return {
        "probes": float(np.mean(ratios)),
        "windows": float(np.mean(window_errors(sequences, settings))) / 0.02,
        "starts": float(np.mean(start_errors(sequences, settings))) / 0.05,
    }


def coded(settings: PhysicsSettings) -> Array:
    """The searched settings as numbers between 0 and 1."""
    values = [getattr(settings, name) for name in SPACE] + [1 - getattr(settings, name) for name in SPACE_SOFT]
    low, high = np.log([*SPACE.values(), *SPACE_SOFT.values()]).T
    return np.clip((np.log(values) - low) / (high - low), 0, 1)


def decoded(point: Array) -> PhysicsSettings:
    """The inverse of `coded`."""
    low, high = np.log([*SPACE.values(), *SPACE_SOFT.values()]).T
    values = np.exp(low + np.clip(point, 0, 1) * (high - low)).tolist()
    changes = dict(zip(SPACE, values, strict=False))
    changes |= {name: 1 - value for name, value in zip(SPACE_SOFT, values[len(SPACE) :], strict=True)}
    return dataclasses.replace(SETTINGS, **changes)


def search(folder: Path, minutes: float, seed: int) -> PhysicsSettings:
    """The best settings that CMA-ES finds, starting from the current ones."""
    try:
        import nevergrad
    except ImportError:
        sys.exit("searching needs nevergrad: pip install nevergrad")
    start = coded(SETTINGS)
    space = nevergrad.p.Array(init=start, lower=0, upper=1).set_mutation(sigma=0.06)
    space.random_state.seed(seed)
    optimiser = nevergrad.optimizers.CMA(space, budget=10**6)
    best, least, count, end = start, np.inf, 0, time.monotonic() + 60 * minutes
    while time.monotonic() < end:
        candidate = optimiser.ask()
        found = terms(folder, decoded(candidate.value), kept_out=False)
        loss = sum(found.values())
        optimiser.tell(candidate, loss if np.isfinite(loss) else 99.0)
        count += 1
        left = (end - time.monotonic()) / 60
        print(f"{count} tried, {left:.1f} minutes left ", end="\r", file=sys.stderr, flush=True)
        if loss < least:
            best, least = candidate.value, loss
            print(f"{count:5d}  {loss:.3f}  {words(found)}", flush=True)
            print("   ", json.dumps(changes_of(decoded(best))), flush=True)
    return decoded(best)


def changes_of(settings: PhysicsSettings) -> dict[str, float]:
    """The searched settings, to four digits."""
    return {name: float(f"{getattr(settings, name):.4g}") for name in (*SPACE, *SPACE_SOFT)}


def words(row: Mapping[str, float]) -> str:
    """Names and values in one line."""
    return "  ".join(f"{name} {value:.3f}" for name, value in row.items())


def report(folder: Path, settings: PhysicsSettings) -> None:
    """Prints errors and aims of the probes, scores, aims and reference scores of the tasks, and the loss terms."""
    probes, sequences = (recordings(folder / name) for name in ("probes.npz", "human_replays.npz"))
    for family, (mean, end, angle) in family_errors(probes, settings).items():
        aim = AIMS[family]
        print(
            f"{family:13s} mean {mean:.4f} (aim {aim[0]:.3f})  end {end:.4f} (aim {aim[1]:.3f})  angle {angle:.3f} rad"
        )
    ours = {name: final_score(name, track[-1]) for name, track in replays(sequences, settings).items()}
    theirs = {name: final_score(name, sequences[name]["poses"][-1].astype(float)) for name in ours}
    reference = task_means(theirs)
    for task, mean in task_means(ours).items():
        print(f"{task:13s} score {mean:.3f} (aim {REPLAY_AIMS[task]:.2f}, reference {reference[task]:.3f})")
    for kept_out in (False, True):
        print("kept out     " if kept_out else "searched     ", words(terms(folder, settings, kept_out)))


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="with probes.npz and human_replays.npz")
    parser.add_argument("--minutes", type=float, default=0.0, help="duration of the search (default: only report)")
    parser.add_argument("--seed", type=int, default=0, help="seed of the search")
    options = parser.parse_args()
    for name in ("probes.npz", "human_replays.npz"):
        if not (options.folder / name).is_file():
            parser.error(f"{options.folder} holds no {name}")
    settings = SETTINGS
    if options.minutes:
        settings = search(options.folder, options.minutes, options.seed)
        print(json.dumps(changes_of(settings), indent=1))
    report(options.folder, settings)


if __name__ == "__main__":
    main()
