"""Importing the original's released demonstrations, gzipped pickles named ``demo-*.pkl.gz``, without running them.

Such a file holds a dict: `env_name`, such as "FindDupe-Demo-v0"; `trajectory`, a record of `acts` (the numbers of
actions, shape (steps,)), pictures and other arrays; and, in some files, `score`. A pickle can run any code when it is
loaded. So these are read by an unpickler that knows plain containers and arrays of numbers alone: no name in the file
is imported, and stand-ins take the places of numpy's arrays and of the original's records.

Only the actions are used. They are played again from our demo scene, and the demonstration holds the states and the
score of this replay.
"""

from __future__ import annotations

import gzip
import io
import math
import pickle
import pickletools
import zlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import replayed
from magical_mj.scene.actions import ACTIONS
from magical_mj.tasks import SPECS
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, as_integer, short_repr

SUFFIX: Final = ".pkl.gz"
MOST_PACKED: Final = 200_000_000
"""The size of the largest file that is read."""
MOST_UNPACKED: Final = 500_000_000
"""The size of the largest content: pictures of 384 x 384 take about 200 MB in the longest episodes."""
RECORDS: Final = ("magical", "imitation")
"""The packages whose records a file may hold."""
ARRAYS: Final = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
DTYPES: Final = frozenset({"b1", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"})
PUTS: Final = frozenset({"PUT", "BINPUT", "LONG_BINPUT"})
BANNED: Final = frozenset(
    {"PERSID", "BINPERSID", "EXT1", "EXT2", "EXT4", "INST", "OBJ", "NEXT_BUFFER", "READONLY_BUFFER"}
)


class Original(NamedTuple):
    """A demonstration of the original, replayed here."""

    demonstration: Demonstration
    score: float | None
    """The score that the file records, in the original's simulation; None if it records none."""


def from_original(path: Path | str) -> Original:
    """Replays a demonstration that was released with the original.

    Args:
        path: a file such as ``demo-FindDupe-2020-...pkl.gz``.

    Raises:
        DemonstrationError: if the file is not such a demonstration, refers to code, is too large, or does not start in
            the demo scene of a task.
        OSError: if it cannot be read.
    """
    path = files.to_path(path)
    content = loaded(path)
    if not isinstance(content, Mapping) or not {"env_name", "trajectory"} <= content.keys():
        raise DemonstrationError(f"{path} holds no demonstration: it lacks env_name and trajectory")
    name = content["env_name"]
    task, variant, *_ = f"{name}-".split("-") if isinstance(name, str) else ("", "")
    if task not in SPECS or variant != "Demo":
        raise DemonstrationError(
            f"{path} is of {short_repr(name)}: only episodes in the demo scenes of {', '.join(SPECS)} "
            "can be replayed, since others started in unknown scenes"
        )
    score = content.get("score")
    score = float(score) if isinstance(score, float | int) and math.isfinite(score) else None
    actions, steps = _actions(path, content["trajectory"]), SPECS[task].horizon()
    if len(actions) > steps:
        raise DemonstrationError(f"{path} has {len(actions)} actions, and episodes of {task} have {steps}")
    return Original(replayed(task, variant, 0, actions, "human"), score)


def _actions(path: Path, trajectory: Any) -> list[int]:
    """The actions of a trajectory: what is called `acts`, or the only row of numbers of actions."""
    fields = dict(_fields(trajectory))
    rows = fields.get("acts")
    if rows is None:
        found = [part for part in fields.values() if (row := _row(part)) and min(row) >= 0 and max(row) < len(ACTIONS)]
        rows = found[0] if len(found) == 1 else None
    actions = _row(rows)
    if not actions or min(actions) < 0 or max(actions) >= len(ACTIONS):
        raise DemonstrationError(f"{path} has no actions: acts must be a row of numbers in 0..{len(ACTIONS) - 1}")
    return actions


def _fields(trajectory: Any) -> Iterator[tuple[Any, Any]]:
    if isinstance(trajectory, Mapping):
        yield from trajectory.items()
    elif isinstance(trajectory, tuple | list):
        yield from enumerate(trajectory)
    elif (state := getattr(trajectory, "__dict__", None)) is not None:
        parts = state.get("parts")
        yield from enumerate(parts if isinstance(parts, tuple) else ())
        yield from state.items()


def _row(part: Any) -> list[int] | None:
    """The integers of a row; None of anything else."""
    if not isinstance(part, list | tuple):
        entries = part.array() if isinstance(part, _Array) else None
        if entries is None or entries.ndim != 1 or entries.dtype.kind not in "iu":
            return None
        return entries.tolist()
    numbers = [as_integer(entry) for entry in part]
    return None if None in numbers else [number for number in numbers if number is not None]


def loaded(path: Path) -> Any:
    """What a gzipped pickle of plain containers and arrays holds; arrays have a method `array`.

    Raises:
        DemonstrationError: if the file holds or refers to anything else, is damaged, or too large.
        OSError: if it cannot be read.
    """
    packed = files.read_foreign(path, most=MOST_PACKED, error=DemonstrationError)
    try:
        with gzip.open(io.BytesIO(packed)) as file:
            content = file.read(MOST_UNPACKED + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise DemonstrationError(f"{path} is damaged, or not compressed by gzip: {error}") from None
    if len(content) > MOST_UNPACKED:
        raise DemonstrationError(f"{path} unpacks to more than {MOST_UNPACKED:,} bytes, which are not read")
    try:
        _check_opcodes(content)
        return _Unpickler(io.BytesIO(content)).load()
    except pickle.UnpicklingError as error:
        raise DemonstrationError(f"{path} is refused: {error}") from None
    except Exception as error:  # noqa: BLE001 - damaged pickles raise any type
        raise DemonstrationError(f"{path} is no pickle of a demonstration: {type(error).__name__}: {error}") from None


def _check_opcodes(content: bytes) -> None:
    """Raises an `UnpicklingError` for operations that plain containers and arrays do not need.

    Large numbers in the memo would take any amount of memory.
    """
    for count, (operation, argument, _) in enumerate(pickletools.genops(content)):
        if operation.name in BANNED:
            raise pickle.UnpicklingError(
                f"it contains the operation {operation.name}, which demonstrations do not need"
            )
        if operation.name in PUTS and not (isinstance(argument, int) and argument <= count):
            raise pickle.UnpicklingError("its memo is damaged")


class _Unpickler(pickle.Unpickler):
    """Knows no names but stand-ins, which are made anew for each file, since a file can change them."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self._known = _stand_ins()

    def find_class(self, module: str, name: str, /) -> Any:
        if (module.partition(".")[0] in RECORDS and name.isidentifier()) or (module, name) in self._known:
            return self._known.get((module, name), self._known["", "record"])
        raise pickle.UnpicklingError(
            f"it refers to {module}.{name}, and demonstrations are read without running code: only arrays and plain "
            "containers are allowed"
        )


class _Record:
    """Takes the place of a record."""

    parts: tuple[Any, ...]

    def __new__(cls, *parts: Any) -> Self:
        record = super().__new__(cls)
        record.parts = parts
        return record


class _DType:
    """Takes the place of a numpy.dtype."""

    def __init__(self, name: Any = "", *_: Any) -> None:
        self.name, self.order = name, "="

    def __setstate__(self, state: Any) -> None:
        self.order = state[1]


class _Array:
    """Takes the place of a numpy.ndarray."""

    def __init__(self, *_: Any) -> None:
        self.state: Any = None

    def __setstate__(self, state: Any) -> None:
        self.state = state

    def array(self) -> NDArray[Any] | None:
        """The array; None if it is damaged, or not one of numbers."""
        try:
            _, shape, kind, by_column, content = self.state
            if kind.name not in DTYPES or not isinstance(content, bytes) or by_column:
                return None
            return np.frombuffer(content, np.dtype(kind.name).newbyteorder(kind.order)).reshape(shape)
        except (TypeError, ValueError, AttributeError):
            return None


def _array(content: Any, kind: Any, shape: Any, order: Any = "C") -> _Array:
    row = _Array()
    row.state = 1, shape, kind, order != "C", bytes(content)
    return row


def _scalar(kind: Any, content: Any = b"") -> Any:
    numbers = _array(content, kind, (-1,)).array()
    return numbers.tolist()[0] if numbers is not None and len(numbers) == 1 else None


def _stand_ins() -> dict[tuple[str, str], Callable[..., Any]]:
    """New ones for records, numpy's types and functions, OrderedDict, and what makes bytes in pickles of protocol 2."""
    kinds = {kind: type(kind.__name__, (kind,), {}) for kind in (_Record, _DType, _Array)}
    known: dict[tuple[str, str], Callable[..., Any]] = {
        ("", "record"): kinds[_Record],
        ("numpy", "dtype"): kinds[_DType],
        ("numpy", "ndarray"): kinds[_Array],
        ("collections", "OrderedDict"): dict,
        ("_codecs", "encode"): lambda text, _: text.encode("latin-1"),
    }
    for module in ARRAYS:
        known[module, "_reconstruct"] = kinds[_Array]
        known[module, "scalar"] = lambda *parts: _scalar(*parts)  # noqa: PLW0108 - a new one for each file
        known[module, "_frombuffer"] = lambda *parts: _array(*parts)  # noqa: PLW0108
    return known
