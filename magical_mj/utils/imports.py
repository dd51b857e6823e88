"""Users' modules: objects in them as ``"package.module:NAME"``, and the errors that their code raises."""

from __future__ import annotations

import importlib
import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from typing import Any, Final

from magical_mj.utils.errors import MagicalError, TaskError

_REFERENCE: Final = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")
_PACKAGE: Final = f"{Path(__file__).parents[1]}{os.sep}"
_STANDARD_LIBRARY: Final = f"{get_path('stdlib')}{os.sep}"


def is_reference(text: object) -> bool:
    """Whether `text` has the form ``"package.module:NAME"``; nothing is imported."""
    return isinstance(text, str) and _REFERENCE.fullmatch(text) is not None


def resolve(reference: str) -> Any:
    """The object that ``"package.module:NAME"`` refers to; modules in the current folder are found too.

    Raises:
        ImportError: if there is no such module or object. Errors raised by the module itself pass through.
    """
    module, _, name = reference.partition(":")
    if module not in sys.modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # Python adds it for scripts, but not for installed commands
    found: Any = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(found, part):
            raise ImportError(f"{reference!r} does not exist: there is no {part!r} in {module}")
        found = getattr(found, part)
    return found


def source_of(reference: str) -> Path | None:
    """The file of the module that a reference names, if the module was imported from one."""
    file = getattr(sys.modules.get(reference.partition(":")[0]), "__file__", None)
    return Path(file) if file and Path(file).is_file() else None


@contextmanager
def errors_of_task(what: str) -> Iterator[None]:
    """Makes any error of the task's code inside a `TaskError`: `what`, the error's type, message and place.

    This package's own errors, which a task may raise on purpose, pass through.
    """
    try:
        yield
    except MagicalError:
        raise
    except Exception as error:
        raise TaskError(f"{what}: {with_place(error)}") from error


def with_place(error: BaseException) -> str:
    """The error's type, message and place."""
    where = "" if isinstance(error, SyntaxError) else place(error)  # whose message names the place
    return f"{type(error).__name__}: {error}{where}"


def place(error: BaseException) -> str:
    """The last place from which the error came that is neither in this package nor in Python, if there is one."""
    frames = [frame for frame in extract_tb(error.__traceback__) if _is_theirs(frame.filename)]
    return f" ({frames[-1].filename}, line {frames[-1].lineno})" if frames else ""


def _is_theirs(file: str) -> bool:
    if file.startswith((_PACKAGE, "<")):
        return False
    return "site-packages" in Path(file).parts or not file.startswith(_STANDARD_LIBRARY)
