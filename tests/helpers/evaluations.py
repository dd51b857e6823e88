"""Helpers for tests of evaluations: small evaluations, their reproducible results, and made-up scores."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import magical_mj
from magical_mj.evaluation.scores import SCORES, EpisodeResult, read

if TYPE_CHECKING:
    import pandas as pd

SMALL: dict[str, Any] = {"tasks": "MoveToRegion", "variants": "Demo,Layout", "episodes": 3, "preset": "State"}
TEMPLATE: Final = EpisodeResult(
    policy="BC_4 & more",
    run=0,
    task="FindDupe",
    variant="Demo",
    seed=0,
    score=0.0,
    steps=3,
    seconds=0.1,
    rules="paper",
    preset="LoRes4E",
    version="0.1.0",
    mujoco="3.17.0",
    gl="egl",
    actions="aba",
)


def evaluate(policy: Any, **settings: Any) -> pd.DataFrame:
    """A small evaluation without pictures, which are slow. The result has no durations, so it is reproducible."""
    return magical_mj.evaluate(policy, **{**SMALL, **settings}).drop(columns="seconds")


def rows(folder: Path) -> set[tuple[Any, ...]]:
    return {(score.key, score.score, score.actions, score.failure) for score in read(folder)}


def example() -> list[EpisodeResult]:
    """Two runs of a method, which lacks an environment and fails once, and one of noop, with four episodes each."""
    rng = np.random.default_rng(0)
    scores = []
    for run, task, variant in product((0, 1), ("MoveToCorner", "MoveToRegion"), ("Demo", "Jitter", "All")):
        if (task, variant) != ("MoveToRegion", "All"):
            chance = {"Demo": 0.9, "Jitter": 0.6, "All": 0.2}[variant]
            for seed in range(4):
                drawn = float(rng.random() < chance) / (1 + run)
                scores.append(replace(TEMPLATE, run=run, task=task, variant=variant, seed=seed, score=drawn))
    scores[3] = replace(scores[3], score=0.0, failure="ValueError: 50% of {it} is_missing")
    for task, variant, seed in product(("MoveToCorner", "MoveToRegion"), ("Demo", "Jitter", "All"), range(4)):
        noop = replace(TEMPLATE, policy="noop", preset=None, task=task, variant=variant, seed=seed)
        scores.append(replace(noop, score=0.25 * (seed == 0)))
    return scores


def write(folder: Path, scores: list[EpisodeResult]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / SCORES).write_text("".join(score.line() for score in scores))
    return folder
