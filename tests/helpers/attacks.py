"""Files that cost much more to read than to write: python -m tests.helpers.attacks [NAME ...] prints what they cost.

Each is read by a process of its own, with `limits.MOST_SECONDS` and `MOST_MEMORY`. `tests/test_attacks.py` bounds them.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import lzma
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

from tests.helpers.limits import Used, used

COMMAND: Final = [sys.executable, "-m", "magical_mj"]
EPISODE: Final = {
    "policy": "p",
    "run": 0,
    "task": "MoveToRegion",
    "variant": "Demo",
    "seed": 0,
    "score": 0.0,
    "steps": 1,
    "seconds": 0.0,
    "rules": "paper",
    "preset": None,
    "version": "0",
    "mujoco": "3.17.0",
    "gl": "egl",
    "actions": "a",
}


def _python(code: str) -> list[str]:
    """A command that runs Python code, which may call `magical_mj`."""
    shown = "except magical_mj.utils.errors.MagicalError as error: print(error); sys.exit(1)"
    lines = "\n".join(f"    {line}" for line in code.splitlines())
    return [sys.executable, "-c", f"import sys, magical_mj\ntry:\n{lines}\n{shown}"]


def _pickle(folder: Path, content: bytes) -> list[str]:
    (folder / "demo-x.pkl.gz").write_bytes(gzip.compress(content))
    return [*COMMAND, "demos", "import", "demo-x.pkl.gz", "--out", "mine"]


def objects(folder: Path) -> list[str]:
    """4 million records in a pickle of 60 KB."""
    return _pickle(folder, b"\x80\x04cmagical\nx\nq\x00" + b"h\x00)\x81}b" * 4_000_000 + b".")


def opcodes(folder: Path) -> list[str]:
    """20 million lists in a pickle of 20 KB."""
    return _pickle(folder, b"\x80\x04" + b"]" * 20_000_000 + b".")


def collisions(folder: Path) -> list[str]:
    """A dict in a pickle with 100,000 keys of equal hash."""
    keys = b"".join(b"\x8a\x0a" + (number * (2**61 - 1)).to_bytes(10, "little") + b"N" for number in range(100_000))
    return _pickle(folder, b"\x80\x04}(" + keys + b"u.")


def zeros(folder: Path) -> list[str]:
    """499 MB of zeros in a pickle of 0.5 MB."""
    head = b"\x80\x04\x8e" + (499 * 10**6).to_bytes(8, "little")
    million = gzip.compress(bytes(10**6))
    (folder / "demo-x.pkl.gz").write_bytes(gzip.compress(head) + 499 * million + gzip.compress(b"."))
    return [*COMMAND, "demos", "import", "demo-x.pkl.gz", "--out", "mine"]


def runs(folder: Path) -> list[str]:
    """280,000 runs of one episode each in an entry of 30 KB."""
    count, environment = 280_000, "MoveToRegion-Demo"
    columns = {"run": list(range(count)), "seed": [0] * count, "scene": [None] * count, "score": [0] * count}
    columns |= {"actions": [""] * count, "failure": ["x"] * count}
    content = {
        "card": {"method": "x"},
        "observations": None,
        "rules": "paper",
        "protocol": None,
        "format": 2,
        "versions": {"version": ["0"], "mujoco": ["0"], "gl": ["egl"]},
        "runs": list(range(count)),
        "episodes": {name: {environment: column} for name, column in columns.items()},
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    digest = hashlib.sha256(text.encode()).hexdigest()
    text = json.dumps({**content, "sha256": digest}, sort_keys=True, separators=(",", ":"))
    (folder / "x.json.xz").write_bytes(lzma.compress(text.encode()))
    return [*COMMAND, "verify", "x.json.xz", "--jobs", "1"]


def diagonal(folder: Path) -> list[str]:
    """15,000 runs in an evaluation, each with an episode of another scene."""
    with (folder / "scores.jsonl").open("w") as file:
        for number in range(15_000):
            file.write(json.dumps({**EPISODE, "run": number, "seed": number}) + "\n")
    return [*COMMAND, "report", ".", "--out", "report"]


def _episodes(folder: Path, **changes: object) -> list[str]:
    (folder / "scores.jsonl").write_text(json.dumps({**EPISODE, **changes}) + "\n")
    return [*COMMAND, "report", ".", "--rules", "released"]


def spaces(folder: Path) -> list[str]:
    """An intent with a million spaces, in an evaluation."""
    return _episodes(folder, task=f"intent:in(all, {' ' * 1_000_000}")


def digits(folder: Path) -> list[str]:
    """An intent whose seed has 5,000 digits, in an evaluation."""
    return _episodes(folder, task=f"intent:robot in() [seed={'1' * 5000}]")


def members(folder: Path) -> list[str]:
    """The name of an intent in a set, with 3,000 spaces."""
    return _episodes(folder, task=f"intent:{' ' * 3000}dev{' ' * 3000}!")


def line(folder: Path) -> list[str]:
    """A line of 1 GB in an evaluation."""
    with (folder / "scores.jsonl").open("wb") as file:
        file.truncate(10**9)
    return [*COMMAND, "report", "."]


def names(folder: Path) -> list[str]:
    """40,000 names in a scene, of which the last one occurs twice."""
    fields = [f'"a{number}":0' for number in range(40_000)]
    (folder / "scene.json").write_text("{" + ",".join([*fields, fields[-1]]) + "}")
    return _python("magical_mj.Scene.from_json(open('scene.json').read())")


def lists(folder: Path) -> list[str]:
    """20 million lists in a scene."""
    with (folder / "scene.json").open("w") as file:
        file.write('{"format": 1, "blocks": [')
        for _ in range(200):
            file.write("[]," * 100_000)
        file.write("[]]}")
    return _python("magical_mj.Scene.from_json(open('scene.json').read())")


def meshes(folder: Path) -> list[str]:
    """An MJCF file that names 3,000 folders and 3,000 missing meshes."""
    folders = "".join(f'<compiler meshdir="f{number}"/>' for number in range(3000))
    named = "".join(f'<mesh file="m{number}.stl"/>' for number in range(3000))
    (folder / "model.xml").write_text(f"<mujoco>{folders}<asset>{named}</asset></mujoco>")
    return _model()


def model(folder: Path) -> list[str]:
    """An MJCF file that refers to a file of 2 GB."""
    with (folder / "m.stl").open("wb") as file:
        file.truncate(2 * 10**9)
    (folder / "model.xml").write_text('<mujoco><asset><mesh file="m.stl"/></asset></mujoco>')
    return _model()


def entities(folder: Path) -> list[str]:
    """An MJCF file whose entities expand to 10^9 characters."""
    define = "".join(f'<!ENTITY a{n + 1} "{f"&a{n};" * 10}">' for n in range(8))
    (folder / "model.xml").write_text(
        f'<!DOCTYPE m [<!ENTITY a0 "0123456789">{define}]><mujoco model="&a8;"/>', "utf-8"
    )
    return _model()


def _model() -> list[str]:
    return _python(
        "from pathlib import Path\nfrom magical_mj.web.inspection import model_files\n"
        "print({name: len(content) for name, content in model_files(Path('model.xml')).items()})"
    )


class Attack(NamedTuple):
    """A file, and what reading it may cost: ten times what it needs on a quiet machine, apart from Python's start."""

    make: Callable[[Path], list[str]]
    says: str
    """A part of the answer."""
    seconds: float = 20.0
    megabytes: float = 1000.0


ATTACKS: Final = {
    attack.make.__name__: attack
    for attack in (
        Attack(objects, "operations"),
        Attack(opcodes, "operations"),
        Attack(collisions, "operations"),
        Attack(zeros, "holds no demonstration", megabytes=2500),
        Attack(runs, "length <= 1000"),
        Attack(diagonal, "scenes"),
        Attack(spaces, "length <= 10000"),
        Attack(digits, "seed"),
        Attack(members, "characters"),
        Attack(line, "limit for a line"),
        Attack(names, "at most 100,000 characters"),
        Attack(lists, "at most 100,000 characters"),
        Attack(meshes, "30 folders"),
        Attack(model, "more than 200,000,000 bytes"),
        Attack(entities, "model.xml"),
    )
}


def cost(name: str) -> Used:
    """What reading the file of an attack costs."""
    with tempfile.TemporaryDirectory() as folder:
        return used(ATTACKS[name].make(Path(folder)), Path(folder))


def main(chosen: list[str]) -> None:
    """Prints a table of what attacks cost."""
    print("| case | file | s | MB | exit code and answer |\n| --- | --- | ---: | ---: | --- |")  # noqa: T201
    for name in chosen or ATTACKS:
        spent = cost(name)
        answer = f"{'stopped' if spent.code is None else spent.code}: {spent.said[-150:]}"
        about = (ATTACKS[name].make.__doc__ or "").rstrip(".")
        print(f"| {name} | {about} | {spent.seconds:.1f} | {spent.megabytes:.0f} | {answer} |", flush=True)  # noqa: T201


if __name__ == "__main__":
    main(sys.argv[1:])
