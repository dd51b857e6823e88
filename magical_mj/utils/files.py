"""Writing files atomically, so that a file appears under its name only when it is complete; locks; and reading."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import shutil
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from filelock import FileLock, Timeout

from magical_mj.utils.errors import MagicalError, SettingsError, short_repr

_UNFINISHED: Final = re.compile(r"\..*\.[0-9a-f]{8}-[0-9a-f]{8}\.(part(\.[^.]*)?|lock)|\.(.*\.)?lock")
"""The names of the temporary files and locks of this module."""
_MOST_TOML: Final = 1_000_000
"""The number of bytes of the largest TOML file that is read."""
_LONGEST_STEM: Final = 30
"""The characters of a file's name in that of its temporary file: file systems take 255 bytes."""


def to_path(path: str | os.PathLike[str]) -> Path:
    """`path` as a `Path`, for public functions, whose users may give something else: then a `SettingsError`."""
    if not isinstance(path, str | os.PathLike):
        raise SettingsError(f"a path must be a text or a pathlib.Path, not {short_repr(path)}")
    return Path(path)


def write(path: Path | str, data: str | bytes, *, overwrite: bool = False, mode: int | None = None) -> None:
    """Writes a file completely or not at all. Text is encoded as UTF-8.

    Args:
        path: the file. Its folder must exist.
        data: the file's content.
        overwrite: replace an existing file.
        mode: who may use the file, as for `os.chmod`, from its beginning on; None: as the system's default is.

    Raises:
        FileExistsError: if the file exists and `overwrite` is false.
        IsADirectoryError: if it is a folder.
        OSError: if it cannot be written; its `filename` is the path. An existing file is kept.
    """
    with new_file(path, overwrite=overwrite) as unfinished:
        if mode is not None:
            unfinished.touch(mode)
        unfinished.write_bytes(data.encode() if isinstance(data, str) else data)


@contextmanager
def new_file(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """For code that writes a file by itself: yields a temporary path next to `path`, and renames that file at the end.

    If the block raises, the temporary file is removed; if its process dies, the next call does that. The yielded path
    has the same suffix as `path`. Other processes of this machine that write the same file wait.

    Raises:
        FileExistsError, OSError: as `write`.
    """
    given = str(to_path(path))
    path = Path(given).absolute()  # the block, or a thread, may go to another working folder
    if overwrite and path.is_symlink():
        path = Path(os.path.realpath(path))  # what it leads to is replaced, not the link
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder", given)
    if not path.parent.is_dir():  # which the lock would make
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), given)
    # Machines have temporary files of their own: file systems that they share may not share locks.
    host, name = (hashlib.sha256(os.fsencode(text)).hexdigest()[:8] for text in (platform.node(), path.name))
    lock = path.with_name(f".{path.stem[:_LONGEST_STEM]}.{host}-{name}.lock")
    unfinished = lock.with_suffix(f".part{path.suffix}")
    try:
        with _held(lock):
            unfinished.unlink(missing_ok=True)
            try:
                if path.exists() and not overwrite:
                    raise _exists(path)
                yield unfinished
                with unfinished.open("r+b") as file:  # Windows flushes only what is open for writing
                    os.fsync(file.fileno())
                _rename(unfinished, path, overwrite)
            finally:
                with suppress(OSError):
                    unfinished.unlink()
    except OSError as error:
        if error.errno is None or error.filename not in (None, *map(str, (unfinished, lock, path))):
            raise
        raise OSError(error.errno, error.strerror, given) from error  # a full disk's error has no file name


@contextmanager
def new_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """For code that makes a folder: yields the path next to `path` where to make it, and renames it at the end.

    If the block raises, or its process dies, what was at `path` stays or is restored by the next call. Other processes
    that make folders beside it wait. The folder's parent is made if missing.

    Raises:
        FileExistsError: if the folder exists and `overwrite` is false.
    """
    given, path = path, path.absolute()  # the block may go to another working folder
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished, replaced = (path.with_name(f".{path.name}.{what}") for what in ("part", "old"))
    with locked(path.parent):
        shutil.rmtree(unfinished, ignore_errors=True)  # what a process left that was killed
        _restore(replaced, path)
        if path.exists() and not overwrite:
            raise _exists(given)
        try:
            yield unfinished
            if path.exists():
                path.rename(replaced)
            unfinished.rename(path)
        finally:
            shutil.rmtree(unfinished, ignore_errors=True)
            _restore(replaced, path)


def _restore(replaced: Path, path: Path) -> None:
    """Puts a folder back unless there is another one by now, which counts."""
    if replaced.exists() and not path.exists():
        replaced.rename(path)
    shutil.rmtree(replaced, ignore_errors=True)


def is_unfinished(path: Path) -> bool:
    """Whether this is a temporary file or a lock of this module, which a process that was killed may have left."""
    return _UNFINISHED.fullmatch(path.name) is not None


@contextmanager
def locked(path: Path, *, busy: Exception | None = None) -> Iterator[None]:
    """A context that one process at a time enters for a file or folder, which must exist.

    A hidden file lies in the folder, or beside the file, as long as somebody is in it. If another process is in it,
    this one waits, or raises `busy`.
    """
    path = path.absolute()  # the block may go to another working folder
    lock = path / ".lock" if path.is_dir() else path.with_name(f".{path.name}.lock")
    try:
        with _held(lock, timeout=-1 if busy is None else 0):
            yield
    except Timeout as error:
        if busy is None or error.lock_file != str(lock):
            raise
        raise busy from None


def read_foreign(path: Path, *, most: int, error: type[MagicalError]) -> bytes:
    """The content of a file that somebody else may have made.

    Raises:
        OSError: if there is no such file, or it cannot be read.
        MagicalError: the given type, if it has more bytes than `most`, or is no plain file: a pipe could be waited for
            without end.
    """
    if path.exists() and not path.is_file():
        raise error(f"{path} is not a plain file, but a folder, a pipe or a device")
    with path.open("rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise error(f"{path} is larger than {most:,} bytes, and is not read")
    return content


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file; a `SettingsError` if it cannot be read as TOML."""
    try:
        return tomllib.loads(read_foreign(path, most=_MOST_TOML, error=SettingsError).decode())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"{path} cannot be read as TOML: {error}") from error


@contextmanager
def _held(path: Path, timeout: float = -1) -> Iterator[None]:
    """Holds the lock that this file is; the file is removed at the end.

    It is removed while it is held: `FileLock` makes a new one if the file that it has locked is gone. On Windows, where
    an open file cannot be removed, `FileLock` does it.
    """
    with FileLock(path, timeout=timeout):
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _exists(path: Path) -> FileExistsError:
    return FileExistsError(errno.EEXIST, "exists already", str(path))


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
