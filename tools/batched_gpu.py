"""Every figure about batched worlds that needs an accelerator, part by part, each under ten minutes.

    python tools/batched_gpu.py --out out/batched            # all parts that are not done yet
    python tools/batched_gpu.py --out out/batched --only speed-FixColour-Demo

A part that is done has a file in the folder and is skipped: start the script again after an interruption.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import magical_mj

LIMIT: Final = 600  # seconds for one part
ROOT: Final = Path(__file__).parent.parent


def parts(device: str) -> Mapping[str, list[str]]:
    """By name, the command of each part."""
    python = [sys.executable]
    fidelity = [*python, str(ROOT / "research" / "batched_fidelity.py")]
    bench = [*python, "-m", "magical_mj", "bench", "--batched", "--device", device, "--presets", "State,LoRes4E"]
    made = {
        "fidelity-actions": [*fidelity, "actions", "--device", device],
        "fidelity-replays": [*fidelity, "replays", "--device", device],
    }
    for task in magical_mj.TASKS:
        for variant in ("Demo", "All"):
            made[f"speed-{task}-{variant}"] = [*bench, "--tasks", task, "--variants", variant]
    return made


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--only", help="the name of one part")
    chosen = parser.parse_args()
    chosen.out.mkdir(parents=True, exist_ok=True)
    every = parts(chosen.device)
    if chosen.only and chosen.only not in every:
        parser.error(f"there is no part {chosen.only}; there are {', '.join(every)}")
    for name in [chosen.only] if chosen.only else every:
        done = chosen.out / f"{name}.txt"
        if done.exists():
            print(f"{name}: done", flush=True)
            continue
        start, partial = time.perf_counter(), done.with_suffix(".partial")
        with partial.open("w") as file:
            try:
                code = subprocess.run(
                    every[name], stdout=file, stderr=subprocess.STDOUT, timeout=LIMIT, check=False
                ).returncode
            except subprocess.TimeoutExpired:
                code = -1
        if code == 0:
            partial.rename(done)
        print(
            f"{name}: {'done' if code == 0 else f'failed, see {partial}'}, {time.perf_counter() - start:.0f} s",
            flush=True,
        )


if __name__ == "__main__":
    main()
