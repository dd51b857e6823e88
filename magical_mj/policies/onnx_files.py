"""What an ONNX file refers to and may run without end, checked before ONNX Runtime reads it.

ONNX files contain no Python code, but a tensor may name another file with its values, and older versions of ONNX
Runtime read any path.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from magical_mj.utils.errors import SettingsError, short_repr
from magical_mj.utils.extras import check_module

ENDLESS: Final = ("Loop",)
"""The operations whose number of rounds the file chooses. `Scan` ends with its input."""


def check_onnx(path: Path, most: int, trust: bool) -> None:
    """Checks an ONNX file that has at most `most` bytes. `trust`: it may have loops.

    Raises:
        MissingExtraError: if the package onnx is missing.
        SettingsError: if it is not an ONNX file, has tensors in files outside of its folder or of more than `most`
            bytes, or has loops without trust.
    """
    check_module("ONNX files", "onnx", "onnx")
    import onnx

    try:
        model = onnx.load(str(path), format="protobuf", load_external_data=False)
    except Exception as error:  # protobuf's errors have no common base class
        raise SettingsError(f"{path} is not a valid ONNX file: {error}") from error
    places = set[str]()
    for message in _messages(model):
        if isinstance(message, onnx.NodeProto) and message.op_type in ENDLESS and not trust:
            raise SettingsError(
                f"{path} has the operation {message.op_type}, which may never end: --trust (trust=True) loads it; use "
                "it only for files that you trust"
            )
        if isinstance(message, onnx.TensorProto) and message.data_location == onnx.TensorProto.EXTERNAL:
            places |= {entry.value for entry in message.external_data if entry.key == "location"}
    _check_places(path, places, most)


def _check_places(path: Path, places: set[str], most: int) -> None:
    """Checks the other files of an ONNX file by their paths, relative to its folder."""
    folder, size = path.parent.resolve(), 0
    for place in sorted(places):
        real = (folder / place).resolve()
        if Path(place).is_absolute() or not real.is_relative_to(folder) or not real.is_file():
            raise SettingsError(
                f"{path} is not read: its folder does not contain {short_repr(place)}, to which it refers"
            )
        size += real.stat().st_size
    if size > most:
        raise SettingsError(f"{path} is not read: its tensors in other files have more than {most:,} bytes")


def _messages(message: Any) -> Iterator[Any]:
    """Yields a protocol buffer and all messages in it."""
    waiting = [message]
    while waiting:
        message = waiting.pop()
        yield message
        for field, value in message.ListFields():
            if field.message_type is not None:
                waiting += [value] if hasattr(value, "ListFields") else value
