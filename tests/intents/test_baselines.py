"""The table of baselines in docs/intents.md, and the sentences about it, are those of docs/intent-baselines.csv."""

from __future__ import annotations

from tools.intent_baselines import BASELINES, PAGE, baselines, stored
from tools.tables import filled

TEXT = PAGE.read_text("utf-8")


def test_the_page_has_the_table_of_the_file() -> None:
    assert filled(TEXT, {"baselines": baselines(stored())}, "python -m tools.intent_baselines") == TEXT


def test_the_file_has_whole_rows() -> None:
    means = stored()
    for name in {mean.baseline for mean in means}:
        own = [mean for mean in means if mean.baseline == name]
        assert len({mean[:-1] for mean in own}) == len(own) == BASELINES[name].intents * 5 * 3
        assert all(0.0 <= mean.score <= 1.0 for mean in own)
