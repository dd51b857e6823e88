"""Atomic writing of files and folders, locks, and reading. A file gets its name only when it is complete."""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import shutil
import stat
import tempfile
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
"""The largest size in bytes of a TOML file."""
_LONGEST_STEM: Final = 30
"""The number of characters of a file's name in its temporary file's name: file systems allow 255 bytes."""


def to_path(path: str | os.PathLike[str]) -> Path:
    """`path` as a `Path`, for arguments of public functions. Raises a `SettingsError` for other types."""
    if not isinstance(path, str | os.PathLike):
        raise SettingsError(f"a path must be a string or a pathlib.Path, not {short_repr(path)}")
    return Path(path)


def cache_folder() -> Path:
    """The folder of this package in the user's cache."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "magical_mj"


def private_folder(name: str) -> Path:
    """A folder of this user below the system's temporary folder. It is created if it is missing.

    Raises:
        PermissionError: if another user could have written to it.
        OSError: if it cannot be created.
    """
    user = os.getuid() if hasattr(os, "getuid") else 0  # on Windows, each user has a temporary folder
    path = Path(tempfile.gettempdir()) / f"{name}-{user}"
    with suppress(FileExistsError):
        path.mkdir(mode=0o700)
    facts = path.lstat()
    if os.name == "posix" and (facts.st_uid, facts.st_mode) != (user, stat.S_IFDIR | 0o700):
        raise PermissionError(f"{path} is not a folder that only this user can read and write: delete it")
    return path


def write(path: Path | str, data: str | bytes, *, overwrite: bool = False, mode: int | None = None) -> None:
    """Writes a file completely or not at all. Text is encoded as UTF-8.

    Args:
        path: the file. Its folder must exist.
        data: the file's content.
        overwrite: replace an existing file.
        mode: the file's permissions, as for `os.chmod`, set when it is created; None: the system's default.

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
    """A context for code that writes a file itself. Yields a temporary path next to `path`, and renames it at the end.

    If the block raises, the temporary file is removed. If its process dies, the next call removes it. The yielded path
    has the same suffix as `path`. Other processes of this machine that write the same file wait.

    Raises:
        FileExistsError, OSError: for the reasons given by `write`.
    """
    given = str(to_path(path))
    path = Path(given).absolute()  # the block, or a thread, may change the working folder
    if overwrite and path.is_symlink():
        path = Path(os.path.realpath(path))  # a link's target is replaced, not the link
    if path.is_dir():
        raise IsADirectoryError(errno.EISDIR, "is a folder", given)
    if not path.parent.is_dir():  # the lock would create it
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), given)
    # Each machine has its own temporary files, since shared file systems may not support locks between machines.
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
                with unfinished.open("r+b") as file:  # Windows flushes only files that are open for writing
                    os.fsync(file.fileno())
                _rename(unfinished, path, overwrite)
            finally:
                with suppress(OSError):
                    unfinished.unlink()
    except OSError as error:
        if error.errno is None or error.filename not in (None, *map(str, (unfinished, lock, path))):
            raise
        raise OSError(error.errno, error.strerror, given) from error  # the error of a full disk has no file name


@contextmanager
def new_folder(path: Path, *, overwrite: bool = False) -> Iterator[Path]:
    """A context for code that creates a folder. Yields a temporary path next to `path`, and renames it at the end.

    If the block raises, or its process dies, the previous content of `path` remains, or the next call restores it.
    Other processes that create folders with the same parent wait. The parent is created if it is missing.

    Raises:
        FileExistsError: if the folder exists and `overwrite` is false.
    """
    given, path = path, path.absolute()  # the block may change the working folder
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished, replaced = (path.with_name(f".{path.name}.{what}") for what in ("part", "old"))
    with locked(path.parent):
        shutil.rmtree(unfinished, ignore_errors=True)  # left by a killed process
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
    """Restores a replaced folder, unless a new one exists."""
    if replaced.exists() and not path.exists():
        replaced.rename(path)
    shutil.rmtree(replaced, ignore_errors=True)


def is_unfinished(path: Path) -> bool:
    """Whether this is a temporary file or a lock of this module, possibly left by a killed process."""
    return _UNFINISHED.fullmatch(path.name) is not None


@contextmanager
def locked(path: Path, *, busy: Exception | None = None) -> Iterator[None]:
    """A context that only one process at a time can enter for an existing file or folder.

    Meanwhile, a hidden lock file exists in the folder, or next to the file. If another process is in the context,
    this one waits, or raises `busy`.
    """
    path = path.absolute()  # the block may change the working folder
    lock = path / ".lock" if path.is_dir() else path.with_name(f".{path.name}.lock")
    try:
        with _held(lock, timeout=-1 if busy is None else 0):
            yield
    except Timeout as error:
        if busy is None or error.lock_file != str(lock):
            raise
        raise busy from None


def read_foreign(path: Path, *, most: int, error: type[MagicalError]) -> bytes:
    """The content of a file from an untrusted source.

    Raises the given `error` if the file has more than `most` bytes, or is not a plain file: reading a pipe could block.
    """
    if path.exists() and not path.is_file():
        raise error(f"{path} is not a plain file: it is a folder, a pipe or a device")
    with path.open("rb") as file:
        content = b"" if (size := path.stat().st_size) > most else file.read(most + 1)  # files in /proc have no size
    if max(size, len(content)) > most:
        raise error(f"{path} is larger than {most:,} bytes, the limit")
    return content


def read_toml(path: Path) -> dict[str, Any]:
    """The content of a TOML file. Raises a `SettingsError` if it cannot be read as TOML."""
    try:
        return tomllib.loads(read_foreign(path, most=_MOST_TOML, error=SettingsError).decode())
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"{path} cannot be read as TOML: {error}") from error


@contextmanager
def _held(path: Path, timeout: float = -1) -> Iterator[None]:
    """Holds the lock file at this path, and removes it at the end.

    It is removed while the lock is held: `FileLock` creates a new one if its locked file is gone. Windows cannot remove
    an open file. There, `FileLock` removes it.
    """
    path.touch()  # raises an error where no file can be created, such as in /proc; FileLock would wait for ever
    with FileLock(path, timeout=timeout):
        try:
            yield
        finally:
            with suppress(OSError):
                path.unlink()


def _exists(path: Path) -> FileExistsError:
    return FileExistsError(errno.EEXIST, "exists already; give another path, or remove it first", str(path))


def _rename(unfinished: Path, path: Path, overwrite: bool) -> None:
    if overwrite:
        unfinished.replace(path)
        return
    try:
        path.hardlink_to(unfinished)  # unlike renaming, this fails if another process has created the file
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # the file system has no hard links
        unfinished.rename(path)
