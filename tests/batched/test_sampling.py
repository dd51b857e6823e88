"""The scenes of batched worlds: sampled here or ahead by workers, they are the same."""

from __future__ import annotations

import numpy as np
import pytest

from magical_mj.batched.scenes import Capacity, SceneSampler

pytestmark = [pytest.mark.xdist_group("warp"), pytest.mark.filterwarnings("default")]


def test_scenes_do_not_depend_on_who_samples_them() -> None:
    """Those of an episode follow from the seed, the world and the episode, whoever ends when."""
    pairs = [("FindDupe", "All")] * 3
    sampled = []
    for workers, order in ((0, [[0, 1, 2], [1], [0, 1, 2]]), (1, [[0, 1, 2], [1], [0, 1, 2]]), (0, [[1], [1], [0, 1]])):
        sampler = SceneSampler(pairs, Capacity(10, 3), workers)
        sampler.seed(7)
        sampled.append([sampler.scenes(worlds) for worlds in order])
        sampler.close()
    for here, there in zip(sampled[0], sampled[1], strict=True):
        np.testing.assert_array_equal(here.poses, there.poses)
    np.testing.assert_array_equal(sampled[2][1].poses[0], sampled[0][1].poses[0])
    np.testing.assert_array_equal(sampled[2][2].poses[0], sampled[0][0].poses[0])


def test_workers_sample_ahead_after_given_seeds_too() -> None:
    pairs = [("MoveToRegion", "All")] * 2
    here, ahead = (SceneSampler(pairs, Capacity(1, 1), workers) for workers in (0, 1))
    for sampler in (here, ahead):
        sampler.seed(3)
        sampler.scenes([0, 1], [8, 9])
    ((begun, _), (same, _)) = ahead._ahead.values()
    assert begun is same
    np.testing.assert_array_equal(begun.result(60).poses, here.scenes([0, 1]).poses)
    ahead.close()
