"""What docs/shift-curves.md says about its tables of behavioural cloning follows from them, and they from episodes."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from magical_mj import TASKS
from magical_mj.evaluation.replay import replay
from tools.shift_curves import EPISODES
from tools.stored_episodes import stored

NEVER = "\N{EN DASH}"
PAGE = (Path(__file__).parents[2] / "docs" / "shift-curves.md").read_text("utf-8")


def rows(heading: str) -> dict[str, list[str]]:
    """Axis -> the cells of a table."""
    lines = PAGE.partition(f"| {heading} |")[2].split("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return {name: rest for name, *rest in cells}


def halved(scores: list[float]) -> int | None:
    """The first strength with less than half of the score at strength 0."""
    return next((strength for strength, score in enumerate(scores) if score < scores[0] / 2), None)


def test_the_page_names_the_shifts_that_break_cloning_from_pictures() -> None:
    table = rows("From images, BC, five runs")
    first = {name: halved([float(cell) for cell in cells[:6]]) for name, cells in table.items()}
    assert {name: cells[6].replace(NEVER, "None") for name, cells in table.items()} == {
        n: str(f) for n, f in first.items()
    }
    assert [name for name, strength in first.items() if strength == 2] == ["light", "latency", "texture"]
    assert next(iter(table)) == min(table, key=lambda name: float(table[name][2])) == "light"
    assert {name for name, strength in first.items() if strength is None} == {
        *("sensor", "slip", "palette", "clutter", "friction"),
    }


def test_the_page_names_the_shifts_that_break_cloning_from_states() -> None:
    table = {name: [float(cell) for cell in cells] for name, cells in rows("From states, BC").items()}
    assert halved(table["pose (without MoveToCorner)"]) == 3
    assert 1 - table["latency"][1] / table["latency"][0] > 1 / 3


def test_the_episodes_from_states_are_complete_and_replay() -> None:
    """All axes and strengths in all tasks, 50 episodes each; one of each axis is replayed."""
    episodes = stored(EPISODES)
    counts = Counter((one.task, one.shift) for one in episodes)
    assert set(counts.values()) == {50}
    axes = {one: [shift for task, shift in counts if task == one] for one in TASKS}
    assert {task: len(shifts) for task, shifts in axes.items()} == {
        task: 1 + 5 * (5 - (task == "MoveToCorner")) for task in TASKS
    }
    chosen = [next(one for one in episodes if one.shift == shift) for shift in axes["FindDupe"][1::5]]
    assert [problem for *_, problem in replay((("", one) for one in chosen), jobs=1)] == [None] * 5
