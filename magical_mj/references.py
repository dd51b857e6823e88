"""References to objects in users' modules, as ``"package.module:NAME"``."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path
from typing import Any, Final

_REFERENCE: Final = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")


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
