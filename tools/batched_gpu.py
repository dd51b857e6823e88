"""Measures all figures about batched environments that need an accelerator, for at most twelve minutes at a time.

    python tools/batched_gpu.py --list                       # all parts, and about how long each takes on an H100
    python tools/batched_gpu.py --out out/batched            # all parts that are not finished
    python tools/batched_gpu.py --out out/batched --seconds 540 --only speed-MoveToRegion-Demo-State
    python tools/batched_gpu.py --out out/rehearsal --rehearse --device cpu

A finished part has a file with its output in the folder, and is skipped. So when the time is over, or after an
interruption, start the script again: trainings and evaluations continue, and any other part that was stopped starts
again; it is only started if there is about as much time as it needs. If a part fails, the others still run, and the
exit code is 1. The first parts are the comparison of pictures with the software renderer's, then the speed, with the
time of each kernel, PyTorch's profile of whole steps, and the memory of an environment. The part `bc`, behavioural
cloning at the paper's full size (tools/full_size/accelerator.sh), takes all the time that is left, in each call until
it has ended; `--only` runs one of the parts after it. A rehearsal does as little as possible, also of that part, and
draws with numba-cuda's simulator as well.

The machine needs Python 3.11 to 3.13, this repository, an NVIDIA driver that PyTorch's build for CUDA supports, and
the extras `gpu` and `eval`. The largest wheels are PyTorch for CUDA (for Linux, the one on PyPI) with NVIDIA's
libraries, some gigabytes, and warp-lang, 143 MiB. Demonstrations and official episodes are drawn with OpenGL: EGL of
the driver, or OSMesa (`MUJOCO_GL=osmesa`). If the machine cannot reach a package index, collect the wheels on another
machine with the same platform and Python version, and install them from the folder:

    pip wheel --wheel-dir wheels --constraint constraints.txt ".[gpu,eval]"
    pip install --no-index --find-links wheels "magical-mj[gpu,eval]"

Warp compiles its kernels for the card at first use, which takes a minute or two, and caches them in `~/.cache/warp`.
numba-cuda compiles the pictures' kernel in some seconds, in each process.
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

SECONDS: Final = 690  # for all parts of a call
TO_END: Final = 20  # seconds that a part needs more to end
SECONDS_LEFT: Final = "SECONDS"
ROOT: Final = Path(__file__).parent.parent
COMMAND: Final = [sys.executable, "-m", "magical_mj"]
FROM_HERE: Final = os.environ | {
    "PYTHONPATH": os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH")))),
    "PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")]),
}
"""The environment variables of the commands: they find `tools.benchmarks` and `magical-mj` from any folder."""
FIDELITY: Final = [sys.executable, str(ROOT / "tools" / "research" / "batched_fidelity.py")]
PICTURES: Final = [sys.executable, str(ROOT / "tools" / "batched_pictures.py")]
BENCHMARK: Final = [sys.executable, "-m", "tools.benchmarks", "--batched"]
FULL_SIZE: Final = ROOT / "tools" / "full_size" / "accelerator.sh"
PRINTED: Final = ("pictures", "speed", "fidelity")
"""The beginnings of the names of parts whose output is printed."""
NEEDED: Final[Mapping[str, int]] = {
    "pictures": 40,
    "pictures-shifted": 60,
    "speed-MoveToRegion-Demo-State": 120,  # Warp compiles
    "speed-MoveToRegion-Demo-LoRes4E": 50,
    "speed-ClusterShape-All-State": 130,
    "speed-ClusterShape-All-LoRes4E": 170,
}
"""About how many seconds parts take on an H100. Other parts continue where they stopped, or are short."""
MEASURED: Final = (("MoveToRegion", "Demo"), ("ClusterShape", "All"))


TRAININGS: Final[Mapping[str, tuple[str, ...]]] = {
    "gail-quick": ("ppo.total_steps=1000000", "ppo.environments=256"),
    "gail-paper": (),
}
"""Training -> the settings that differ from the default."""
REHEARSED: Final[Mapping[str, tuple[str, ...]]] = {
    "gail-quick": ("ppo.total_steps=8", "ppo.environments=2", "ppo.steps=2", "ppo.minibatch=4", "demonstrations=1")
}


def parts(device: str, out: Path, *, rehearse: bool) -> Mapping[str, list[str]]:
    """Name -> the command of the part, in order. If it is rehearsed, it does as little as possible.

    The word `SECONDS_LEFT` in a command is replaced by the number of seconds left.
    """
    on = ["--device", device]
    tasks = ("MoveToRegion",) if rehearse else magical_mj.TASKS
    states, replays, episodes = ("2", "1", "1") if rehearse else ("200", "25", "100")
    commands: dict[str, list[str]] = {}
    for size, shifts in (("96", ""), ("64", "camera:3,light:3,texture:3,palette:3,sensor:3")):
        name = "pictures-shifted" if shifts else "pictures"
        drawn = ["--scenes", "4" if rehearse else "1000", "--shifts", shifts]
        commands[name] = [*PICTURES, *on, *drawn, "--size", size]
        if rehearse:
            commands[f"{name}-simulated"] = [*PICTURES, *drawn, "--size", "16"]
    for (task, variant), preset in product(MEASURED[:1] if rehearse else MEASURED, ("State", "LoRes4E")):
        options = ["--tasks", task, "--variants", variant, "--presets", preset, "--profile"]
        options += ["--num-envs", "2" if rehearse else "4096,256,1024,16384"]
        commands[f"speed-{task}-{variant}-{preset}"] = [*BENCHMARK, *on, *options]
    trained = ["60", "1"] if rehearse else [SECONDS_LEFT, "12"]
    commands["bc"] = [str(FULL_SIZE), *trained, str(out / "full_size")]
    commands["fidelity-actions"] = [*FIDELITY, "actions", *on, "--states", states]
    commands["fidelity-replays"] = [*FIDELITY, "replays", *on, "--count", replays, "--tasks", ",".join(tasks)]
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


def run(command: list[str], done: Path, seconds: float) -> str:
    """Runs a part for at most `seconds`, and returns how it ended. If it succeeds, its output is in `done`."""
    partial, goes_on = done.with_suffix(".partial"), SECONDS_LEFT in command
    command = [str(int(seconds)) if word == SECONDS_LEFT else word for word in command]
    partial.unlink(missing_ok=True)  # if this script was killed, the part may still write there
    with partial.open("w") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, process_group=0, env=FROM_HERE)
        try:
            code = process.wait(seconds + TO_END)
        except subprocess.TimeoutExpired:
            return f"stopped, see {partial}; start the script again"
        finally:
            with suppress(ProcessLookupError):  # all processes have ended already
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if code:
        return f"failed, see {partial}"
    if goes_on:
        return f"ended with the time, see {partial}"
    partial.rename(done)
    return "done"


def main() -> int:
    """Runs the command line. Returns 1 if a part has failed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, help="default: out/batched, or out/rehearsal")
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--seconds", type=float, default=SECONDS, help="the time for all parts")
    parser.add_argument("--only", help="the name of one part")
    parser.add_argument("--rehearse", action="store_true", help="do as little as possible in each part")
    parser.add_argument("--list", action="store_true", help="print the names of all parts")
    chosen = parser.parse_args()
    chosen.out = chosen.out or Path("out/rehearsal" if chosen.rehearse else "out/batched")
    every = parts(chosen.device, chosen.out, rehearse=chosen.rehearse)
    if chosen.list:
        print("\n".join(f"{name}: {NEEDED[name]} s" if name in NEEDED else name for name in every))
        return 0
    if chosen.only and chosen.only not in every:
        parser.error(f"unknown part {chosen.only}; the parts are {', '.join(every)}")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # which also ends the running part
    chosen.out.mkdir(parents=True, exist_ok=True)
    status, end = 0, time.monotonic() + chosen.seconds
    for name in [chosen.only] if chosen.only else every:
        done, start = chosen.out / f"{name}.txt", time.monotonic()
        needed = 0 if chosen.rehearse else NEEDED.get(name, 0)
        if not done.exists() and start + needed >= end:
            print(f"{name}: not started, it needs {needed} s of {max(0, end - start):.0f} s", flush=True)
            continue
        training = name.removesuffix("-score")
        if training != name and not (chosen.out / f"{training}.txt").exists():
            print(f"{name}: skipped, because {training} is not finished", flush=True)
            continue
        ended = "done before" if done.exists() else run(every[name], done, end - start)
        print(f"{name}: {ended}, {time.monotonic() - start:.0f} s", flush=True)
        if done.exists() and name.startswith(PRINTED):
            print(done.read_text(), flush=True)
        status |= ended.startswith("failed")
    return status


if __name__ == "__main__":
    sys.exit(main())
