"""References to objects in users' modules, ``"package.module:NAME"``, plug-ins, and errors in users' code.

Importing a module runs its code, so a file from elsewhere must not choose the module. A file may contain only names
that installed packages announce by an entry point, and references that the user has typed in the same call.

- References typed by the user are imported by `resolve`, which also searches the working folder. References that an
  installed package announces are imported by `resolve_installed`, but not from the working folder.
- A name in a file is only text. Before it is resolved, the caller must call `check_named`.

docs/trust.md lists the references that each kind of file may contain.
"""

from __future__ import annotations

import ast
import hashlib
import importlib
import os
import re
import sys
import warnings
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from importlib.machinery import PathFinder
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from sysconfig import get_path
from traceback import extract_tb
from types import MappingProxyType
from typing import Any, Final

from magical_mj.utils.errors import (
    MagicalError,
    MissingExtraError,
    TaskError,
    UnknownReferenceError,
    UntrustedNameError,
    closest,
    short_repr,
)

_REFERENCE: Final = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")
_LONGEST: Final = 100
"""A module with a longer name is not looked for in the working folder."""
_INSTALLED: Final = {"site-packages", "dist-packages"}
"""The names of folders with installed packages."""
_PACKAGE: Final = f"{Path(__file__).parents[1]}{os.sep}"
_STANDARD_LIBRARY: Final = f"{get_path('stdlib')}{os.sep}"


def is_reference(text: object) -> bool:
    """Whether `text` has the form ``"package.module:NAME"``. Nothing is imported."""
    return isinstance(text, str) and _REFERENCE.fullmatch(text) is not None


def check_named(reference: object, origin: object, trusted: Collection[str] = ()) -> None:
    """Raises an `UntrustedNameError` if a name in a file (`origin`) is a reference that the user has not typed.

    Other names are accepted: an announced name belongs to the benchmark or to an installed package.
    """
    if isinstance(reference, str) and is_reference(reference) and reference not in trusted:
        raise UntrustedNameError(reference, origin)


def resolve(reference: str) -> Any:
    """The object of a reference ``"package.module:NAME"`` typed by the user. The working folder is searched as well.

    Raises an `ImportError` if the module or object does not exist. Errors raised by the module itself pass through.
    """
    module, _, name = reference.partition(":")
    if module.endswith(".py"):
        raise ImportError(f"{module} is a file's name. Did you mean '{module.removesuffix('.py')}:{name}'?")
    if module not in sys.modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)  # Python adds it for scripts, but not for installed commands
    return resolve_installed(reference)


def resolve_installed(reference: str) -> Any:
    """The object that an installed package announces as ``"package.module:NAME"``. Raises the errors of `resolve`."""
    module, _, name = reference.partition(":")
    value: Any = importlib.import_module(module)
    for part in name.split("."):
        if not hasattr(value, part):
            near = closest(part, dir(value))
            hint = f". Did you mean {near!r}?" if near else ""
            raise ImportError(f"{reference!r} does not exist: {module} has no {part!r}{hint}")
        value = getattr(value, part)
    return value


def announced(
    noun: str, group: str, taken: Collection[str], is_name: Callable[[str], object], example: str
) -> Mapping[str, EntryPoint]:
    """The entry points of a group by name, except names that are `taken`. Their modules are imported at the first use.

    An invalid entry point is ignored with a warning, so that this package can still be imported. Those of additions of
    this package whose folder is not installed are left out.
    """
    plugins: dict[str, EntryPoint] = {}
    for point in sorted(entry_points(group=group)):
        if _is_left_out(point):
            continue
        if point.name in taken or plugins.get(point.name, point) != point:
            problem = f"another {noun} has this name"
        elif not is_name(point.name):
            problem = f"the name of a {noun} must consist of letters and digits"
        elif not is_reference(reference_of(point)):
            problem = f"it must refer to an object in a module, as in {example}"
        else:
            plugins[point.name] = point
            continue
        warnings.warn(f"the {noun} {point.name!r} ({point.value}) is ignored: {problem}", stacklevel=3)
    return MappingProxyType(plugins)


def _is_left_out(point: EntryPoint) -> bool:
    """Whether an entry point refers to a folder of this package that is not installed."""
    package, _, inner = point.value.partition(".")
    return f"{_PACKAGE}".endswith(f"{os.sep}{package}{os.sep}") and not Path(_PACKAGE, inner.partition(".")[0]).exists()


def imported(noun: str, name: str, point: EntryPoint | None, failed: type[MagicalError]) -> Any:
    """The object of an entry point, or without one, of the user's reference `name`.

    Raises an `UnknownReferenceError` if the module or the object does not exist, and `failed` if the module raises an
    error, unless this is a `MissingExtraError`.
    """
    try:
        return resolve(name) if point is None else resolve_installed(reference_of(point))
    except MissingExtraError:
        raise
    except (Exception, SystemExit) as error:
        why, kind = (error, UnknownReferenceError) if isinstance(error, ImportError) else (with_location(error), failed)
        raise kind(f"the {noun} {short_repr(name)} cannot be imported: {why}") from error


def moved(module: str, *names: str) -> Callable[[str], Any]:
    """A module's `__getattr__` for names that are now in another module, which is imported at their first use."""

    def __getattr__(name: str) -> Any:  # noqa: N807
        if name not in names:
            raise AttributeError(f"no attribute {name!r}")
        return getattr(importlib.import_module(module), name)

    return __getattr__


def reference_of(point: EntryPoint) -> str:
    """An entry point's reference, without the spaces that Python allows in it."""
    return "".join(point.value.split())


def reference_to(kind: type) -> str:
    """The reference of a class, such as "mine:Wrapper"."""
    return f"{kind.__module__}:{kind.__qualname__}"


def reference_in_folder(text: object, definition: re.Pattern[str]) -> str:
    """The reference that a text such as "mine" or "mine.py" probably means, if the working folder contains mine.py.

    Its name is that of the first match of `definition` in the file. Without a match, it is empty. The file is not
    imported.
    """
    name = text.partition(":")[0].removesuffix(".py") if isinstance(text, str) else ""
    file = Path(f"{name}.py")
    if not name.isidentifier() or len(name) > _LONGEST or not file.is_file():
        return ""
    found = definition.search(file.read_text(encoding="utf-8", errors="replace"))
    return f"{name}:{found[1]}" if found else ""


def source_of(reference: str) -> Path | None:
    """The file of a reference's module, if the module was imported from one."""
    file = getattr(sys.modules.get(reference.partition(":")[0]), "__file__", None)
    return Path(file) if file and Path(file).is_file() else None


def source_digest(*references: str) -> str:
    """The SHA-256 of the references' modules, and of all modules outside of installed packages that they import.

    Empty if none was imported from a file. Modules that are imported under a computed name are not found.
    """
    files: dict[Path, bytes] = {}
    waiting = [(reference.partition(":")[0], source_of(reference)) for reference in references]
    while waiting:
        module, file = waiting.pop()
        if file is not None and file not in files:
            files[file] = file.read_bytes()
            waiting += [(name, _own_source(name)) for name in _imports(module, file, files[file])]
    return hashlib.sha256(b"\0".join(sorted(files.values()))).hexdigest() if files else ""


def _imports(module: str, file: Path, content: bytes) -> set[str]:
    """The names of all modules that a file's import statements may mean, also of those in functions."""
    try:
        tree = ast.parse(content) if file.suffix == ".py" else ast.Module([], [])
    except (SyntaxError, ValueError):
        return set()
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    names = {module[:end] for end in _dots(module)}  # the packages around it
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            parts = package.split(".")
            above = parts[: len(parts) - node.level + 1] if node.level else []
            start = ".".join(filter(None, (*above, node.module)))
            names |= {start, *(f"{start}.{alias.name}" for alias in node.names)}
    return names | {name[:end] for name in names for end in _dots(name)}


def _dots(name: str) -> list[int]:
    return [place for place, sign in enumerate(name) if sign == "."]


def _own_source(module: str) -> Path | None:
    """The file of a module if it is neither in an installed package, nor in this one, nor in the standard library."""
    file, path = source_of(module), None
    if module not in sys.modules:
        for end in (*_dots(module), len(module)):
            spec = PathFinder.find_spec(module[:end], path)
            if spec is None:
                return None
            path = spec.submodule_search_locations
            file = Path(spec.origin) if spec.has_location and spec.origin else None
    if file is None or _INSTALLED & {*file.parts} or str(file).startswith((_PACKAGE, _STANDARD_LIBRARY)):
        return None
    return file


@contextmanager
def errors_of_user(what: str, kind: type[MagicalError] = TaskError) -> Iterator[None]:
    """Converts errors of a user's code to this kind, with the text `what` and the error's type, text and location.

    This package's own errors, which such code may raise intentionally, pass through.
    """
    try:
        yield
    except MagicalError:
        raise
    except Exception as error:
        raise kind(f"{what}: {with_location(error)}") from error


def with_location(error: BaseException) -> str:
    """The error's type, message and location."""
    where = "" if isinstance(error, SyntaxError) else location(error)  # its message contains the location
    return f"{type(error).__name__}: {error}{where}"


def location(error: BaseException, *, full: bool = True) -> str:
    """The last location of the error in the user's code, otherwise in another package; empty if it has neither.

    With `full`, it includes the file's folder.
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
