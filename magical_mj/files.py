"""Writing files so that a name only ever stands for a whole file, whatever happens in between."""

from __future__ import annotations

import errno
import os
import platform
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from glob import escape
from pathlib import Path


def write(path: Path | str, data: str | bytes, *, overwrite: bool = False) -> None:
    """Writes a file as a whole or not at all. Text is encoded as UTF-8.

    Args:
        path: of the file. Its folder must exist.
        data: what the file shall hold.
        overwrite: replace a file of that name.

    Raises:
        FileExistsError: if there is such a file and `overwrite` is false.
        OSError: if it cannot be written; its `filename` is the path. A file that was there is kept.
    """
    with new_file(path, overwrite=overwrite) as beside:
        beside.write_bytes(data.encode() if isinstance(data, str) else data)


@contextmanager
def new_file(path: Path | str, *, overwrite: bool = False) -> Iterator[Path]:
    """For programs that write a file themselves: yields a name beside `path`, and renames that file in the end.

    If the block raises, nothing is left. The yielded name has the suffix of `path`.

    Raises:
        FileExistsError, OSError: as `write`.
    """
    path = Path(path)
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
        raise OSError(error.errno, error.strerror, str(path)) from error  # a full disk names no file
    finally:
        with suppress(OSError):
            unfinished.unlink()


def _clear_up(path: Path) -> None:
    """Removes what processes of this machine that were killed have left of earlier attempts."""
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
        path.hardlink_to(unfinished)  # fails, unlike renaming, if another process has made the file meanwhile
    except FileExistsError:
        raise _exists(path) from None
    except OSError:  # the file system knows no links
        unfinished.rename(path)
