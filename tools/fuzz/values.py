"""Unexpected inputs: values of all types, JSON that is nearly valid, and damaged files."""

from __future__ import annotations

import copy
import datetime as dt
import decimal
import fractions
import random
from pathlib import Path
from typing import Any, Final

import numpy as np

NUMBERS: Final = (0, -1, 1, 2, 3.5, -0.0, 1e-308, 1e308, -1e308, 1e19, 2**31, 2**63, 2**64, 10**400, -(10**400))
NOT_FINITE: Final = (float("nan"), float("inf"), float("-inf"))
TEXTS: Final = (
    *("", " ", "\0", "\n", "a" * 5000, "../..", "/", "~", "%s", "{}", "[red]x[/red]", "-1", "1e9", "None", "nan"),
    *("MoveToRegion", "Demo", "all", ",", "a,b", "State", "é\u202e\u0301", "\ud800", "os:system", "magical_mj:TASKS"),
    *("1" * 5000, "NaN=x", "=", "x.npz", "x.json.xz", "none", "score", "paper"),
)
JSON: Final = (None, True, False, *NUMBERS, *NOT_FINITE, *TEXTS, [], {}, [[]], {"": None}, [1, 2, 3], {"format": 1})
OTHERS: Final = (
    *(b"", b"\xff\x00", 1j, (), (1, 2), {1}, range(3), object, len, Ellipsis, NotImplemented, bytearray(3)),
    *(decimal.Decimal("NaN"), decimal.Decimal("0.1"), fractions.Fraction(1, 3), Path(), Path("nowhere/x.npz")),
    *(
        dt.date(2020, 1, 1),
        np.float64("nan"),
        np.int64(3),
        np.uint8(200),
        np.bool_(True),
        np.array(1),
        np.ones(3),
    ),
    *(np.zeros((0, 3)), np.array(["a"]), np.array([None]), np.datetime64("NaT"), np.ma.masked, memoryview(b"ab")),
)
TOKENS: Final = (b"NaN", b"-1", b"1e999", b"null", b"true", b'"', b"{", b"]", b"\x00", b"\xff\xfe", b"\n", b"=", b"[x]")


class FindError(Exception):
    """A finding: a result that must not happen."""


def value(rng: random.Random) -> Any:
    """A random value of any type."""
    pool = rng.choice((JSON, OTHERS, NUMBERS, TEXTS))
    value = rng.choice(pool)
    wrap = rng.random()
    return [value] if wrap < 0.05 else (value, value) if wrap < 0.1 else {"scene": value} if wrap < 0.13 else value


def json_value(rng: random.Random) -> Any:
    """A random value that JSON can express."""
    deep: Any = rng.choice(JSON)
    if rng.random() < 0.05:
        for _ in range(rng.choice((3, 100, 300))):
            deep = [deep]
    return deep


def spoilt_tree(tree: Any, rng: random.Random) -> Any:
    """JSON with a few random changes: other values, missing or additional fields, repeated items, changed numbers."""
    tree = copy.deepcopy(tree)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        items = list(_items(tree))
        if not items:
            return tree
        holder, key = rng.choice(items)
        old, how = holder[key], rng.random()
        if isinstance(old, float | int) and abs(old) < 1e300 and how < 0.5:  # larger integers do not fit a float
            holder[key] = rng.choice(
                (old * 10 ** rng.randint(-9, 9), -old, old + rng.gauss(0, 1), round(old, 1), old + 1)
            )
        elif how < 0.75:
            holder[key] = json_value(rng)
        elif how < 0.9:
            del holder[key]
        elif isinstance(holder, list):
            holder += rng.choice(([old], [old] * 30, [json_value(rng)]))
        else:
            holder[f"{key}{rng.choice(('x', ' ', '_'))}"] = holder.pop(key)
    return tree


def _items(tree: Any) -> Any:
    """Yields (container, key) for every value in nested lists and dicts."""
    items = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, item in list(items):
        yield tree, key
        yield from _items(item)


def spoilt_bytes(data: bytes, rng: random.Random) -> bytes:
    """A file's bytes with random damage."""
    if not data or rng.random() < 0.05:
        return rng.choice(
            (b"", b"\0" * 100, b"PK\x03\x04", b"\x1f\x8b\x08", b"{}", b"[]\n", b"null", rng.randbytes(300))
        )
    for _ in range(rng.choice((1, 1, 2, 8))):
        index, how = rng.randrange(len(data) + 1), rng.random()
        if how < 0.25:
            data = data[:index]
        elif how < 0.5:
            data = data[:index] + bytes([rng.randrange(256)]) + data[index + 1 :]
        elif how < 0.7:
            data = data[:index] + rng.choice(TOKENS) + data[index:]
        elif how < 0.85:
            data = data[:index] + data[index + rng.choice((1, 4, 50)) :]
        else:
            length = rng.choice((1, 20, 400))
            data = data[:index] + data[index : index + length] + data[index:]
    return data
