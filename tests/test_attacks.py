"""Files that cost much more to read than to write are refused, or read within bounds."""

from __future__ import annotations

import pytest

from tests.helpers.attacks import ATTACKS, cost

LONGEST = ("zeros", "runs")


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.weekly) if name in LONGEST else name for name in ATTACKS]
)
def test_a_strangers_file_takes_bounded_time_and_memory(name: str) -> None:
    attack, spent = ATTACKS[name], cost(name)
    assert spent.code is not None, "it was stopped"
    assert attack.says in spent.said
    assert "Traceback" not in spent.said
    assert spent.seconds < attack.seconds
    assert spent.megabytes < attack.megabytes
