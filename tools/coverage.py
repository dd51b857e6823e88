"""How often 95 % intervals contain the true value, in simulated evaluations like those in results/.

    python -m tools.coverage                # the figures of docs/statistics.md, in two minutes

Each simulated method has the scores of a method in results/ with five runs: in each task the same distribution of
scores, and the same variance between runs and between scenes (a Gaussian copula). Its true mean is known. With one run,
an interval should contain the mean of this policy. The last rows compare two methods that are the same.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from functools import cache
from itertools import product
from typing import Final, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

if __name__ == "coverage":  # numba looks for the library of this name, also in scripts next to this file
    raise ImportError("this is tools.coverage")

from magical_mj.evaluation.reports.intervals import Cell, Floats, estimate
from tools.pages import table
from tools.scores import own_methods

RUNS: Final = (1, 2, 3, 5)
NULLS: Final = ((1, 1), (2, 2), (2, 3), (5, 5))
SCENES: Final = (5, 20, 100)
TASKS: Final = (1, 2, 8)
SAMPLES: Final = 1000
PARTS: Final = 1000
"""The number of equal parts of a distribution of scores."""
NORMAL: Final = ndtri((np.arange(PARTS) + 0.5) / PARTS)
TERMS: Final = 30
"""The number of terms of a score's expansion in Hermite polynomials."""
TOGETHER: Final = 0.98
"""The largest share of runs and scenes in the variance."""


class Distribution(NamedTuple):
    """The scores of a method in an environment.

    Attributes:
        scores: the score of each part, ascending.
        run: the correlation of the normal variables of one run's episodes.
        scene: that of episodes in one scene.
    """

    scores: Floats
    run: float
    scene: float

    @property
    def mean(self) -> float:
        """The true mean of the method."""
        return float(self.scores.mean())

    def at(self, normal: Floats) -> Floats:
        """The scores of standard normal values."""
        return self.scores[(ndtr(normal) * PARTS).astype(int).clip(0, PARTS - 1)]

    def mean_of(self, policy: float) -> float:
        """The true mean of one run, given by its normal variable."""
        return float(self.at(np.sqrt(self.run) * policy + np.sqrt(1 - self.run) * NORMAL).mean())

    def drawn(self, rng: np.random.Generator, policies: Floats, scenes: Floats) -> Floats:
        """An evaluation. Shape (runs, scenes), from the normal variables of each run and of each scene."""
        rest = np.sqrt(1 - self.run - self.scene) * rng.standard_normal((len(policies), len(scenes)))
        return self.at(np.sqrt(self.run) * policies[:, None] + np.sqrt(self.scene) * scenes + rest)


def distribution(scores: Floats) -> Distribution:
    """The distribution of scores of shape (runs, scenes), with the variances of runs and of scenes."""
    runs, scenes = scores.shape
    by_run, by_scene = scores.mean(axis=1), scores.mean(axis=0)
    rest = np.square(scores - by_run[:, None] - by_scene + scores.mean()).sum() / ((runs - 1) * (scenes - 1))
    of_runs, of_scenes = by_run.var(ddof=1) - rest / scenes, by_scene.var(ddof=1) - rest / runs
    values = np.quantile(scores, (np.arange(PARTS) + 0.5) / PARTS, method="inverted_cdf")
    total = max(of_runs, 0) + max(of_scenes, 0) + rest
    run, scene = (_correlation(values, part / total if total else 0.0) for part in (of_runs, of_scenes))
    excess = max(1.0, (run + scene) / TOGETHER)
    return Distribution(values, run / excess, scene / excess)


def _correlation(values: Floats, wanted: float) -> float:
    """The correlation of normal variables whose scores have the correlation that is wanted."""
    if wanted <= 0 or np.ptp(values) == 0:
        return 0.0
    squares = np.square(_hermite() @ values / PARTS)
    possible = np.linspace(0, 1, 201)
    reached = (squares * possible[:, None] ** np.arange(1, TERMS + 1)).sum(axis=1) / squares.sum()
    return float(np.interp(wanted, reached, possible))


@cache
def _hermite() -> Floats:
    """The normalised Hermite polynomials from the first degree on. Shape (TERMS, PARTS)."""
    rows = [np.ones(PARTS), NORMAL]
    for degree in range(1, TERMS):
        rows.append((NORMAL * rows[-1] - np.sqrt(degree) * rows[-2]) / np.sqrt(degree + 1))
    return np.stack(rows[1:])


@cache
def methods() -> Sequence[Mapping[str, Distribution]]:
    """Task -> distribution, for each method and variant with five runs of six or more tasks."""
    found: dict[tuple[str, str], dict[str, Distribution]] = {}
    for name, method in own_methods().items():
        for (task, variant), runs in method.episodes.items():
            if len(runs) >= max(RUNS):
                found.setdefault((name, variant), {})[task] = distribution(np.stack([*runs.values()]))
    return [tasks for tasks in found.values() if len(tasks) >= 6]


def chosen(rng: np.random.Generator, tasks: int) -> dict[str, Distribution]:
    """Some tasks of a random method and variant."""
    method = methods()[int(rng.integers(len(methods())))]
    names = rng.choice([*method], min(tasks, len(method)), replace=False)
    return {str(name): method[str(name)] for name in names}


def contained(runs: int, scenes: int, tasks: int, samples: int = SAMPLES) -> tuple[float, float]:
    """How often an interval contains the true mean, and its mean width."""
    rng = np.random.default_rng([runs, scenes, tasks])
    hits, width = 0, 0.0
    for _ in range(samples):
        cells, truth = list[Cell](), 0.0
        method = chosen(rng, tasks)
        for task, scores in method.items():
            policies = rng.standard_normal(runs)
            drawn = scores.drawn(rng, policies, rng.standard_normal(scenes))
            cells.append(Cell(drawn, 1 / len(method), task, task))
            truth += (scores.mean if runs > 1 else scores.mean_of(float(policies[0]))) / len(method)
        found = estimate(cells)
        hits += found.low - 1e-9 <= truth <= found.high + 1e-9
        width += found.high - found.low
    return hits / samples, width / samples


def told_apart(runs: tuple[int, int], scenes: int, tasks: int, samples: int = SAMPLES) -> tuple[float, float]:
    """How often the interval of the difference of two equal methods excludes 0, and its mean width.

    With one run each, the methods are the same policy.
    """
    rng = np.random.default_rng([*runs, scenes, tasks])
    decided, width = 0, 0.0
    for _ in range(samples):
        cells = list[Cell]()
        method = chosen(rng, tasks)
        for task, scores in method.items():
            normal, policy = rng.standard_normal(scenes), rng.standard_normal(1)
            for sign, count in zip((1, -1), runs, strict=True):
                policies = policy if runs == (1, 1) else rng.standard_normal(count)
                cells.append(Cell(scores.drawn(rng, policies, normal), sign / len(method), (sign, task), task))
        found = estimate(cells)
        decided += found.decided
        width += found.high - found.low
    return decided / samples, width / samples


def tables(samples: int) -> str:
    """The table."""
    header = ("Runs", "Scenes", *(f"{count} task{'s' if count > 1 else ''}" for count in TASKS))
    rows: list[Sequence[str]] = [("**Contains the true mean (mean width)**", *[""] * (len(header) - 1))]
    for runs, scenes in product(RUNS, SCENES):
        rows.append((str(runs), str(scenes), *(_cell(contained(runs, scenes, tasks, samples)) for tasks in TASKS)))
    rows.append(("**Excludes 0 for equal methods (mean width)**", *[""] * (len(header) - 1)))
    for both, scenes in product(NULLS, SCENES):
        cells = (_cell(told_apart(both, scenes, tasks, samples)) for tasks in TASKS)
        rows.append((" and ".join(map(str, both)), str(scenes), *cells))
    return table(header, rows)


def _cell(measured: tuple[float, float]) -> str:
    return "{:.3f} ({:.2f})".format(*measured)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--samples", type=int, default=SAMPLES, help="simulated evaluations for each number")
    print(tables(parser.parse_args().samples))
