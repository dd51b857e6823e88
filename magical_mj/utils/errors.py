"""The exceptions of this package. Their messages say what was wrong, what is allowed, and what to do.

Each is also the built-in exception that Python raises in such a case, since other libraries try calls and catch it.
"""

from __future__ import annotations

import difflib
import operator
from collections.abc import Iterable, Sequence
from typing import Any, Final

_SHOWN: Final = 80
"""The number of characters of a wrong value that a message shows."""


class MagicalError(Exception):
    """The base of this package's exceptions."""


class UnknownNameError(MagicalError, ValueError):
    """An unknown name, for example of a task, variant, preset, view, policy, method or setting."""


class UnknownArgumentError(UnknownNameError, TypeError):
    """An unknown keyword argument, or an unknown setting, which functions accept as keyword arguments."""


class UnknownReferenceError(UnknownNameError, ImportError):
    """A reference such as "package.module:NAME" whose module or object does not exist."""


class TaskError(MagicalError, ValueError):
    """A user's task that is invalid, or lacks a requested feature, such as a plan."""


class IntentError(MagicalError, ValueError):
    """A text that is not a valid intent, or an intent that no scene satisfies."""


class ShiftError(MagicalError, ValueError):
    """A user's shift that is invalid, or raised an error."""


class InvalidActionError(MagicalError, ValueError):
    """An action that is not one of the 18."""


class InvalidSceneError(MagicalError, ValueError):
    """A scene that is malformed, illegal, or not a scene of the task."""


class InvalidSeedError(MagicalError, ValueError):
    """A seed that is not a non-negative integer."""


class PlacementError(MagicalError, RuntimeError):
    """An object without a legal placement after the allowed number of attempts, or without a position in a plan."""


class DemonstrationError(MagicalError, ValueError):
    """A demonstration that is damaged, of another version or task, or does not match its scene."""


class UntrustedNameError(MagicalError, ValueError):
    """A file that refers to code that the user has not named: see docs/trust.md.

    Attributes:
        reference: the reference, such as "package.module:SPEC".
    """

    def __init__(self, reference: str, origin: object) -> None:
        super().__init__(reference, str(origin))  # the arguments, for pickling
        self.reference = reference

    def __str__(self) -> str:
        reference, origin = self.args
        return (
            f"{origin} refers to {reference}, and using it runs that module's code. If you trust it, name it as well: "
            f"--tasks {reference}, or --trusted {reference} where the command has that option; in Python "
            f"trusted=[{reference!r}]"
        )


class StateError(MagicalError, ValueError):
    """A state that is damaged or does not fit."""


class CopyError(StateError, TypeError):
    """An environment that cannot be copied or pickled."""


class ClosedError(MagicalError, RuntimeError):
    """A call of a closed environment."""


class PhysicsError(MagicalError, RuntimeError):
    """A simulation that became unstable."""


class RenderingError(MagicalError, RuntimeError):
    """A picture that cannot be drawn, since OpenGL does not work on this machine."""


class SettingsError(MagicalError, ValueError):
    """Settings that are invalid, alone or in combination."""


class MissingExtraError(MagicalError, ImportError):
    """A required package that is not installed. The message contains the command that installs it."""


class WorkerError(MagicalError, RuntimeError):
    """Worker processes that died repeatedly, or a cluster that does not respond."""


class EvaluationError(MagicalError, RuntimeError):
    """An evaluation, or the files of one, that cannot be used."""


class TrainingError(MagicalError, RuntimeError):
    """A training run, or its files, that cannot be continued."""


class MissingFileError(FileNotFoundError, SettingsError, TrainingError, EvaluationError, DemonstrationError):
    """A file or folder that does not exist. It is also the error for one that exists and is not usable."""


def unknown_name(kind: str, name: object, allowed: Iterable[str], meant: str = "") -> UnknownNameError:
    """The error for a `name` that is not among the `allowed`. It suggests `meant`, or otherwise the closest name."""
    return UnknownNameError(f"unknown {kind} {short_repr(name)}.{_allowed(name, tuple(allowed), meant)}")


def unknown_argument(name: str, allowed: Iterable[str], meant: str = "") -> UnknownArgumentError:
    """The error for an unknown keyword argument. It begins like Python's, whose text some libraries look for."""
    return UnknownArgumentError(f"unexpected keyword argument {name!r}.{_allowed(name, tuple(allowed), meant)}")


def _allowed(name: object, allowed: Sequence[str], meant: str) -> str:
    meant = meant or closest(name, allowed)
    hint = f" Did you mean {meant!r}?" if meant else ""
    return f"{hint} There are: {', '.join(allowed)}"


def closest(name: object, allowed: Iterable[str]) -> str:
    """The most similar name among the `allowed`, ignoring case. Empty if none is similar."""
    if not isinstance(name, str):
        return ""
    known = {other.lower(): other for other in allowed}
    near = difflib.get_close_matches(name[:_SHOWN].lower(), known, n=1, cutoff=0.5)
    return known[near[0]] if near else ""


def short_repr(value: object) -> str:
    """`value` as text for a message, shortened. Every value is accepted."""
    try:
        text = repr(value)
    except (ValueError, RecursionError):  # integers with thousands of digits, deeply nested lists
        text = f"a value of type {type(value).__name__}"
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def counted(number: int, noun: str) -> str:
    """A number with its noun, such as "1 episode" or "2 episodes"."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


def listing(names: Sequence[str], most: int = 8) -> str:
    """The first `most` names, separated by commas, and the number of all others."""
    rest = len(names) - most
    return ", ".join(names) if rest <= 0 else f"{', '.join(names[:most])} and {rest} more"


def as_integer(value: Any, least: int = 0, most: int | None = None) -> int | None:
    """`value` as an int, or None unless it is an integer from `least` to `most`, and not a bool.

    Integers of numpy and other libraries are accepted, and arrays without dimensions.
    """
    try:
        number = operator.index(value)
    except TypeError:
        return None
    return None if isinstance(value, bool) or number < least or (most is not None and number > most) else number


def check_name(kind: str, name: object, allowed: Iterable[str]) -> None:
    """Raises an `UnknownNameError`, which suggests the closest name, unless `name` is one of the `allowed`."""
    allowed = tuple(allowed)
    if not isinstance(name, str) or name not in allowed:
        raise unknown_name(kind, name, allowed)
