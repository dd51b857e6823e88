"""Importing the original's released demonstrations, gzipped pickles named ``demo-*.pkl.gz``, without running them.

Such a file contains a dict: `env_name`, such as "FindDupe-Demo-v0"; `trajectory`, a record of `acts` (the numbers of
actions, shape (steps,)), pictures and other arrays; and, in some files, `score`. A pickle can run any code when it is
loaded. So the unpickler accepts only plain containers, records and arrays of numbers, and imports nothing. It keeps the
arguments and the state of records and arrays, and this module reads the numbers in them.

Only the actions are used. They are replayed from our demo scene, and the demonstration contains the states and the
score of this replay.
"""

from __future__ import annotations

import contextlib
import gzip
import io
import math
import pickle
import pickletools
import zlib
from collections.abc import Iterator, Mapping
from itertools import product
from pathlib import Path
from typing import Any, ClassVar, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from magical_mj.actions import ACTIONS
from magical_mj.demos.demonstration import Demonstration
from magical_mj.demos.recording import replayed
from magical_mj.tasks import SPECS
from magical_mj.utils import files
from magical_mj.utils.errors import DemonstrationError, as_integer, short_repr

SUFFIX: Final = ".pkl.gz"
MOST_PACKED: Final = 200_000_000
"""The size of the largest file that is read."""
MOST_UNPACKED: Final = 500_000_000
"""The size of the largest content: pictures of 384 x 384 take about 200 MB in the longest episodes."""
MOST_OPERATIONS: Final = 60_000
"""The largest number of operations in a pickle, and so of its objects. Longest episodes with a dict, several arrays and
numbers for each step have 20,000. Far more would take gigabytes, or, as keys with equal hashes, hours."""
MOST_NAMES: Final = 100
"""The largest number of different names that a pickle refers to."""
RECORDS: Final = ("magical", "imitation")
"""The packages whose records a file may hold."""
ARRAYS: Final = ("numpy.core.multiarray", "numpy._core.multiarray", "numpy.core.numeric", "numpy._core.numeric")
KEPT: Final = frozenset(
    {
        *product(ARRAYS, ("_reconstruct", "_frombuffer", "scalar")),
        ("numpy", "dtype"),
        ("numpy", "ndarray"),
        ("_codecs", "encode"),
    }
)
"""The functions and classes (module, name) that a file may refer to, to describe arrays of numbers."""
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
    array = _numbers(score)
    if array is not None:
        score = array.tolist()
    score = float(score) if isinstance(score, float | int) and math.isfinite(score) else None
    actions, steps = _actions(path, content["trajectory"]), SPECS[task].horizon()
    if len(actions) > steps:
        raise DemonstrationError(f"{path} has {len(actions)} actions, and episodes of {task} have {steps}")
    return Original(replayed(task, variant, 0, actions, "human"), score)


def _actions(path: Path, trajectory: Any) -> list[int]:
    """The actions of a trajectory: its field `acts`. Without this name, the only field with a row of action numbers."""
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
    """The fields of a trajectory: names and values, or indices and values if the fields have no names."""
    parts = [trajectory]
    if isinstance(trajectory, _Kept):
        state = trajectory.state
        parts = [trajectory.args, *(state if isinstance(state, tuple) else [state])]  # a tuple if there are slots
    for part in parts:
        if isinstance(part, Mapping):
            yield from part.items()
        elif isinstance(part, list | tuple):
            yield from enumerate(part)


def _row(part: Any) -> list[int] | None:
    """The integers of an array, a list or a tuple. None for anything else."""
    array = _numbers(part)
    if array is not None:
        return array.tolist() if array.ndim == 1 and array.dtype.kind in "iu" else None
    if not isinstance(part, list | tuple):
        return None
    integers: list[int] = []
    for entry in part:
        scalar = _numbers(entry)
        integer = as_integer(entry if scalar is None else scalar[()])
        if integer is None:
            return None
        integers.append(integer)
    return integers


def loaded(path: Path) -> Any:
    """The content of a gzipped pickle, with records and arrays as `_Kept`.

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
        return _Unpickler(content).load()
    except pickle.UnpicklingError as error:
        raise DemonstrationError(f"{path} is refused: {error}") from None
    except Exception as error:  # noqa: BLE001 - damaged pickles raise any type
        raise DemonstrationError(
            f"{path} is not a pickle of a demonstration: {type(error).__name__}: {error}"
        ) from None


def _check_opcodes(content: bytes) -> None:
    """Raises an `UnpicklingError` for operations that plain containers and arrays do not need, and for too many.

    Large numbers in the memo would take any amount of memory.
    """
    for count, (operation, argument, _) in enumerate(pickletools.genops(content)):
        if count >= MOST_OPERATIONS:
            raise pickle.UnpicklingError(f"it has more than {MOST_OPERATIONS:,} operations, the limit")
        if operation.name in BANNED:
            raise pickle.UnpicklingError(
                f"it contains the operation {operation.name}, which demonstrations do not need"
            )
        if operation.name in PUTS and not (isinstance(argument, int) and argument <= count):
            raise pickle.UnpicklingError("its memo is damaged")


class _Unpickler(pickle.Unpickler):
    """Imports nothing: for each allowed name in the file, the arguments and the state are kept."""

    def __init__(self, content: bytes) -> None:
        super().__init__(io.BytesIO(content))
        self._kinds: dict[tuple[str, str], type] = {}

    def find_class(self, module: str, name: str, /) -> Any:
        if (module, name) == ("collections", "OrderedDict"):
            return dict
        if (module, name) in self._kinds:
            return self._kinds[module, name]
        if len(self._kinds) == MOST_NAMES:
            raise pickle.UnpicklingError(f"it refers to more than {MOST_NAMES} names, the limit")
        is_record = module.partition(".")[0] in RECORDS and name.isidentifier()
        if is_record or (module, name) in KEPT:
            kind = type(name, (_Kept,), {"maker": "record" if is_record else name})
            self._kinds[module, name] = kind
            return kind
        raise pickle.UnpicklingError(
            f"it refers to {module}.{name}, and demonstrations are read without running code: only arrays and plain "
            "containers are allowed"
        )


class _Kept:
    """The arguments of a class or function in a pickle, and the state of its result."""

    maker: ClassVar[str]
    """The name of the class or function, or "record" for those of the original."""
    args: tuple[Any, ...]
    state: Any = None

    def __new__(cls, *args: Any) -> Self:
        kept = super().__new__(cls)
        kept.args = args
        return kept

    def __setstate__(self, state: Any) -> None:
        self.state = state


def _numbers(part: Any) -> NDArray[Any] | None:
    """The array of numbers that a part of a pickle describes. None if it is damaged, or something else."""
    match part:
        case _Kept(maker="_reconstruct" | "ndarray", state=(_, shape, kind, False, content)):
            pass
        case _Kept(maker="_frombuffer", args=(content, kind, shape, "C")):
            pass
        case _Kept(maker="scalar", args=(kind, content)):
            shape = ()
        case _:
            return None
    match content:
        case _Kept(maker="encode", args=(str() as text, _)):  # bytes in pickles of protocol 2
            content = text.encode("latin-1", "ignore")
    match kind:
        case _Kept(maker="dtype", args=(str() as name, *_), state=(_, "<" | ">" | "|" as order, *_)) if name in DTYPES:
            with contextlib.suppress(TypeError, ValueError, OverflowError):
                return np.frombuffer(content, np.dtype(name).newbyteorder(order)).reshape(shape)
    return None
