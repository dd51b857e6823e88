"""Users' modules: objects in them as ``"package.module:NAME"``, and the errors that their code raises.

Importing a module runs its code, so a file that may be somebody else's must not choose one. The rule:

- What the user types is imported: arguments of Python functions, and of the command line. `resolve` does it, and looks
  in the working folder too.
- What an installed package announces by an entry point is imported, but not from the working folder:
  `resolve_installed`.
- A name that is read from a file is text. Whoever reads one that will be resolved calls `check_named` first, which
  refuses it unless the user has typed the same name, or has called `trust`.
- On the command line `resolve` itself refuses what is not among its arguments, see `command_line`, so that a name
  reaches no import there whichever way it takes.

docs/trust.md lists which file may name what.
"""

from __future__ import annotations

import hashlib
import importlib
import os
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from typing import Any, Final

from magical_mj.utils.errors import MagicalError, TaskError, UntrustedNameError, closest

_REFERENCE: Final = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")
_LONGEST: Final = 100
"""The number of letters in the longest module's name that is looked for in the working folder."""
_PACKAGE: Final = f"{Path(__file__).parents[1]}{os.sep}"
_STANDARD_LIBRARY: Final = f"{get_path('stdlib')}{os.sep}"


def is_reference(text: object) -> bool:
    """Whether `text` has the form ``"package.module:NAME"``; nothing is imported."""
    return isinstance(text, str) and _REFERENCE.fullmatch(text) is not None


@dataclass
class _Trust:
    """The references that this process may import.

    Attributes:
        named: those that the user has typed.
        everything: whether all others may be imported as well.
        only_named: whether `resolve` refuses all others: on the command line.
    """

    named: set[str] = field(default_factory=set)
    everything: bool = False
    only_named: bool = False


_TRUST: Final = _Trust()


def trust(*references: str) -> None:
    """Allows files to name these references, such as ``"package.module:SPEC"``, in this process."""
    _TRUST.named.update(references)


def check_named(reference: object, origin: object) -> None:
    """Checks a name from a file (`origin`) that may be somebody else's; to be called before it is resolved.

    All but references are accepted: a name that is announced is the benchmark's or installed.

    Raises:
        UntrustedNameError: if it is a reference that the user has not named.
    """
    if isinstance(reference, str) and is_reference(reference) and not (_TRUST.everything or reference in _TRUST.named):
        raise UntrustedNameError(reference, origin)


@contextmanager
def command_line(arguments: Iterable[str]) -> Iterator[None]:
    """A context in which only those references are imported that the arguments of a command hold.

    With ``--trust`` among them, all are.
    """
    arguments, before = list(arguments), vars(_TRUST).copy()
    parts = {part for argument in arguments for part in re.split("[,=+]", argument)}
    parts |= {re.sub(r"^body:|:[\d-]+$", "", part) for part in parts}  # in shifts with their levels
    named = set(filter(is_reference, parts))
    vars(_TRUST).update(named=named, everything="--trust" in arguments, only_named=True)
    try:
        yield
    finally:
        vars(_TRUST).update(before)


def resolve(reference: str) -> Any:
    """The object that ``"package.module:NAME"`` refers to, typed by the user; the working folder is searched too.

    Raises:
        UntrustedNameError: if it is not among the arguments of the present `command_line`.
        ImportError: if there is no such module or object. Errors raised by the module itself pass through.
    """
    if _TRUST.only_named:
        check_named(reference, "a file")
    trust(reference)
    module, _, name = reference.partition(":")
    if module.endswith(".py"):
        raise ImportError(f"{module} is a file's name. Did you mean '{module.removesuffix('.py')}:{name}'?")
    if module not in sys.modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # Python adds it for scripts, but not for installed commands
    return resolve_installed(reference)


def resolve_installed(reference: str) -> Any:
    """The object that an installed package has announced as ``"package.module:NAME"``; errors as `resolve`."""
    module, _, name = reference.partition(":")
    value: Any = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(value, part):
            near = closest(part, dir(value))
            hint = f". Did you mean {near!r}?" if near else ""
            raise ImportError(f"{reference!r} does not exist: there is no {part!r} in {module}{hint}")
        value = getattr(value, part)
    return value


def reference_in_folder(text: object, definition: re.Pattern[str]) -> str:
    """The reference that a text such as "mine" or "mine.py" probably stands for, if the working folder has mine.py.

    It refers to the first object in that file whose `definition` begins a line and names it in its first group. The
    file is read and not imported. Empty if there is none.
    """
    name = text.partition(":")[0].removesuffix(".py") if isinstance(text, str) else ""
    file = Path(f"{name}.py")
    if not name.isidentifier() or len(name) > _LONGEST or not file.is_file():
        return ""
    found = definition.search(file.read_text(encoding="utf-8", errors="replace"))
    return f"{name}:{found[1]}" if found else ""


def source_of(reference: str) -> Path | None:
    """The file of the module that a reference names, if the module was imported from one."""
    file = getattr(sys.modules.get(reference.partition(":")[0]), "__file__", None)
    return Path(file) if file and Path(file).is_file() else None


def source_digest(reference: str) -> str:
    """The SHA-256 of the module that a reference names; empty if it was not imported from a file."""
    source = source_of(reference)
    return "" if source is None else hashlib.sha256(source.read_bytes()).hexdigest()


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


def place(error: BaseException, *, full: bool = True) -> str:
    """The last place from which the error came in the user's code, or else in another package than this, if any.

    With `full`, the file's folder is named, too.
    """
    frames = [frame for frame in extract_tb(error.__traceback__) if _is_theirs(frame.filename)]
    if not frames:
        return ""
    last = next((frame for frame in reversed(frames) if "site-packages" not in Path(frame.filename).parts), frames[-1])
    file = Path(last.filename)
    return f" ({file if full else file.name}, line {last.lineno})"


def _is_theirs(file: str) -> bool:
    if file.startswith((_PACKAGE, "<")):
        return False
    return "site-packages" in Path(file).parts or not file.startswith(_STANDARD_LIBRARY)
