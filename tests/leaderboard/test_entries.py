"""Entries of the leaderboard: what they say, what is refused, and that they are replayed."""

from __future__ import annotations

import gzip
import hashlib
import json
import lzma
import os
import re
from pathlib import Path
from typing import Any

import pytest
from msgspec.structs import replace

import magical_mj
from magical_mj.evaluation.entry import MOST_UNPACKED, Card, Demonstrations, Training, packed, unpacked
from magical_mj.leaderboard import read_entry, submit
from magical_mj.utils.errors import EvaluationError
from tests.helpers.entries import EPISODES, check, recorded, rewrite, whole

CARD = """
method = "Oracle"
links = ["https://example.org/oracle"]
hardware = "two cores"
[demonstrations]
set = 1
per_task = 10
[training]
hours = 1.5
"""


def test_an_entry_says_everything_and_checks(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "card.toml").write_text(CARD)
    path = tmp_path / "entry.json.xz"
    submitted = submit([folder], path, card=tmp_path / "card.toml")
    entry, findings = check(path, most=None)
    assert packed(entry) == packed(submitted) == path.read_bytes()
    assert (findings.episodes, findings.differing, findings.unfit) == (EPISODES, [], [])
    assert entry.card == Card(
        "Oracle",
        links=["https://example.org/oracle"],
        demonstrations=Demonstrations(set=1, per_task=10),
        training=Training(hours=1.5),
        hardware="two cores",
    )
    assert (entry.observations, entry.rules, entry.protocol, entry.runs) == (None, "paper", 1, [0])
    assert entry.versions.version == [magical_mj.__version__]
    with pytest.raises(FileExistsError):
        submit([folder], path)


def test_the_same_entry_has_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        submit([folder], tmp_path / f"{name}.json.xz")
        rewrite(folder, list.reverse)
    assert (tmp_path / "a.json.xz").read_bytes() == (tmp_path / "b.json.xz").read_bytes()


def content(path: Path) -> dict[str, Any]:
    return json.loads(lzma.decompress(path.read_bytes()))


def resealed(text: bytes) -> bytes:
    """The content of an entry with the proper hash."""
    without = re.sub(rb'"sha256":"[^"]*",', b"", text)
    return text.replace(re.findall(rb'"sha256":"([^"]*)"', text)[0], hashlib.sha256(without).hexdigest().encode())


def columns(environment: str = "FindDupe-All", **changed: list[Any]) -> dict[str, dict[str, list[Any]]]:
    """What a file holds of one episode."""
    episode = {"run": [0], "seed": [0], "scene": [None], "score": [0], "actions": [""], "failure": [None]}
    return {field: {environment: values} for field, values in {**episode, **changed}.items()}


ALTERED: list[tuple[dict[str, Any], str]] = [
    ({"rules": "released"}, "altered"),
    ({"rules": "mine"}, "rules"),
    ({"format": 1}, "format"),
    ({"surprise": 1}, "surprise"),
    ({"episodes": columns("FindDupe-Everything")}, "no environment"),
    ({"episodes": columns("FindDupe-\x1b[2J")}, "no environment"),
    ({"episodes": columns(score=[2])}, "score"),
    ({"episodes": columns(score=["NaN"])}, "score"),
    ({"episodes": columns(seed=[1.0])}, "seed"),
    ({"episodes": columns(score=[])}, "run 1, seed 1, scene 1, score 0"),
    ({"episodes": columns(seed=[0, 1])}, "run 1, seed 2, scene 1"),
    ({"episodes": {**columns(), "run": {"FindDupe-Demo": [0]}}}, "run 0, seed 1"),
    ({"observations": "\ud800"}, "no entry"),
    ({"observations": "State |\n| **Planner ★**"}, "observations"),
]


def test_what_is_no_entry_is_named(folder: Path, tmp_path: Path) -> None:
    path = tmp_path / "entry.json.xz"
    submit([folder], path)
    original = content(path)
    for change, problem in ALTERED:
        text = json.dumps({**original, **change}, sort_keys=True, separators=(",", ":")).encode()
        path.write_bytes(lzma.compress(resealed(text) if change != {"rules": "released"} else text))
        with pytest.raises(EvaluationError, match=problem):
            read_entry(path)
    text = json.dumps(original).encode().replace(b'"hours": null', b'"hours": 1e999')
    path.write_bytes(lzma.compress(text))
    with pytest.raises(EvaluationError, match="hours"):
        read_entry(path)


DAMAGED = {
    "empty": b"",
    "text": b"no",
    "half": lzma.compress(b"[1"),
    "list": lzma.compress(b"[]"),
    "cut": lzma.compress(b"{}")[:-1],
    "longer": lzma.compress(b"{}") + b"{}",
    "another format": gzip.compress(b"{}"),
    "bits": lzma.compress(b"{}")[:10] + b"\xff" * 20,
    "deep": lzma.compress(b"[" * 10**5),
    "bytes": lzma.compress(b" " * (MOST_UNPACKED + 1)),
    "values": lzma.compress(b"[],".join([b""] * 3_000_000)),
}


def test_damaged_files_are_named(tmp_path: Path) -> None:
    """And what is no plain file, and small files that expand to much, in bytes or in values."""
    for name, data in DAMAGED.items():
        (tmp_path / f"{name}.json.xz").write_bytes(data)
    os.mkfifo(tmp_path / "pipe.json.xz")
    (tmp_path / "device.json.xz").symlink_to("/dev/zero")
    problems = {"pipe": "plain file", "device": "plain file", "bytes": "60 MB", "values": "2,000,000 values"}
    for name in {**DAMAGED, **problems}:
        with pytest.raises(EvaluationError, match=problems.get(name, rf"{name}\.json\.xz")):
            read_entry(tmp_path / f"{name}.json.xz")


def test_episodes_that_do_not_count_hide_none_that_do(tmp_path: Path) -> None:
    """A hundred lies among thousands of failures in other scenes; one lie is seen without being played."""
    lies = [recorded(0, "MoveToRegion", "Demo", seed, 0.7, "a" * 40) for seed in range(99)]
    lies.append(recorded(0, "MoveToRegion", "Demo", 99, 0.7, "a"))
    padding = [recorded(0, "MoveToRegion", "Demo", seed, 0.0, "", "no") for seed in range(100, 5_000)]
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[*lies, *padding])))
    findings = check(tmp_path / "entry.json.xz")[1]
    assert findings.episodes == 10
    assert len(findings.differing) == 11
    assert "run 0, MoveToRegion Demo, seed 99: it has 1 actions, and episodes have 40" in findings.differing


def test_a_random_part_is_checked(tmp_path: Path) -> None:
    """A tenth of 100 episodes that all lie; only who knows the seed can tell which."""
    episodes = [recorded(0, "MoveToRegion", "Demo", seed, 0.7, "a" * 40) for seed in range(100)]
    entry = replace(unpacked(packed(whole(runs=1))), episodes=episodes)
    (tmp_path / "entry.json.xz").write_bytes(packed(entry))
    first, again, *others = (check(tmp_path / "entry.json.xz", seed=seed)[1] for seed in (0, 0, 1, None, None))
    assert len(first.differing) == first.episodes == 10
    assert first.differing == again.differing
    assert len({tuple(sorted(findings.differing)) for findings in (first, *others)}) == 4


def test_an_entry_without_the_protocols_scenes_is_not_shown(tmp_path: Path) -> None:
    lone = recorded(0, "MoveToRegion", "Demo", 100, 0.0, "", "ValueError: no")
    (tmp_path / "entry.json.xz").write_bytes(packed(replace(whole(runs=1), episodes=[lone])))
    assert check(tmp_path / "entry.json.xz")[1].unfit == ["none of its episodes starts in the scenes of seeds 0 to 99"]
