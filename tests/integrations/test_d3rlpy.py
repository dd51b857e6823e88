"""d3rlpy: its behavioural cloning of discrete actions."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tests.helpers.libraries import EPISODES, compare, demonstrations

pytest.importorskip("d3rlpy", reason="d3rlpy is missing: make integrations-test LIBRARY=d3rlpy")

import d3rlpy

pytestmark = pytest.mark.filterwarnings("default")  # the library's own are not ours to mend


def test_discrete_bc_clones_and_scores_the_same_by_both_paths(record_property: Callable[[str, object], None]) -> None:
    data = demonstrations()
    dataset = d3rlpy.dataset.MDPDataset(
        data["observations"],
        data["actions"].astype(np.int32)[:, None],
        np.zeros(len(data["actions"]), np.float32),
        data["terminals"].astype(np.float32),
        data["truncations"].astype(np.float32),
        action_space=d3rlpy.ActionSpace.DISCRETE,
        action_size=18,
    )
    d3rlpy.seed(0)
    learner = d3rlpy.algos.DiscreteBCConfig().create(device="cpu:0")
    learner.fit(dataset, 2000, 2000, show_progress=False, logger_adapter=d3rlpy.logging.NoopAdapterFactory())
    evaluator = d3rlpy.metrics.EnvironmentEvaluator
    compare(
        record_property,
        "`DiscreteBC` on our arrays; scores by `EnvironmentEvaluator`",
        lambda env: [evaluator(env, n_trials=1)(learner, dataset) for _ in range(EPISODES)],
        lambda state: int(learner.predict(state[None])[0]),
    )
