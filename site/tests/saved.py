"""Tests what the browser saved: a recording can be used in all ways, and an edited scene is the same one in Python.

Usage: saved.py FOLDER, in which play.test.mjs, editor.test.mjs and puzzles.test.mjs wrote.
Needs the extras cli, minari and il.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlparse

import mujoco
import numpy as np

from magical_mj import Block, Engine, Scene
from magical_mj.engine.export import mjcf_text

STEPS: Final = 200
CLOSE: Final = 1e-9


def compare_scene(edited: Path) -> None:
    """Raises an error unless the saved scene, model and link are one scene, and Python's scenes came back the same."""
    saved = json.loads(edited.read_text())
    scene = Scene.from_json(saved["scene"])
    model = mujoco.MjModel.from_xml_string(saved["model"])
    text = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_TEXT, "scene")
    custom = model.text_data[model.text_adr[text] :].decode().partition("\0")[0]
    (linked,) = parse_qs(urlparse(saved["link"]).fragment.partition("?")[2])["scene"]
    pairs = [(scene, Scene.from_json(custom)), (scene, Scene.from_json(linked))]
    pairs += [(Scene.from_json(text), Scene.from_json(returned)) for text, returned in saved["returned"]]
    for one, other in pairs:
        if one != other or one.digest() != other.digest():
            raise SystemExit(f"{one} came back as {other}")
    if scene.blocks != tuple(Block(**block) for block in saved["blocks"]):
        raise SystemExit(f"the browser's blocks are {saved['blocks']}, Python's {scene.blocks}")
    ours = mujoco.MjModel.from_xml_string(mjcf_text(Engine("MatchRegions", scene=scene), rounded=False))
    ends = []
    for one in (model, ours):
        data = mujoco.MjData(one)
        mujoco.mj_resetDataKeyframe(one, data, 0)
        data.ctrl[:] = one.numeric("controls").data.reshape(18, -1)[1]
        for _ in range(STEPS):
            mujoco.mj_step(one, data)
        ends.append(data.qpos.copy())
    difference = float(np.abs(ends[0] - ends[1]).max())
    if difference > CLOSE:
        raise SystemExit(f"after {STEPS} steps the poses differ by {difference}")
    print(f"{len(pairs) - 2} scenes came back; the edited one moves as in Python, up to {difference:.0e}")


def use_recording(recording: Path, folder: Path) -> None:
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
        compare_scene(Path(sys.argv[1]) / "edited.json")
        use_recording(Path(sys.argv[1]) / "saved.json", Path(temporary))
    check_puzzle(Path(sys.argv[1]) / "puzzle.json")
