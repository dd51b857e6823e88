"""95 % intervals of mean scores, which cover the randomness of scenes and of training.

A figure is a weighted sum of the mean scores of cells: a method's mean over environments, or the difference of two
methods. The runs of a cell have played the same scenes. Two sources of randomness make up the interval:

Scenes. A cell has Wilson's interval with an effective number of scenes, which surveys use for shares near 0 and 1 (Korn
and Graubard, Survey Methodology 1998; Franco et al., J. Surv. Stat. Methodol. 2019). The distances from the cells'
means to their ends are added as squares (Zou and Donner, Stat. Med. 2008). If two cells have the same scenes, the
correlation of their scores enters (Newcombe, Stat. Med. 1998).

Runs. A part of the variance of run means is due to scenes. The rest is the variance between trained policies. A few
runs estimate it badly, so it is averaged with the usual variance of the entries in results/, which counts as `EARLIER`
degrees of freedom (the moderated t statistic: Smyth, Stat. Appl. Genet. Mol. Biol. 2004). Runs in different tasks are
taken as independent: in the entries, the variance of run means over tasks is 1.0 times that of independent tasks for
policies of one task, and 1.2 times for policies of all tasks. With one run, the interval covers scenes only.

``python -m tools.coverage`` measures how often such intervals contain the true value.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

CONFIDENCE: Final = 0.95
USUAL: Final = 0.02
"""The usual variance of a method's run means in an environment, as a share of m (1 - m), with m the mean."""
EARLIER: Final = 2
"""The weight of the usual variance, as degrees of freedom."""
ALIKE: Final = 0.75
"""The usual correlation between the means of a run in two variants of a task."""
SHARED: Final = 0.1
"""The usual share of the variance of scores that all runs have in common, because some scenes are harder."""


class Estimate(NamedTuple):
    """A figure with its 95 % interval; NaN for missing values."""

    value: float
    low: float = np.nan
    high: float = np.nan

    @property
    def decided(self) -> bool:
        """Whether the interval excludes 0."""
        return self.low > 0 or self.high < 0


class Cell(NamedTuple):
    """The scores of a method in an environment.

    Attributes:
        scores: shape (runs, scenes), between 0 and 1. NaN for missing episodes; no row or column is empty.
        weight: the factor of the mean in the figure.
        policies: cells with the same value have the same trained policies in their rows.
        scenes: cells with the same value have the same scenes in their columns.
    """

    scores: Floats
    weight: float
    policies: Hashable
    scenes: Hashable


class _Parts(NamedTuple):
    """The parts of a cell's mean, which is that over runs of the means over scenes.

    Attributes:
        mean: the mean.
        largest: m (1 - m), the largest variance of scores with the mean m, after one more score of 0 and one of 1.
        usual: the usual variance of the mean over runs of the scores in a scene, as a share of `largest`.
        variance: the variance of the mean because of scenes. One more scene, with the usual variance, is added.
        scenes: the deviation of the mean because of each scene. Shape (scenes,).
        runs: the deviation of the mean because of each run. Shape (runs,).
        rest: the remaining deviations. Shape (runs, scenes).
    """

    mean: float
    largest: float
    usual: float
    variance: float
    scenes: Floats
    runs: Floats
    rest: Floats


def mean_over(environments: Iterable[tuple[Hashable, Hashable, Floats]]) -> Estimate:
    """The mean over environments, of equal weight. Each is given by its policies, its scenes and its scores."""
    rows = list(environments)
    return estimate([Cell(scores, 1 / len(rows), policies, scenes) for policies, scenes, scores in rows])


def estimate(cells: Sequence[Cell]) -> Estimate:
    """The weighted sum of the cells' means, with its 95 % interval. The interval is NaN if a cell has one scene."""
    from scipy.special import ndtri, stdtrit  # SciPy's module of statistics takes half a second to import

    parts = [_parts(cell.scores) for cell in cells]
    value = float(sum(cell.weight * part.mean for cell, part in zip(cells, parts, strict=True)))
    if not cells or min(len(part.scenes) for part in parts) < 2:
        return Estimate(value if cells else np.nan)
    runs = _variances_of_runs(cells, parts)
    of_scenes = sum(cell.weight**2 * part.variance for cell, part in zip(cells, parts, strict=True))
    of_runs = sum(variance for variance, _ in runs)
    uncertain = sum(variance**2 / freedom for variance, freedom in runs)  # Satterthwaite
    level = (1 + CONFIDENCE) / 2
    quantile = float(stdtrit((of_scenes + of_runs) ** 2 / uncertain, level) if uncertain else ndtri(level))
    below, above = np.sqrt(_squares_of_scenes(cells, parts, quantile) + quantile**2 * of_runs)
    least, most = (sum(bound(cell.weight, 0.0) for cell in cells) for bound in (min, max))
    return Estimate(value, max(value - float(below), least), min(value + float(above), most))


def _parts(scores: Floats) -> _Parts:
    runs, scenes = scores.shape
    known = ~np.isnan(scores)
    run_means = np.nanmean(scores, axis=1)
    mean = float(run_means.mean())
    smoothed = (scenes * mean + 1) / (scenes + 2)
    largest, usual = smoothed * (1 - smoothed), SHARED + (1 - SHARED) / runs
    deviations = np.where(known, scores - run_means[:, None], 0.0)
    shares = known / (runs * known.sum(axis=1, keepdims=True))  # of each episode in the mean
    by_scene = (shares * deviations).sum(axis=0)
    variance = float(np.square(by_scene).sum()) + usual * largest / scenes**2
    rest = shares * (deviations - deviations.sum(axis=0) / known.sum(axis=0))
    return _Parts(mean, largest, usual, variance, by_scene, (run_means - mean) / runs, rest)


def _variances_of_runs(cells: Sequence[Cell], parts: Sequence[_Parts]) -> list[tuple[float, float]]:
    """For each group of trained policies, the figure's variance because of training, and its degrees of freedom."""
    found = []
    for members in _groups((cell.policies, len(cell.scores)) for cell in cells):
        count = len(cells[members[0]].scores)
        if count == 1:
            continue
        spreads = np.array([cells[i].weight * np.sqrt(parts[i].largest) for i in members])
        usual = USUAL * float(ALIKE * spreads.sum() ** 2 + (1 - ALIKE) * np.square(spreads).sum()) / count
        by_run = sum(cells[i].weight * parts[i].runs for i in members)
        noise = 0.0
        for same in _groups((cells[i].scenes, len(parts[i].scenes)) for i in members):
            rest = np.sum([cells[members[i]].weight * parts[members[i]].rest for i in same], axis=0)
            noise += float(np.square(rest).sum()) * rest.shape[1] / (rest.shape[1] - 1)
        free = count - 1
        observed = max(count / free * (float(np.square(by_run).sum()) - noise), 0.0)
        found.append(((EARLIER * usual + free * observed) / (EARLIER + free), float(EARLIER + free)))
    return found


def _squares_of_scenes(cells: Sequence[Cell], parts: Sequence[_Parts], quantile: float) -> Floats:
    """The squared distances from the figure to the ends of the interval because of scenes. Shape (2,): below, above."""
    squares = np.zeros(2)
    for members in _groups((cell.scenes, len(part.scenes)) for cell, part in zip(cells, parts, strict=True)):
        deviations = np.stack([parts[i].scenes / np.sqrt(parts[i].variance) for i in members])
        correlations = deviations @ deviations.T
        np.fill_diagonal(correlations, 1.0)
        signs = np.sign([cells[i].weight for i in members])
        distances = np.array([_distances(cells[i].weight, parts[i], quantile) for i in members])
        squares += np.einsum("ai,ab,bi->i", distances, correlations * np.outer(signs, signs), distances)
    return squares.clip(min=0)


def _distances(weight: float, part: _Parts, quantile: float) -> tuple[float, float]:
    """How far a cell's part of the figure may be below and above its value by Wilson's interval."""
    spread = part.mean * (1 - part.mean)
    square = quantile**2 * (part.variance / spread if spread > 0 else part.usual / len(part.scenes))
    middle = (part.mean + square / 2) / (1 + square) - part.mean
    half = np.sqrt(square * spread + square**2 / 4) / (1 + square)
    below, above = (half - middle, half + middle) if weight > 0 else (half + middle, half - middle)
    return abs(weight) * float(below), abs(weight) * float(above)


def _groups(keys: Iterable[Hashable]) -> list[list[int]]:
    """The positions of equal keys."""
    found: dict[Hashable, list[int]] = defaultdict(list)
    for index, key in enumerate(keys):
        found[key].append(index)
    return list(found.values())
