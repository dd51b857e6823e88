"""The episodes of `relational` in fresh scenes are complete, in scenes that no result has used, and replay."""

from __future__ import annotations

from collections import Counter

from magical_mj.evaluation.replay import replay
from magical_mj.tasks.registry import SPLITS, environments
from tools.fresh_scenes import FRESH, tasks
from tools.stored_episodes import stored


def test_the_episodes_are_of_fresh_scenes_and_replay() -> None:
    episodes = stored(FRESH)
    assert Counter((one.task, one.variant) for one in episodes) == dict.fromkeys(environments(tasks()), 100)
    assert {one.seed for one in episodes} == {SPLITS["fresh"] + number for number in range(100)}
    chosen = [next(one for one in episodes if (one.task, one.variant) == (task, "All")) for task in tasks()]
    assert [problem for *_, problem in replay((("", one) for one in chosen), jobs=1)] == [None] * len(chosen)
