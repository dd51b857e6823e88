"""Small inputs that could take much time or memory, and files that could lead outside of a folder."""

from __future__ import annotations

import gzip
import json
import lzma
import random
import resource
import time
from pathlib import Path
from typing import Any, Final

from values import FindError

import magical_mj
from magical_mj.demos.original import from_original
from magical_mj.leaderboard import read_entry
from magical_mj.tasks.languages import canonical_name
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.lines import appending, read_lines
from magical_mj.web.inspection import model_files

SECONDS: Final = 20.0
"""The limit of processor time for one input."""
MEGABYTES: Final = 1500.0
"""The limit of memory that one input adds to the most that was ever in use."""
OPERATIONS: Final = (
    *(b"]", b"}", b")", b"(", b"N", b"K\x01", b"\x8f", b"h\x00)\x81", b"h\x00)\x81}b", b"cmagical\nx\n", b"2", b"0"),
    *(b"\x8a\x08\xff\xff\xff\xff\xff\xff\xff\x1f", b"\x94", b"I" + b"1" * 4000 + b"\n", b"\x8c\x05hello"),
)
WORDS: Final = (
    *(" ", "\t", "1", "[", "]", "(", ")", ",", "&", "=", "a", "in(all, region)", "in(all, region) & ", "seed=", "dev/"),
    *("colour=red, ", "[seed=1]", "demos=", "robot in()", "\n", "\u0661"),
)


def costs(rng: random.Random, folder: Path) -> None:
    """One of these inputs, chosen at random, within the limits."""
    before, used_before = time.process_time(), _used()
    try:
        rng.choice((_objects, _intents, _scenes, _runs, _damage, _models))(rng, folder)
    finally:
        spent, used = time.process_time() - before, _used() - used_before
        if spent > SECONDS or used > MEGABYTES:
            raise FindError(f"an input took {spent:.0f} s and {used:.0f} MB")


def _used() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _many(rng: random.Random) -> int:
    return int(10 ** rng.uniform(0, 6.5))


def _repeated(rng: random.Random, part: Any) -> Any:
    return part * min(_many(rng), 10**7 // len(part))


def _objects(rng: random.Random, folder: Path) -> None:
    content = b"".join(_repeated(rng, rng.choice(OPERATIONS)) for _ in range(rng.randrange(1, 4)))
    path = folder / "demo-x.pkl.gz"
    path.write_bytes(gzip.compress(b"\x80\x04cmagical\nx\nq\x00" + content + b".", 1))
    from_original(path)


def _intents(rng: random.Random, _folder: Path) -> None:
    text = "".join(_repeated(rng, rng.choice(WORDS)) for _ in range(rng.randrange(1, 5)))
    canonical_name(f"intent:{rng.choice(('', 'in(all, region)', 'dev'))}{text}{rng.choice(('', ']', ')'))}")


def _scenes(rng: random.Random, _folder: Path) -> None:
    names = [f'"{rng.choice("ab")}{number}":{rng.choice(("0", "[]", "{}"))}' for number in range(_many(rng) // 10)]
    magical_mj.Scene.from_json("{" + ",".join(names + names[-1:]) + "}")


def _runs(rng: random.Random, folder: Path) -> None:
    runs, pair = list(range(_many(rng) // 10 + 1)), rng.choice(("MoveToRegion-Demo", "FindDupe-All", "x"))
    values = {"run": runs, "seed": 0, "scene": None, "score": 0, "actions": "", "failure": "x"}
    columns = {name: {pair: value if name == "run" else [value] * len(runs)} for name, value in values.items()}
    content = {"card": {"method": "x"}, "format": 2, "observations": None, "rules": "paper", "protocol": None}
    content |= {"versions": {key: ["0"] for key in ("version", "mujoco", "gl")}, "runs": runs, "episodes": columns}
    (folder / "x.json.xz").write_bytes(lzma.compress(json.dumps({**content, "sha256": ""}).encode(), preset=0))
    read_entry(folder / "x.json.xz")


def _damage(rng: random.Random, folder: Path) -> None:
    """What a kill leaves at the end of a file must never cost a whole line."""
    path, whole = folder / "log.jsonl", list[bytes]()
    for number in range(rng.randrange(1, 30)):
        line = json.dumps({"time": number, "event": "x" * rng.randrange(200)}).encode() + b"\n"
        with appending(path) as log:
            log.append(line)
        whole.append(line)
        if rng.random() < 0.3:
            with path.open("ab") as file:
                file.write(rng.choice((line[: rng.randrange(len(line))], b"\0" * rng.randrange(5000))))
    if [line for _, line in read_lines(path, EvaluationError)] != whole:
        raise FindError("a whole line was lost")


def _models(rng: random.Random, folder: Path) -> None:
    """A model's files are read from its folder only, each under its own path."""
    secret, own = folder / "secret", folder / "own"
    secret.write_bytes(b"secret")
    for place in ("", "a", "b", "a/b"):
        (own / place).mkdir(parents=True, exist_ok=True)
        for name in rng.sample(("m.stl", "n.stl", "p.xml"), k=2):
            (own / place / name).write_bytes(f"{place}/{name}".encode())
    (own / "link.stl").symlink_to(rng.choice((secret, own / "a" / "m.stl")))
    (own / "up").symlink_to(rng.choice((folder, own / "a")))

    def reference() -> str:
        parts = [rng.choice(("..", ".", "a", "b", "own", "up", "")) for _ in range(rng.randrange(4))]
        last = rng.choice(("m.stl", "n.stl", "p.xml", "link.stl", "secret", str(secret), "/etc/passwd"))
        return "/".join([*parts, last])

    settings = "".join(f'<compiler meshdir="{reference().rpartition("/")[0]}"/>' for _ in range(rng.randrange(3)))
    meshes = "".join(f'<mesh file="{reference()}"/>' for _ in range(rng.randrange(1, 5)))
    (own / "model.xml").write_text(f"<mujoco>{settings}<asset>{meshes}</asset></mujoco>")
    for name, content in list(model_files(own / "model.xml").items())[1:]:
        if not (own / name).resolve().is_relative_to(own) or content != (own / name).read_bytes():
            raise FindError(f"the model's file {name} is not below its folder, or has another content")
