"""Plug-ins of installed packages: the same checks and errors for every kind."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from magical_mj.utils.errors import MissingExtraError, SettingsError, UnknownNameError
from magical_mj.utils.imports import announced, imported

POINTS = """
[toys]
ours = toys:GOOD
two words = toys:GOOD
module = toys
good = toys : GOOD
absent = toys:ABSENT
gone = no_such_toys:GOOD
broken = broken_toys:GOOD
extra = extra_toys:GOOD
"""


def test_invalid_ones_are_ignored_and_errors_are_this_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "toys.py").write_text("GOOD = 3")
    (tmp_path / "broken_toys.py").write_text("import sys; sys.exit(3)")
    (tmp_path / "extra_toys.py").write_text(
        "from magical_mj.utils.errors import MissingExtraError; raise MissingExtraError('install it')"
    )
    about = tmp_path / "toys-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toys\nVersion: 1\n")
    (about / "entry_points.txt").write_text(POINTS)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.warns(UserWarning, match="is ignored") as caught:
        found = announced("toy", "toys", ("ours",), re.compile(r"\w+").fullmatch, 'ball = "toys:BALL"')
    assert [str(warning.message).partition(" is ignored: ")[2] for warning in caught] == [
        'it must refer to an object in a module, as in ball = "toys:BALL"',
        "another toy has this name",
        "the name of a toy must consist of letters and digits",
    ]
    assert sorted(found) == ["absent", "broken", "extra", "gone", "good"]
    assert (
        imported("toy", "good", found["good"], SettingsError) == imported("toy", "toys:GOOD", None, SettingsError) == 3
    )
    for name, kind, message in (
        ("absent", UnknownNameError, "the toy 'absent' cannot be imported: 'toys:ABSENT' does not exist"),
        ("gone", UnknownNameError, "the toy 'gone' cannot be imported: No module named 'no_such_toys'"),
        ("broken", SettingsError, "the toy 'broken' cannot be imported: SystemExit: 3"),
        ("extra", MissingExtraError, "install it"),
    ):
        with pytest.raises(kind, match=message):
            imported("toy", name, found[name], SettingsError)
