"""Tests that a recording saved by the browser can be imported, verified, exported and used for training.

Usage: saved.py FOLDER, with the files of play.test.mjs and puzzles.test.mjs. Needs the extras cli, minari and il.
"""

from __future__ import annotations

import json
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


def check_puzzle(path: Path) -> None:
    """Raises an error unless Python judges a played puzzle as the page did."""
    import magical_mj
    from magical_mj.web.puzzles import puzzle_of

    played = json.loads(path.read_text(encoding="utf-8"))
    saved = played["saved"]
    puzzle = puzzle_of(saved["task"])
    initial = magical_mj.sample_scene(puzzle.task, saved["variant"], saved["seed"])
    final = initial.moved(saved["final"]["robot"], saved["final"]["blocks"])
    score, reached = puzzle.intent.score(initial, final), puzzle.reached_instead(initial, final)
    words = f"What you did instead: {reached.sentence}" if reached else "That is not what you did."
    words = "That is what you did." if score == 1.0 else words
    if (f"{score:.2f}", words) != (f"{played['score']:.2f}", played["words"]):
        raise SystemExit(f"{path.name}: the page says {played['score']}, {played['words']}; Python {score}, {words}")
    print(f"{path.name}: {score:.2f}. {words}")


def _run(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "magical_mj", *arguments], check=True)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        main(Path(sys.argv[1]) / "saved.json", Path(temporary))
    check_puzzle(Path(sys.argv[1]) / "puzzle.json")
