"""Measures all figures about batched environments that need an accelerator, in parts of less than ten minutes.

    python tools/batched_gpu.py --list                       # the names of all parts
    python tools/batched_gpu.py --out out/batched            # all parts that are not finished
    python tools/batched_gpu.py --out out/batched --only speed-FixColour-Demo-State
    python tools/batched_gpu.py --out out/rehearsal --rehearse --device cpu

A finished part has a file with its output in the folder, and is skipped. So after an interruption, start the script
again. Each part is stopped after ten minutes: trainings and evaluations continue when the script is started again; any
other part has failed. If a part fails, the others still run, and the exit code is 1.

The machine needs Python 3.11 to 3.13, this repository, an NVIDIA driver that PyTorch's build for CUDA supports, and
the extras `gpu` and `eval`. The largest wheels are PyTorch for CUDA (for Linux, the one on PyPI) with NVIDIA's
libraries, some gigabytes, and warp-lang, 143 MiB. Demonstrations and official episodes are drawn with OpenGL: EGL of
the driver, or OSMesa (`MUJOCO_GL=osmesa`). If the machine cannot reach a package index, collect the wheels on another
machine with the same platform and Python version, and install them from the folder:

    pip wheel --wheel-dir wheels --constraint constraints.txt ".[gpu,eval]"
    pip install --no-index --find-links wheels "magical-mj[gpu,eval]"

Warp compiles its kernels for the card at first use, which takes a minute or two, and caches them in `~/.cache/warp`.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Final

import magical_mj

LIMIT: Final = 570  # seconds for one part
ROOT: Final = Path(__file__).parent.parent
COMMAND: Final = [sys.executable, "-m", "magical_mj"]
FROM_HERE: Final = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))}
"""The environment variables of the commands. `tools.benchmarks` can be imported from any folder."""
FIDELITY: Final = [sys.executable, str(ROOT / "tools" / "research" / "batched_fidelity.py")]


TRAININGS: Final[Mapping[str, tuple[str, ...]]] = {
    "gail-quick": ("ppo.total_steps=1000000", "ppo.environments=256"),
    "gail-paper": (),
}
"""Training -> the settings that differ from the default."""
REHEARSED: Final[Mapping[str, tuple[str, ...]]] = {
    "gail-quick": ("ppo.total_steps=8", "ppo.environments=2", "ppo.steps=2", "ppo.minibatch=4", "demonstrations=1")
}


def parts(device: str, out: Path, *, rehearse: bool) -> Mapping[str, list[str]]:
    """Name -> the command of the part. If it is rehearsed, it does as little as possible."""
    on = ["--device", device]
    tasks = ("MoveToRegion",) if rehearse else magical_mj.TASKS
    environments = list(product(tasks, ("Demo",) if rehearse else ("Demo", "All")))
    states, replays, episodes = ("2", "1", "1") if rehearse else ("200", "25", "100")
    commands = {
        "fidelity-actions": [*FIDELITY, "actions", *on, "--states", states],
        "fidelity-replays": [*FIDELITY, "replays", *on, "--count", replays, "--tasks", ",".join(tasks)],
    }
    for (task, variant), preset in product(environments, ("LoRes4E",) if rehearse else ("State", "LoRes4E")):
        options = ["--tasks", task, "--variants", variant, "--presets", preset]
        options += ["--num-envs", "2" if rehearse else "256,1024,4096,16384"]
        commands[f"speed-{task}-{variant}-{preset}"] = [
            sys.executable,
            "-m",
            "tools.benchmarks",
            "--batched",
            *on,
            *options,
        ]
    environment = ["--tasks", "MoveToRegion", "--preset", "LoRes4E"]
    for name, settings in (REHEARSED if rehearse else TRAININGS).items():
        run, scores = str(out / name), str(out / f"{name}-scores")
        changes = [word for setting in ("evaluations=0", *settings) for word in ("--set", setting)]
        quick = ["--quick"] if "quick" in name else []
        options = [*environment, "--simulator", "warp", *on, *quick, *changes, "--out", run]
        commands[name] = [*COMMAND, "train", "gail", *options, "--resume"]
        played = ["--policy", run, *environment, "--variants", "Demo", "--episodes", episodes]
        commands[f"{name}-score"] = [*COMMAND, "evaluate", *played, "--out", scores, "--resume"]
    return commands


def run(command: list[str], done: Path) -> str:
    """Runs the command of a part and returns how it ended, in words. If it succeeds, its output is in `done`."""
    partial = done.with_suffix(".partial")
    with partial.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, process_group=0, env=FROM_HERE)
        try:
            code = process.wait(LIMIT)
        except subprocess.TimeoutExpired:
            if "--resume" in command:
                return f"stopped, see {partial}; start the script again to continue it"
            return f"failed: not finished after {LIMIT} s, see {partial}"
        finally:
            with suppress(ProcessLookupError):  # all processes have ended already
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code:
        return f"failed, see {partial}"
    partial.rename(done)
    return "done"


def main() -> int:
    """Runs the command line. Returns 1 if a part has failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="default: out/batched, or out/rehearsal")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--only", help="the name of one part")
    parser.add_argument("--rehearse", action="store_true", help="do as little as possible in each part")
    parser.add_argument("--list", action="store_true", help="print the names of all parts")
    chosen = parser.parse_args()
    chosen.out = chosen.out or Path("out/rehearsal" if chosen.rehearse else "out/batched")
    every = parts(chosen.device, chosen.out, rehearse=chosen.rehearse)
    if chosen.list:
        print("\n".join(every))
        return 0
    if chosen.only and chosen.only not in every:
        parser.error(f"unknown part {chosen.only}; the parts are {', '.join(every)}")
    chosen.out.mkdir(parents=True, exist_ok=True)
    status = 0
    for name in [chosen.only] if chosen.only else every:
        done, start = chosen.out / f"{name}.txt", time.perf_counter()
        training = name.removesuffix("-score")
        if training != name and not (chosen.out / f"{training}.txt").exists():
            print(f"{name}: skipped, because {training} is not finished", flush=True)
            continue
        ended = "done before" if done.exists() else run(every[name], done)
        print(f"{name}: {ended}, {time.perf_counter() - start:.0f} s", flush=True)
        status |= ended.startswith("failed")
    return status


if __name__ == "__main__":
    sys.exit(main())
