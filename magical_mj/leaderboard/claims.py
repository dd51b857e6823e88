"""Claims: episodes as a method's results report them. They are checked by replaying their actions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, NamedTuple

from magical_mj.evaluation.reports.statistics import SCORE_TOLERANCE
from magical_mj.policies.interface import LETTERS, actions_of, play
from magical_mj.tasks.registry import ENVIRONMENTS, Pair, sample_scene
from magical_mj.tasks.spec import Rules
from magical_mj.utils.parallel import map_unordered

if TYPE_CHECKING:
    from magical_mj.envs.composer import Environment
    from magical_mj.evaluation.scores import EpisodeResult

SEEDS: Final = 100
"""The number of episodes in each environment that the protocol requires."""
CHUNK: Final = 50
"""The number of episodes that a worker replays before it reports."""


class Claim(NamedTuple):
    """One episode as it is reported.

    Attributes:
        run: the number of the method's run.
        task: the task's name.
        variant: the variant's name.
        seed: the scene's seed.
        scene: the scene's digest; None if it was not recorded.
        score: in [0, 1].
        actions: one of `magical_mj.policies.interface.LETTERS` for each step.
        failure: why the policy failed; None if it did not.
    """

    run: int
    task: str
    variant: str
    seed: int
    scene: str | None
    score: float
    actions: str
    failure: str | None

    def __str__(self) -> str:
        return f"run {self.run}, {self.task} {self.variant}, seed {self.seed}"


def claim_of(score: EpisodeResult) -> Claim:
    """The claim of an evaluated episode."""
    return Claim(
        *(score.run, score.task, score.variant, score.seed, score.scene, score.score, score.actions, score.failure)
    )


@dataclass(frozen=True)
class Checked:
    """The result of replaying a chunk of episodes.

    Attributes:
        episodes: the number of episodes.
        steps: the number of actions.
        problems: a sentence for each episode that differs from its claim.
    """

    episodes: int
    steps: int
    problems: list[str]


def check_claims(episodes: Iterable[Claim], rules: Rules, jobs: int | None = None) -> Iterator[Checked]:
    """Replays episodes in the scenes of their seeds, and compares scenes and scores. Yields a result for each chunk.

    Args:
        episodes: the claims.
        rules: the rules by which they were scored.
        jobs: the number of processes; None: one per core.
    """
    environments: dict[Pair, list[Claim]] = defaultdict(list)
    for episode in episodes:
        environments[episode.task, episode.variant].append(episode)
    chunks = [found[start : start + CHUNK] for found in environments.values() for start in range(0, len(found), CHUNK)]
    check = partial(check_chunk, rules=rules)
    return map(check, chunks) if jobs == 1 or len(chunks) == 1 else map_unordered(check, chunks, jobs)


def check_chunk(episodes: Sequence[Claim], rules: Rules) -> Checked:
    """The work of one process: checks some episodes of one environment."""
    first = episodes[0]
    from magical_mj.envs.composer import load  # which loads the simulator

    with closing(load(first.task, first.variant, seed=0, observations=(), rules=rules)) as env:
        problems = [f"{episode}: {problem}" for episode in episodes if (problem := check_claim(episode, env))]
    return Checked(len(episodes), sum(len(episode.actions) for episode in episodes), problems)


def check_claim(claim: Claim, env: Environment) -> str | None:
    """A sentence about what is wrong with an episode; None if its replay confirms it.

    Args:
        claim: the claim.
        env: an environment of its task, variant and rules.
    """
    digest = sample_scene(claim.task, claim.variant, claim.seed).digest()
    if claim.scene is not None and claim.scene != digest:
        return f"it was played in the scene {claim.scene}, and the seed's scene is {digest}"
    wrong = contradiction(claim, env.horizon)
    if wrong is not None or claim.failure is not None:
        return wrong
    env.reset(seed=claim.seed)
    for _ in play(env, actions_of(claim.actions)):
        pass
    if abs(env.score() - claim.score) > SCORE_TOLERANCE:
        return f"the score is {claim.score:g}, and its actions lead to {env.score():g}"
    return None


def contradiction(claim: Claim, horizon: int | None) -> str | None:
    """A sentence about what is wrong with an episode without playing it; None if nothing is.

    Args:
        claim: the claim.
        horizon: the number of steps of its task.
    """
    if claim.failure is not None:
        return None if claim.score == 0 else f"the policy failed, and its score is {claim.score:g} instead of 0"
    if set(claim.actions) - set(LETTERS):
        return "its actions are not all among the 18"
    if len(claim.actions) != horizon:
        return f"it has {len(claim.actions)} actions, and episodes have {horizon}"
    return None


def missing(episodes: Iterable[Claim], tasks: Collection[str], runs: Iterable[int] = ()) -> list[str]:
    """Which episodes that the protocol requires are missing: a sentence for each run and environment.

    Args:
        episodes: the existing episodes.
        tasks: the tasks in all of whose environments each run must have played.
        runs: the numbers of runs of which there may be no episodes at all.
    """
    found: dict[tuple[int, str, str], set[int]] = defaultdict(set)
    for episode in episodes:
        found[episode.run, episode.task, episode.variant].add(episode.seed)
    problems = []
    for run in sorted({*runs, *(run for run, _, _ in found)}):
        for task, variant in ENVIRONMENTS:
            absent = set(range(SEEDS)) - found[run, task, variant]
            if task in tasks and absent:
                seeds = "all" if len(absent) == SEEDS else f"{len(absent)}, such as seed {min(absent)},"
                problems.append(f"run {run}, {task} {variant}: {seeds} of the {SEEDS} episodes are missing")
    return problems
