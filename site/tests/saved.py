"""Tests that a recording saved by the browser can be imported, verified, exported and used for training.

Usage: saved.py RECORDING, the file that play.test.mjs wrote. Needs the extras cli, minari and il.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path


def main(recording: Path, folder: Path) -> None:
    """Raises an error if one of the steps fails."""
    _run("demos", "import", str(recording), "--out", str(folder / "mine"))
    _run("demos", "verify", str(folder / "mine"))
    os.environ["MINARI_DATASETS_PATH"] = str(folder / "minari")
    _run("demos", "export", str(folder / "mine"), "--to", "minari", "--out", "magical-mj/browser/test-v0")

    import minari

    import magical_mj
    from magical_mj.learners import load_settings
    from magical_mj.learners.bc import clone

    (path,) = (folder / "mine").iterdir()
    demo = magical_mj.demos.read(path)
    (episode,) = minari.load_dataset("magical-mj/browser/test-v0").iterate_episodes()
    if episode.actions.tolist() != demo.actions.tolist():
        raise SystemExit("the Minari data set holds other actions")
    few = {"bc.batches": 20, "demonstrations": 1, "preset": "State"}
    policy = clone(load_settings("bc", demo.task, **few), {demo.task: [demo]})
    scores = magical_mj.evaluate(policy, tasks=demo.task, variants=demo.variant, preset="State", episodes=1)
    print(f"{path.name}: verified, exported to Minari, learnt from; the policy scored {scores['score'].mean():.2f}")


def _run(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "magical_mj", *arguments], check=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1]), Path(temporary))
