"""A choice of environments, for what may depend on the task and on the variant, but on no pair of them alone."""

from __future__ import annotations

from typing import Final

from magical_mj import ENVIRONMENTS, TASKS, VARIANTS


def _some(offset: int) -> tuple[tuple[str, str], ...]:
    """An environment of each task."""
    of_tasks = [[pair for pair in ENVIRONMENTS if pair[0] == task] for task in TASKS]
    return tuple(pairs[(index + offset) % len(pairs)] for index, pairs in enumerate(of_tasks))


EACH: Final = _some(0)
"""Each task once, in another variant."""
TWO_EACH: Final = EACH + _some(4)
"""Each task twice."""
assert {variant for _, variant in EACH} == {*VARIANTS}
assert len({*TWO_EACH}) == 2 * len(TASKS)
