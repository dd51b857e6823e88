"""Puts what a person uploads to the Hugging Face Hub into one folder: data sets, policies and LeRobot's environment.

    python -m tools.publish --out out/publish [--tasks all] [--preset LoRes4E]
    python -m tools.publish --out out/publish --rehearse      # uploads to a local test server, see tools/hub.py

Each folder in OUT/datasets and OUT/models becomes a repository, and has its card. CONTRIBUTING.md lists the commands.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tempfile
from pathlib import Path
from typing import Final

import magical_mj
from magical_mj.demos.shipped import DemonstrationSet
from magical_mj.exports.folders import to_webdataset
from magical_mj.tasks.registry import listed_tasks
from tools.hub import rehearse

ROOT: Final = Path(__file__).parent.parent
SETS: Final[dict[str, DemonstrationSet]] = {"expert": 1, "diverse": 2, "graded": "graded"}
CARD: Final = """---
license: apache-2.0
tags: [imitation-learning, mujoco, onnx, robotics]
---
# Behavioural cloning from states, for MAGICAL on MuJoCo

A policy for each task, which behavioural cloning learnt from the states in the 25 shipped demonstrations: from the last
four state vectors, float32 (n, 4, {names}), to a value for each of the 18 actions, (n, 18).

```console
$ magical-mj evaluate --policy FindDupe.onnx --tasks FindDupe --preset State --out scores
```

Mean scores of 100 episodes, in the scene of the demonstrations and in new poses:

| Task | Demo | Layout |
| --- | ---: | ---: |
{rows}
"""


def prepare(out: Path, tasks: str, preset: str) -> None:
    """Writes all folders. `out` must not exist; it appears when it is whole."""
    if out.exists():
        raise FileExistsError(f"{out} exists: give another --out, or remove it")
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=out.parent) as temporary:
        made = Path(temporary) / "made"
        for task in listed_tasks(tasks):
            for name, chosen in SETS.items():
                print(f"{task}, {name}", flush=True)
                demos = magical_mj.demos.load(task, set=chosen)
                to_webdataset(demos, made / "datasets" / f"magical-mj-{task}-{name}", preset)
        policies = made / "models" / "magical-mj-bc-states"
        shutil.copytree(ROOT / "site" / "policies", policies)
        scores = json.loads((policies / "scores.json").read_text("utf-8"))
        rows = [f"| {task} | {means['Demo']:.2f} | {means.get('Layout', '-')} |" for task, means in scores.items()]
        card = CARD.format(names=len(magical_mj.observations.STATE_NAMES), rows="\n".join(rows))
        (policies / "README.md").write_text(card, "utf-8")
        shutil.copytree(ROOT / "hub" / "lerobot", made / "models" / "magical-mj-lerobot")
        made.rename(out)


def main() -> None:
    """Prepares the folders, or rehearses their upload."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/publish"))
    parser.add_argument("--tasks", default="all")
    parser.add_argument("--preset", default="LoRes4E", help="the observations of the data sets")
    parser.add_argument("--rehearse", action="store_true", help="upload what was prepared to a local test server")
    options = parser.parse_args()
    if not options.rehearse:
        prepare(options.out, options.tasks, options.preset)
        return
    for folder in sorted(options.out.glob("*/*")):
        kind = folder.parent.name.removesuffix("s")  # dataset or model
        with tempfile.TemporaryDirectory() as arrived:
            print(f"{folder}: {rehearse(folder, kind, Path(arrived) / 'hub')} files have arrived", flush=True)


if __name__ == "__main__":
    main()
