"""Damaged files for every command that reads them, and invalid command lines."""

from __future__ import annotations

import contextlib
import io
import json
import lzma
import random
import shutil
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from values import TEXTS, FindError, json_value, spoilt_bytes, spoilt_tree

import magical_mj
from magical_mj.cli import main
from magical_mj.demos.demonstration import ARRAYS, _digest
from magical_mj.protocol import PROTOCOL
from magical_mj.utils.errors import MagicalError

CARD: Final = 'method = "x"\nauthors = ["somebody"]\n[training]\nhours = 1\n'
EXPERIMENT: Final = (
    'methods = ["bc"]\ntasks = "MoveToRegion"\nseeds = [0, 1]\n[settings]\npreset = "State"\nbc.batches = 2\n'
)
TRAIN: Final = (
    *("train", "bc", "--tasks", "MoveToRegion", "--preset", "State", "--out", "run", "--set", "bc.batches=4"),
    *("--set", "network.hidden=8", "--set", "network.entity=8", "--set", "evaluations=0", "--set", "demonstrations=2"),
    *("--set", "checkpoints=2", "--device", "cpu", "--resume"),
)
EVALUATE: Final = ("evaluate", "--policy", "noop", "--tasks", "MoveToRegion", "--variants", "Demo,Layout")
SHORT: Final = (*EVALUATE, "--episodes", "2", "--jobs", "1", "--out", "scores", "--resume")
READERS: Final[dict[str, tuple[tuple[str, ...], ...]]] = {
    "scores/scores.jsonl": (
        *(
            ("report", "scores", "--out", "report"),
            ("compare", "scores", "scores"),
            ("verify", "scores", "--jobs", "1"),
        ),
        *(("submit", "scores", "--out", "new.json.xz"), SHORT),
    ),
    "scores/run.json": (SHORT, ("verify", "scores", "--jobs", "1"), ("submit", "scores", "--out", "new.json.xz")),
    "entries/a.json.xz": (("leaderboard", "entries", "--out", "page", "--jobs", "1", "--all"),),
    "demos/MoveToRegion-Demo-000.npz": (
        *(("demos", "verify", "demos", "--jobs", "1"), ("demos", "info", "demos")),
        ("demos", "export", "demos", "--preset", "State", "--out", "out.npz"),
        ("demos", "video", "demos", "--size", "16", "--speed", "50", "--out", "out.mp4"),
        ("demos", "generate", "--tasks", "MoveToRegion", "--count", "1", "--out", "demos", "--jobs", "1"),
    ),
    "played.json": (("demos", "import", "played.json", "--out", "mine"),),
    "card.toml": (("submit", "scores", "--card", "card.toml", "--out", "new.json.xz"),),
    "run/config.toml": (TRAIN, (*EVALUATE[:2], "run", *EVALUATE[3:], "--episodes", "1", "--jobs", "1", "--out", "o")),
    "run/checkpoint.safetensors": (TRAIN,),
    "run/metrics.csv": (TRAIN,),
    "run/policy.safetensors": (
        (*EVALUATE[:2], "run", *EVALUATE[3:], "--episodes", "1", "--preset", "State", "--jobs", "1", "--out", "o"),
    ),
    "experiment.toml": (("experiment", "experiment.toml", "--out", "runs"),),
}
GROWS: Final = ("scores/scores.jsonl",)
SETTINGS: Final = "scores/run.json"
"""A file that a resumed evaluation rewrites if it plays more."""
COMMANDS: Final[tuple[tuple[str, ...], ...]] = (
    *(("list", "--ids"), ("view", "FindDupe", "All", "--seed", "3", "--size", "32", "--out", "a.png")),
    ("rollout", "MoveToRegion", "Demo", "--policy", "random", "--episodes", "1", "--preset", "State", "--seed", "1"),
    ("export", "FindDupe", "All", "--seed", "1", "--out", "models"),
    ("demos", "generate", "--tasks", "MoveToRegion", "--variants", "Demo", "--count", "1", "--out", "d", "--jobs", "1"),
    ("demos", "export", "--tasks", "MoveToRegion", "--to", "npz", "--preset", "State", "--out", "x.npz"),
    ("play", "MoveToRegion", "Demo", "--seed", "1", "--record", "mine", "--size", "32", "--web"),
    ("train", "bc", "--tasks", "MoveToRegion", "--preset", "State", "--out", "r", "--set", "bc.batches=1"),
    *(SHORT, *(command for readers in READERS.values() for command in readers)),
)
SLOW: Final = ("all", "1e9", "None")
"""Words that would be legal, but take hours."""


@cache
def stock(folder: Path) -> Path:
    """A folder with a valid file of each kind."""
    stock = folder / "stock"
    if stock.exists():
        return stock
    shutil.rmtree(folder / "making", ignore_errors=True)  # left by a process that crashed
    with contextlib.chdir(_folder(folder / "making")), contextlib.redirect_stdout(io.StringIO()):
        for name in ("demos", "entries"):
            _folder(Path(name))
        demo = magical_mj.demos.load("MoveToRegion")[0]
        magical_mj.demos.write(demo, "demos/MoveToRegion-Demo-000.npz")
        played = {"format": 1, "protocol": PROTOCOL, "task": "MoveToRegion", "variant": "Demo", "seed": 0}
        Path("played.json").write_text(
            json.dumps(played | {"actions": demo.actions.tolist() + [0] * (40 - len(demo.actions))})
        )
        Path("card.toml").write_text(CARD)
        Path("experiment.toml").write_text(EXPERIMENT)
        for command in (SHORT, ("submit", "scores", "--out", "entries/a.json.xz"), TRAIN):
            if main(list(command)) != 0:
                raise RuntimeError(f"cannot make the valid files: {command}")
    (folder / "making").rename(stock)
    return stock


def _folder(path: Path) -> Path:
    path.mkdir(exist_ok=True)
    return path


def damaged_files(rng: random.Random, folder: Path) -> None:
    """A command reads a damaged file. It must report the damage or work, and change no file of the user."""
    shutil.copytree(stock(folder.parent), folder, dirs_exist_ok=True)
    name = rng.choice(list(READERS))
    path = Path(name)
    sound = path.read_bytes()
    path.write_bytes(_damaged(path, sound, rng))
    command = rng.choice(READERS[name])
    code = run(command, allowed=name.startswith("run/"))
    if code == 0 and name.endswith((".npz", ".json.xz")) and _content(path) != _content_of(sound, path.suffix):
        raise FindError(f"undetected change of {name}: {' '.join(command)}")
    if code != 0:
        raise MagicalError("refused by the command line")


def _damaged(path: Path, data: bytes, rng: random.Random) -> bytes:
    """The file with random damage. Its bytes are damaged, or its values in a valid structure."""
    if rng.random() < 0.4:
        return spoilt_bytes(data, rng)
    if path.suffix == ".xz":
        return lzma.compress(json.dumps(spoilt_tree(json.loads(lzma.decompress(data)), rng)).encode())
    if path.suffix == ".json":
        return json.dumps(spoilt_tree(json.loads(data), rng)).encode()
    if path.suffix == ".jsonl":
        lines = [json.loads(line) for line in data.splitlines()]
        return "".join(json.dumps(line) + "\n" for line in spoilt_tree(lines, rng)).encode("utf-8", "replace")
    if path.suffix == ".npz":
        return _other_arrays(data, rng)
    if path.suffix in (".toml", ".csv"):
        words = data.decode().split(" " if path.suffix == ".toml" else ",")
        index = rng.randrange(len(words))
        words[index] = rng.choice(
            (json.dumps(json_value(rng)), "", "nan", "-" + "1" * 30, "true", '"x"', "[]", "{}", "\n")
        )
        return (" " if path.suffix == ".toml" else ",").join(words).encode("utf-8", "replace")
    return spoilt_bytes(data, rng)


def _other_arrays(data: bytes, rng: random.Random) -> bytes:
    """A demonstration with another array, and with the old digest or a forged one."""
    with np.load(io.BytesIO(data)) as archive:
        arrays = {name: archive[name] for name in archive.files}
    name = rng.choice(list(arrays))
    old = arrays[name]
    kinds: list[Any] = [
        *(old[:-1], old[:0], old[None], old.astype(np.float32), old * 0, np.array(3), np.zeros((0, 3)), old + 1),
        *(
            np.full_like(old, 17),
            np.full(old.shape, np.nan),
            np.full(old.shape, 1e300),
            np.array(["x"]),
            np.arange(9**5),
        ),
    ]
    arrays[name] = rng.choice(kinds)
    header = json.loads(bytes(arrays["header"].tobytes())) if name != "header" else None
    if header is not None and rng.random() < 0.8:  # a forger who knows the format
        if rng.random() < 0.5:
            header = spoilt_tree(header, rng)
        with contextlib.suppress(Exception):
            header.pop("digest", None)
            header["digest"] = _digest(header, {key: arrays[key] for key in ARRAYS})
        arrays["header"] = np.frombuffer(json.dumps(header).encode("utf-8", "replace"), np.uint8)
    out = io.BytesIO()
    np.savez(out, **arrays)
    return out.getvalue()


def _content(path: Path) -> Any:
    return _content_of(path.read_bytes(), path.suffix)


def _content_of(data: bytes, suffix: str) -> Any:
    """The content of a file, independent of its compression."""
    if suffix == ".xz":
        return json.loads(lzma.decompress(data))
    with np.load(io.BytesIO(data)) as archive:
        header = json.loads(archive["header"].tobytes())
        return None if header.get("digest") else header  # a digest that matches was forged, which no reader can detect


def hostile_command(rng: random.Random, folder: Path) -> None:
    """A command line with some random words."""
    shutil.copytree(stock(folder.parent), folder, dirs_exist_ok=True)
    words = list(rng.choice(COMMANDS))
    for _ in range(rng.choice((1, 1, 2, 3))):
        index, how = rng.randrange(len(words)), rng.random()
        text = rng.choice([text for text in TEXTS if text not in SLOW])
        if how < 0.5:
            words[index] = text
        elif how < 0.65:
            words.insert(index, text)
        elif how < 0.8:
            del words[index]
        else:
            words.insert(index, rng.choice([word for command in COMMANDS for word in command]))
        words = words or ["list"]
    if words[0] == "play" or "--web" in words:
        words = [word for word in words if word != "--web"]
        words += ["--size", "32", "--nonsense"]  # a window would wait for a player
    if words[0] in ("train", "experiment") and "bc.batches=1" not in words and words[0] == "train":
        words += ["--set", "bc.batches=1", "--set", "evaluations=0"]
    if "demo" not in words:
        code = run(words, allowed=words[0] in ("train", "experiment", "demos", "evaluate") or "--force" in words)
        if code != 0:
            raise MagicalError("refused by the command line")


def run(command: Any, *, allowed: bool) -> int:
    """Runs a command in this process, and checks its exit code, its messages, and the files in the folder.

    If `allowed`, it may change files.
    """
    before = {path: path.read_bytes() for path in Path().rglob("*") if path.is_file()}
    out, error = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
            code = main(list(command))
    except (SystemExit, KeyboardInterrupt) as stop:
        raise FindError(f"{type(stop).__name__} from {command[0]}") from stop
    said = error.getvalue()
    if code not in (0, 1, 2, 130) or "Traceback" in said:
        raise FindError(f"{command[0]} ends with {code} and prints {said[-300:]}")
    if code != 0 and not said.strip():
        raise FindError(f"{command[0]} ends with {code} without a message")
    if code != 0 and "magical-mj" not in said:
        raise FindError(f"{command[0]} ends with {code} and prints {said[-300:]}")
    for path, content in before.items():
        now = path.read_bytes() if path.exists() else None
        if now == content or allowed:
            continue
        grown = str(path) in GROWS and now is not None and now.startswith(content[: content.rfind(b"\n") + 1])
        if not grown and not (str(path) == SETTINGS and now is not None and code == 0 and _says_more(now, content)):
            raise FindError(f"{' '.join(command)[:200]} changed {path}")
    return code


def _says_more(now: bytes, before: bytes) -> bool:
    """Whether the settings of an evaluation are those before, perhaps with more policies, environments or episodes."""
    new, old = json.loads(now), json.loads(before)

    def is_kept(name: str) -> bool:
        if name in ("policies", "environments", "shifts"):
            return all(item in new[name] for item in old[name])
        return new[name] >= old[name] if name == "episodes" else new[name] == old[name]

    return all(is_kept(name) for name in old)
