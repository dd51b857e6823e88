"""Writing files atomically, so that a file appears under its name only when it is complete; locks; and reading TOML."""

from __future__ import annotations

import errno
import os
import platform
import re
import threading
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path
from typing import Any, Final

from magical_mj.utils.errors import SettingsError

_UNFINISHED: Final = re.compile(r"\..+-\d+-\d+\.part(\.[^.]*)?")
"""The names of the temporary files of `new_file`."""


def write(path: Path | str, data: str | bytes, *, overwrite: bool = False) -> None:
    """Writes a file completely or not at all. Text is encoded as UTF-8.

    Args:
        path: the file. Its folder must exist.
        data: the file's content.
        overwrite: replace an existing file.

    Raises:
        FileExistsError: if the file exists and `overwrite` is false.
        IsADirectoryError: if it is a folder.
        OSError: if it cannot be written; its `filename` is the path. An existing file is kept.
    """
    with new_file(path, overwrite=overwrite) as beside:
        beside.write_bytes(data.encode() if isinstance(data, str) else data)


@contextmanager
def new_file(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """For code that writes a file by itself: yields a temporary path next to `path`, and renames that file at the end.

    If the block raises, the temporary file is removed. The yielded path has the same suffix as `path`.

    Raises:
        FileExistsError, OSError: as `write`.
    """
    path = Path(path)
    if overwrite and path.is_symlink():
        path = Path(os.path.realpath(path))  # what it leads to is replaced, not the link
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder", str(path))
    mine = f"{platform.node()}-{os.getpid()}-{threading.get_ident()}"
    unfinished = path.with_name(f".{path.stem}.{mine}.part{path.suffix}")
    try:
        _clear_up(path)
        if path.exists() and not overwrite:
            raise _exists(path)
        yield unfinished
        _to_disk(unfinished)
        _rename(unfinished, path, overwrite)
    except OSError as error:
        if error.errno is None or error.filename not in (None, str(unfinished)):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error  # a full disk's error has no file name
    finally:
        with suppress(OSError):
            unfinished.unlink()


def is_unfinished(path: Path) -> bool:
    """Whether this is a temporary file of `new_file`, which a process that was killed may have left."""
    return _UNFINISHED.fullmatch(path.name) is not None


def is_empty(folder: Path) -> bool:
    """Whether there is nothing in a folder but unfinished files, which a process that was killed has left."""
    return all(map(is_unfinished, folder.iterdir()))


@contextmanager
def locked(path: Path, *, busy: Exception | None = None) -> Iterator[None]:
    """A context that one process at a time enters for a file or folder, which must exist. Not on Windows.

    Args:
        path: the file or folder.
        busy: what is raised if another process is in it; None: this one waits.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    mode = os.O_RDONLY if path.is_dir() else os.O_RDWR  # NFS locks no file that is open for reading only
    descriptor = os.open(path, mode)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX if busy is None else fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise busy or error from None
        yield
    finally:
        fcntl.flock(descriptor, fcntl.LOCK_UN)  # closing is not enough if a child, forked meanwhile, lives on
        os.close(descriptor)


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        SettingsError: if it cannot be read as TOML.
    """
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"{path} cannot be read as TOML: {error}") from error


def _clear_up(path: Path) -> None:
    """Removes temporary files of this path that processes killed on this machine have left."""
    for left in path.parent.glob(f".{escape(path.stem)}.{escape(platform.node())}-*.part{escape(path.suffix)}"):
        with suppress(OSError, ValueError):
            process = int(left.name.split("-")[-2])
            if not Path(f"/proc/{process}").exists() and Path("/proc/self").exists():
                left.unlink()


def _exists(path: Path) -> FileExistsError:
    return FileExistsError(errno.EEXIST, "exists already", str(path))


def _to_disk(path: Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def _rename(unfinished: Path, path: Path, overwrite: bool) -> None:
    if overwrite:
        unfinished.replace(path)
        return
    try:
        path.hardlink_to(unfinished)  # unlike renaming, this fails if another process has made the file meanwhile
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # the file system has no hard links
        unfinished.rename(path)
