"""Writes the page for playing all environments in the browser without a server: out/site/play."""

from __future__ import annotations

import gzip
import hashlib
import json
import re
import shutil
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, Final

import mujoco
import shifted
from fetch import CACHE, ONNX_FILES, ONNX_RUNTIME
from shifted import CHANGED, SUITE
from standings_page import write_replays

import magical_mj
from magical_mj.engine.export import mjcf_text
from magical_mj.web.asking import ASKED, asked, question_data
from magical_mj.web.grammar import grammar_data, rival_texts, start_scenes
from magical_mj.web.npm import fetched, library_files
from magical_mj.web.page_data import PAGE, catalogue, environment_scenes, sample_models
from magical_mj.web.puzzles import VARIANTS, puzzle_scenes, puzzles
from tools.scores import own_methods

POLICIES: Final = Path(__file__).parent / "policies"
OFFLINE: Final = Path(__file__).parent / "offline"
LATER: Final = ("onnx", "policies", "puzzles", "replays", "shifted")
"""The folders with files that are stored for offline visits only after their first use."""
LISTS: Final = ("policies/scores.json", "replays/index.json")
"""The files in these folders that the page needs to start."""
FOLDER: Final = Path(__file__).parent.parent / "out" / "site" / "play"
KEPT: Final = Path(__file__).parent.parent / "out" / "scenes"
"""The scenes of the last build."""
BETWEEN_ELEMENTS: Final = re.compile(r"(?<=>)(?=\s*<)")


def write_play(folder: Path) -> int:
    """Writes the page, its scenes and MuJoCo's WebAssembly build into an empty folder. Returns the number of bytes."""
    if folder.exists():
        shutil.rmtree(folder)
    shutil.copytree(PAGE, folder, ignore=shutil.ignore_patterns("operator.*"))  # these need a study's server
    shutil.copytree(_scenes(), folder, dirs_exist_ok=True)
    write_replays(own_methods(), folder / "replays")
    pairs = (*magical_mj.ENVIRONMENTS, *SUITE)
    drawn = [pair for puzzle in puzzles() for pair in puzzle.environments]
    known = catalogue(pairs, "browser", {pair: shifted.offered(*pair) for pair in pairs}, drawn)
    _write(folder / "catalogue.json", known | {"exclusive": shifted.EXCLUSIVE, "questions": ASKED})
    _write(folder / "intents.json", grammar_data())
    _write(folder / "starts.json", start_scenes())
    _write(folder / "rivals.json", rival_texts())
    libraries = library_files(CACHE)
    samples = {f"samples/{name}.xml": text.encode() for name, text in sample_models().items()}
    for name, content in (libraries | samples).items():
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
    shutil.copytree(POLICIES, folder / "policies")
    (folder / "onnx").mkdir()
    for name, original in ONNX_FILES.items():  # the page loads them with the first policy
        shutil.copy(fetched(ONNX_RUNTIME, CACHE) / "dist" / original, folder / "onnx" / name)
    size = len(libraries["mujoco/mujoco.wasm"])  # for the progress, since compressed downloads do not contain it
    register = '<script type="module" src="register.js" data-optional></script>\n</head>'
    packed = {name: len(gzip.compress(content)) for name, content in libraries.items()}
    for name, part in {"index.html": "mujoco/", "inspect.html": ""}.items():
        path, download = folder / name, sum(packed[one] for one in packed if one.startswith(part)) / 1e6
        root = f'<html lang="en" data-wasm="{size}" data-download="{download:.1f} MB">'
        text = path.read_text(encoding="utf-8").replace('<html lang="en">', root)
        path.write_text(text.replace("</head>", register), encoding="utf-8")
    shutil.copy(OFFLINE / "register.js", folder)
    (folder / "worker.js").write_text(_worker(folder), encoding="utf-8")
    return sum(path.stat().st_size for path in folder.rglob("*"))


def _scenes() -> Path:
    """The folder with everything that `write_scenes` writes. It is made again after a change of code or data."""
    package = Path(magical_mj.__file__).parent
    files = sorted(path for path in package.rglob("*") if path.is_file() and not path.is_relative_to(PAGE))
    files = [path for path in files if path.suffix != ".pyc"] + [Path(__file__), Path(shifted.__file__)]
    content = b"".join(hashlib.sha256(path.read_bytes()).digest() for path in files)
    folder = KEPT / hashlib.sha256(mujoco.__version__.encode() + content).hexdigest()[:16]
    if not folder.exists():
        shutil.rmtree(KEPT, ignore_errors=True)
        unfinished = KEPT / "unfinished"
        write_scenes(unfinished)
        unfinished.rename(folder)
    return folder


def write_scenes(folder: Path) -> None:
    """Writes the scenes of all environments, with and without shifts, of the puzzles and of the questions."""
    for task, variant in magical_mj.ENVIRONMENTS:
        data = environment_scenes(task, variant)
        _write(folder / "scenes" / f"{task}-{variant}.json", with_models(data, models_of(task, variant, data)))
    for pair in SUITE:
        _write(folder / "scenes" / f"{'-'.join(pair)}.json", with_models(*shifted.scenes(*pair, [""])))
    for pair in (*magical_mj.ENVIRONMENTS, *SUITE):
        for axis, levels in shifted.offered(*pair).items():
            if axis not in CHANGED:
                data, models = shifted.scenes(*pair, [f"{axis}:{level}" for level in levels])
                _write(folder / "shifted" / f"{'-'.join((*pair, axis))}.json", with_models(data, models))
        if pair not in SUITE:
            _write(folder / "shifted" / f"{'-'.join(pair)}.json", shifted.changes(*pair))
    write_puzzles(folder / "puzzles")
    _write(folder / "questions.json", [question_data(question, answers=True) for question in asked()])


def write_puzzles(folder: Path) -> None:
    """Writes the scenes of the puzzles."""
    for puzzle in puzzles():
        for variant in VARIANTS:
            data = puzzle_scenes(puzzle, variant)
            path = folder / f"{puzzle.name}-{variant}.json"
            _write(path, with_models(data, models_of(puzzle.task, variant, data)))


def models_of(task: str, variant: str, data: Mapping[str, Any]) -> list[str]:
    """The models of the scenes of an environment."""
    found = []
    with closing(magical_mj.Engine(task, variant, seed=0)) as engine:
        for entry in data["scenes"]:
            engine.reset(seed=entry["seed"])
            found.append(mjcf_text(engine, rounded=False))
    return found


def _worker(folder: Path) -> str:
    """The service worker. It stores the files for playing and all scenes, under a hash of all files."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    everything = hashlib.sha256(b"".join(hashlib.sha256(path.read_bytes()).digest() for path in files)).hexdigest()
    names = [path.relative_to(folder).as_posix() for path in files]
    kept = [name for name in names if name.partition("/")[0] not in LATER or name in LISTS]
    kept.remove("index.html")  # it is stored as "./"
    text = (OFFLINE / "worker.js").read_text(encoding="utf-8")
    return text.replace("@HASH@", everything[:16]).replace("@FILES@", " ".join(["./", *kept]))


def with_models(data: dict[str, Any], models: Sequence[str]) -> dict[str, Any]:
    """The same data with a model of each scene, compressed to a quarter of the size or less.

    Models share most of their XML elements. So each model is stored as indices into a common list of elements.
    """
    numbers: dict[str, int] = {}
    scenes = [
        {**scene, "mjcf": [numbers.setdefault(element, len(numbers)) for element in BETWEEN_ELEMENTS.split(model)]}
        for scene, model in zip(data["scenes"], models, strict=True)
    ]
    return {**data, "scenes": scenes, "elements": list(numbers)}


def _write(path: Path, data: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, separators=(",", ":")), encoding="utf-8")


if __name__ == "__main__":
    print(f"{FOLDER}: {write_play(FOLDER) / 1e6:.1f} MB")
