"""Files of lines: what a kill or a full disk leaves, and lines without end."""

from __future__ import annotations

from pathlib import Path

import pytest

from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.lines import LONGEST_LINE, appending, read_lines
from tests.helpers.limits import full_disk

LINE = b'{"time": 1, "event": "offer"}\n'


def lines_in(path: Path) -> list[bytes]:
    return [line for _, line in read_lines(path, EvaluationError)]


@pytest.mark.parametrize("room", [0, 1, len(LINE) - 1, len(LINE), len(LINE) + 9])
def test_after_a_full_disk_only_whole_lines_remain_and_more_can_follow(tmp_path: Path, room: int) -> None:
    path = tmp_path / "log.jsonl"
    with appending(path) as log:
        log.append(LINE, durable=True)
        with full_disk(len(LINE) + room), pytest.raises(OSError, match=r"too large.*log\.jsonl"):
            log.append(LINE * 2, durable=True)
        whole = [LINE] * (1 + room // len(LINE))
        assert path.read_bytes() == b"".join(whole)
        log.append(LINE)
    assert lines_in(path) == [*whole, LINE]


def test_an_incomplete_last_line_is_ignored_and_removed(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    for half in (b"{", LINE[:-1], b"\0" * 100_000):
        path.write_bytes(LINE + half)
        assert lines_in(path) == [LINE]
        with appending(path) as log:
            log.append(LINE)
        assert lines_in(path) == [LINE, LINE]


def test_a_file_that_lost_its_line_ends_is_not_taken_for_an_incomplete_line(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    path.write_bytes(LINE.strip() * 3)
    assert lines_in(path) == [LINE.strip() * 3]  # its reader says that this line is wrong
    with appending(path):
        pass
    assert path.read_bytes() == LINE.strip() * 3


def test_a_line_without_end_is_refused_before_it_fills_the_memory(tmp_path: Path) -> None:
    path = tmp_path / "log.jsonl"
    with path.open("wb") as file:
        file.truncate(10**12)  # a sparse file
    with pytest.raises(EvaluationError, match=f"line 1: it has more than {LONGEST_LINE:,} bytes"):
        lines_in(path)
