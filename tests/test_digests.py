"""The evaluation scenes are the same on every machine and in every version: golden digests.

If this fails and you did not mean to change any scene, you changed the order of some draws, the placement
or the geometry. If you did mean to, see `regenerate_digests`.
"""

from __future__ import annotations

import pytest
from regenerate_digests import digest, golden

from magical_mj.registry import ENVIRONMENTS


def test_there_is_a_digest_for_every_environment() -> None:
    assert list(golden()["digests"]) == [f"{task}-{variant}" for task, variant in ENVIRONMENTS]


@pytest.mark.parametrize(("task", "variant"), ENVIRONMENTS)
def test_the_scenes_of_seeds_0_to_99_are_the_golden_ones(task: str, variant: str) -> None:
    assert digest(task, variant) == golden()["digests"][f"{task}-{variant}"]
