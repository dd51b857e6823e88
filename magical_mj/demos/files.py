"""Demonstrations as files: one zip archive of numpy arrays each, which `numpy.load` opens without pickle.

`header.npy` holds JSON as bytes: all fields that are not arrays, the file format's version, and a SHA-256 digest of
everything else. `actions.npy`, `qpos.npy` and `qvel.npy` are the arrays of `Demonstration`. Files are written
completely or not at all, and never overwritten.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import itertools
import json
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from magical_mj.demos.demonstration import Demonstration
from magical_mj.scene import Scene
from magical_mj.tasks.plugins import announced_name
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError, UntrustedNameError
from magical_mj.utils.imports import check_named

FORMAT: Final = 1
SUFFIX: Final = ".npz"
ARRAYS: Final = ("actions", "qpos", "qvel")
DAMAGE: Final = (  # the exceptions of numpy and zipfile for damaged archives
    *(KeyError, TypeError, ValueError, EOFError, AttributeError, OSError, RuntimeError, SyntaxError, MemoryError),
    *(OverflowError, struct.error, tokenize.TokenError, zipfile.BadZipFile, zlib.error),
)
MOST_BYTES: Final = 50_000_000
"""The largest content of a file that is read; the longest demonstrations of this package have 200,000 bytes."""
HEADER_FIELDS: Final = tuple(f.name for f in dataclasses.fields(Demonstration) if f.name not in (*ARRAYS, "scene"))


def write(demo: Demonstration, path: Path | str) -> None:
    """Writes a demonstration to a file (`*.npz`) that does not exist yet. Its folder is made if missing.

    Raises:
        DemonstrationError: if the name has another ending; it would not be found in its folder.
        FileExistsError: if it does; nothing is overwritten.
    """
    path = Path(path)
    if path.suffix != SUFFIX:
        raise DemonstrationError(f"{path} must end in {SUFFIX}")
    arrays = {name: getattr(demo, name) for name in ARRAYS}
    header = {"format": FORMAT, **{name: getattr(demo, name) for name in HEADER_FIELDS}}
    header["scene"] = json.loads(demo.scene.to_json())
    header["digest"] = _digest(header, arrays)
    path.parent.mkdir(parents=True, exist_ok=True)
    archive = io.BytesIO()
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez_compressed(archive, allow_pickle=False, header=text, **arrays)
    files.write(path, archive.getvalue())


def files_in(folder: Path | str, beginning: str = "") -> list[Path]:
    """The demonstration files in a folder whose names start with `beginning`, sorted; without unfinished ones."""
    return sorted(path for path in Path(folder).glob(f"{beginning}*{SUFFIX}") if not path.name.startswith("."))


def files_in_or_below(folder: Path | str, beginning: str = "") -> list[Path]:
    """What `files_in` finds, and then what it finds in subfolders that are not hidden, such as one for each player."""
    return [
        found for inner in (Path(folder), *sorted(Path(folder).glob("[!.]*/"))) for found in files_in(inner, beginning)
    ]


def keep(demo: Demonstration, folder: Path | str) -> tuple[Path, bool]:
    """Writes a demonstration into a folder under the next free name, such as ``FindDupe-All-human-003.npz``.

    Returns:
        Its path, and whether it was written: if the folder holds the same episode already, nothing is, and the path is
        that of the file which holds it.

    Raises:
        OSError: if it cannot be written.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    for path in files_in(folder, _beginning(demo)):
        with contextlib.suppress(DemonstrationError, UntrustedNameError, OSError):  # this episode is saved anyway
            other = read(path, demo.task)
            if (other.scene_seed, other.actions.tobytes()) == (demo.scene_seed, demo.actions.tobytes()):
                return path, False
    paths = (Path(folder) / f"{_beginning(demo)}{number:03}{SUFFIX}" for number in itertools.count())
    while True:
        path = next(path for path in paths if not path.exists())
        with contextlib.suppress(FileExistsError):  # another process has taken the name meanwhile
            write(demo, path)
            return path, True


def _beginning(demo: Demonstration) -> str:
    return f"{demo.name}-{demo.demonstrator}-"


def read(path: Path | str, task: str | None = None, *, trusted: Collection[str] = ()) -> Demonstration:
    """Reads a demonstration and checks that it is undamaged.

    A task that was given by reference when the file was written, and is announced by now, has its name.

    Args:
        path: the file.
        task: the task that it must be of.
        trusted: besides that task, references such as "mine:SPEC" whose modules may be imported; see
            `magical_mj.utils.imports`.

    Raises:
        DemonstrationError: if it is truncated, altered, of another version or of another task.
        UntrustedNameError: if its task is a reference that is not trusted.
        OSError: if there is no such file, or it cannot be read.
    """
    parts = _parts(Path(path))
    arrays = {name: parts[name] for name in ARRAYS}
    try:
        header = json.loads(parts["header"].tobytes())
        found = header.get("format")
    except (ValueError, AttributeError, RecursionError):
        raise DemonstrationError(f"{path} has an unreadable header: it is damaged, or not a demonstration") from None
    if found != FORMAT:
        raise DemonstrationError(
            f"{path} has format {found!r}, and this version of magical_mj reads format {FORMAT}: "
            "read it with the version that wrote it, or generate it again"
        )
    if header.pop("digest", None) != _digest(header, arrays):
        raise DemonstrationError(f"{path} was altered after it was written: its digest is not that of its content")
    header["task"] = announced_name(header.get("task"))
    if task is not None and header["task"] != announced_name(task):
        raise DemonstrationError(f"{path} is a demonstration of {header['task']}, not of {task}")
    if header["task"] not in (task, *trusted):
        check_named(header["task"], "a demonstration")
    try:
        scene = Scene.from_json(json.dumps(header["scene"]))
        return Demonstration(**{name: header[name] for name in HEADER_FIELDS}, scene=scene, **arrays)
    except (KeyError, TypeError, MagicalError) as error:
        raise DemonstrationError(f"{path} does not describe a demonstration: {error}") from error


def _parts(path: Path) -> dict[str, Any]:
    """The header and the arrays of a file."""
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as content:
                if sum(part.file_size for part in content.infolist()) > MOST_BYTES:
                    raise ValueError
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return {name: archive[name] for name in ("header", *ARRAYS)}
        except DAMAGE:
            raise DemonstrationError(f"{path} is damaged or cut short, or not a demonstration at all") from None


def _digest(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """A hash of the header and the arrays."""
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in ARRAYS:
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
