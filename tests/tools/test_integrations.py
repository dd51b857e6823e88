"""The runs with other libraries: their table, and the list of what is skipped without them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import integrations, skips
from tools.pages import filled


def test_the_table_is_that_of_the_runs() -> None:
    page = integrations.PAGE.read_text(encoding="utf-8")
    assert filled(page, integrations.tables(), "make integrations-test") == page
    titles, known = (
        [one["title"] for one in integrations.LIBRARIES.values()],
        [row["library"] for row in integrations.rows()],
    )
    assert known == titles
    assert all(row["compared"] and row["seconds"] for row in integrations.rows() if row["version"])
    assert all(row["version"] or row["result"].startswith("not installed: ") for row in integrations.rows())


def test_two_libraries_in_turn_are_others_each_day() -> None:
    days = [integrations.chosen(["turn"], day) for day in range(len(integrations.LIBRARIES))]
    assert all(len(set(names)) == integrations.IN_TURN for names in days)
    assert {name for names in days for name in names} == {
        name for name, library in integrations.LIBRARIES.items() if library.get("turn")
    }


REPORT = """<testsuites><testsuite><testcase classname="tests.a" name="test_a"><skipped message="{}"/></testcase>
<testcase name="tests.b"><skipped message="collection skipped">
('b.py', 3, "Skipped: b's is missing: make integrations-test LIBRARY=b")</skipped></testcase>
</testsuite></testsuites>"""


def test_skips_name_where_their_tests_run(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "tests.xml"
    monkeypatch.setattr("sys.argv", ["skips", str(file)])
    file.write_text(REPORT.replace("\n", " ").format("could not import 'x': No module named 'x'"))
    skips.main()
    assert capsys.readouterr().out.count("; runs: ") == 2
    file.write_text(REPORT.replace("\n", " ").format("it is broken"))
    with pytest.raises(SystemExit, match=r"does not know where these run: it is broken$"):
        skips.main()
