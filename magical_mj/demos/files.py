"""Demonstrations as files: one zip archive of numpy arrays each, which `numpy.load` opens without pickle.

`header.npy` holds JSON as bytes: all fields that are not arrays, the file format's version, and a SHA-256 digest of
everything else. `actions.npy`, `qpos.npy` and `qvel.npy` are the arrays of `Demonstration`. Files are written
completely or not at all, and never overwritten. What is read may be a stranger's: its size is bounded, it imports
nothing, and everything in it is checked here.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import itertools
import json
import zipfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration, check
from magical_mj.scene import Scene
from magical_mj.tasks.plugins import announced_name
from magical_mj.tasks.registry import variant_name
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, MagicalError
from magical_mj.utils.imports import check_named

FORMAT: Final = 1
SUFFIX: Final = ".npz"
ARRAYS: Final = ("actions", "qpos", "qvel")
MOST_BYTES: Final = 50_000_000
"""The largest file, and the largest content, that is read; the longest demonstrations here have 200,000 bytes."""
COMPRESSIONS: Final = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
"""Those that numpy writes, and whose readers unpack no more than was declared."""
HEADER_FIELDS: Final = tuple(f.name for f in dataclasses.fields(Demonstration) if f.name not in (*ARRAYS, "scene"))


def write(demo: Demonstration, path: Path | str) -> None:
    """Writes a demonstration to a file (`*.npz`) that does not exist yet. Its folder is made if missing.

    Raises:
        DemonstrationError: if the name has another ending, so that it would not be found in its folder, or if the parts
            of the demonstration do not fit each other.
        FileExistsError: if it does; nothing is overwritten.
    """
    path = files.to_path(path)
    if path.suffix != SUFFIX:
        raise DemonstrationError(f"{path} must end in {SUFFIX}")
    check(demo)
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
    paths = files.to_path(folder).glob(f"{beginning}*{SUFFIX}")
    return sorted(path for path in paths if not path.name.startswith("."))


def files_in_or_below(folder: Path | str, beginning: str = "") -> list[Path]:
    """What `files_in` finds, and then what it finds in subfolders that are not hidden, such as one for each player."""
    folder = files.to_path(folder)
    return [path for inner in (folder, *sorted(folder.glob("[!.]*/"))) for path in files_in(inner, beginning)]


def keep(demo: Demonstration, folder: Path | str) -> tuple[Path, bool]:
    """Writes a demonstration into a folder under the next free name, such as ``FindDupe-All-human-003.npz``.

    Whatever else is in the folder, the demonstration is written.

    Returns:
        Its path, and whether it was written: if the folder holds the same episode already, nothing is, and the path is
        that of the file which holds it.

    Raises:
        OSError: if it cannot be written.
    """
    folder = files.to_path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    beginning = f"{demo.name}-{demo.demonstrator}-"
    for path in files_in(folder, beginning):
        with contextlib.suppress(Exception):  # nothing that is wrong with another file may cost this episode
            other = read(path, demo.task)
            if (other.scene_seed, other.actions.tobytes()) == (demo.scene_seed, demo.actions.tobytes()):
                return path, False
    paths = (folder / f"{beginning}{number:03}{SUFFIX}" for number in itertools.count())
    while True:
        path = next(path for path in paths if not path.exists())
        with contextlib.suppress(FileExistsError):  # another process has taken the name meanwhile
            write(demo, path)
            return path, True


def read(path: Path | str, task: str | None = None, *, trusted: Collection[str] = ()) -> Demonstration:
    """Reads a demonstration and checks that it is undamaged.

    A task that was given by reference when the file was written, and is announced by now, has its name.

    Args:
        path: the file.
        task: the task that it must be of.
        trusted: besides that task, references such as "mine:SPEC" whose modules may be imported; see
            `magical_mj.utils.imports`.

    Raises:
        DemonstrationError: if it is truncated, altered, of another version or of another task, larger than
            `MOST_BYTES`, or not a plain file.
        UntrustedNameError: if its task is a reference that is not trusted.
        OSError: if there is no such file, or it cannot be read.
    """
    path = files.to_path(path)
    content = files.read_foreign(path, most=MOST_BYTES, error=DemonstrationError)
    try:
        parts = _unpacked(content)
    except MagicalError as error:
        raise DemonstrationError(f"{path} {error}") from None
    except Exception as error:  # zipfile, zlib and numpy raise some fifteen types for damaged archives
        raise DemonstrationError(f"{path} is damaged or cut short, or not a demonstration at all") from error
    arrays: dict[str, Any] = {name: parts[name] for name in ARRAYS}
    header = _header(path, parts["header"], arrays)
    if task is not None and header["task"] != announced_name(task):
        raise DemonstrationError(f"{path} is a demonstration of {header['task']}, not of {task}")
    if header["task"] not in (task, *trusted):
        check_named(header["task"], "a demonstration")
    try:
        scene = Scene.from_json(json.dumps(header["scene"]))
        fields = {name: header[name] for name in HEADER_FIELDS} | {"variant": variant_name(header["variant"])}
        demo = Demonstration(**fields, scene=scene, **arrays)
        check(demo)
    except (KeyError, TypeError, MagicalError) as error:
        raise DemonstrationError(f"{path} does not describe a demonstration: {error}") from error
    return demo


def _unpacked(content: bytes) -> dict[str, NDArray[Any]]:
    """The header and the arrays in a file's content."""
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if size > MOST_BYTES:
            raise DemonstrationError(f"unpacks to {size:,} bytes, and at most {MOST_BYTES:,} are read")
        if any(member.compress_type not in COMPRESSIONS for member in members):
            raise DemonstrationError("is compressed in another way than demonstrations are, by deflate")
    with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
        return {name: arrays[name] for name in ("header", *ARRAYS)}


def _header(path: Path, text: NDArray[Any], arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """The fields in the header, if it is one of this format and of these arrays; the task by its present name."""
    try:
        header = json.loads(text.tobytes())
        version, digest = header.get("format"), header.pop("digest", None)
        is_whole = digest == _digest(header, arrays)
    except (ValueError, AttributeError, RecursionError):
        raise DemonstrationError(f"{path} has an unreadable header: it is damaged, or not a demonstration") from None
    if version != FORMAT:
        raise DemonstrationError(
            f"{path} has format {version!r}, and this version of magical_mj reads format {FORMAT}: "
            "read it with the version that wrote it, or generate it again"
        )
    if not is_whole:
        raise DemonstrationError(f"{path} was altered after it was written: its digest is not that of its content")
    return {**header, "task": announced_name(header.get("task", ""))}


def _digest(header: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> str:
    """A hash of the header and the arrays."""
    digest = hashlib.sha256(json.dumps(header, sort_keys=True).encode())
    for name in ARRAYS:
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
