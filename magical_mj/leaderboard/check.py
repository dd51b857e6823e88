"""Checks of results: evaluations' folders and entries."""

from __future__ import annotations

import math
import random
import secrets
import time
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from magical_mj.evaluation.scores import read
from magical_mj.evaluation.settings import UNOFFICIAL
from magical_mj.leaderboard.claims import SEEDS, Checked, Claim, check_claims, claim_of, contradiction, missing
from magical_mj.leaderboard.entry import Entry, unpacked
from magical_mj.leaderboard.record import Plan, disagreements, recorded
from magical_mj.tasks.protocol import DEMONSTRATIONS, PROTOCOL
from magical_mj.tasks.registry import TASKS, check_rules, task_spec
from magical_mj.tasks.spec import Rules
from magical_mj.utils.errors import EvaluationError
from magical_mj.utils.extras import check_extra
from magical_mj.variants import check_seed

SHARE: Final = 0.1
"""The share of an entry's episodes that are replayed by default."""
MOST_REPLAYED: Final = 500
"""The largest number of an entry's episodes that are replayed by default, so that a folder of many takes minutes. Where
one episode in a hundred is false, such a sample misses all of them once in 150 times, and the next draws others."""

Watch = Callable[[Checked], None]


@dataclass
class Findings:
    """The result of a check.

    Attributes:
        episodes: the number of replayed episodes.
        steps: the number of their actions.
        seconds: the duration of the replay.
        differing: a sentence for each episode that differs from the claim.
        missing: a sentence for each run and environment that lacks episodes.
        unfit: sentences about everything else that does not match this version's protocol.
    """

    episodes: int = 0
    steps: int = 0
    seconds: float = 0.0
    differing: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    unfit: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        """Whether no problems were found."""
        return not (self.differing or self.missing or self.unfit)

    def replay(self, episodes: Sequence[Claim], rules: Rules, jobs: int | None, watch: Watch) -> None:
        """Replays episodes and records the differences."""
        start = time.perf_counter()
        for found in check_claims(episodes, rules, jobs):
            self.episodes += found.episodes
            self.steps += found.steps
            self.differing += found.problems
            watch(found)
        self.seconds += time.perf_counter() - start


def verify(folder: Path | str, *, jobs: int | None = None, watch: Watch = lambda _: None) -> Findings:
    """Replays the episodes of an evaluation, and checks its settings and completeness against the protocol.

    Failed episodes, and those of tasks outside the benchmark, are not replayed. What was to be played is
    taken from the settings, so that an environment or a run without any episodes is missed.

    Args:
        folder: the folder of the evaluation.
        jobs: the number of processes; None: one per core.
        watch: called with the result of each chunk of episodes.

    Raises:
        EvaluationError: if the folder is not an evaluation.
    """
    folder = Path(folder)
    settings, scores = recorded(folder), read(folder)
    if any(score.worlds != "single" for score in scores):
        return Findings(unfit=[f"it was played in batched worlds: {UNOFFICIAL}"])
    plan, findings = Plan.read(settings), Findings()
    for what, here in (("protocol", PROTOCOL), ("demonstrations", DEMONSTRATIONS)):
        findings.unfit += _unfit(settings, what, here)
    findings.unfit += disagreements(settings, plan, scores)
    kinds: dict[tuple[str, Rules], list[Claim]] = defaultdict(list)
    for score in scores:
        kinds[score.policy, check_rules(score.rules)].append(claim_of(score))
    tasks = {task for task, _ in plan.environments} | {score.task for score in scores}
    for policy in dict.fromkeys([*plan.runs, *(policy for policy, _ in kinds)]):
        there = [claim_of(score) for score in scores if score.policy == policy]
        findings.missing += [f"{policy}, {problem}" for problem in missing(there, tasks, plan.runs.get(policy, ()))]
    for (policy, rules), episodes in kinds.items():
        findings.unfit += _unfit(settings, "rules", rules)
        ours = [episode for episode in episodes if episode.task in TASKS]
        if len(ours) < len(episodes):
            findings.unfit.append(f"{policy}: {len(episodes) - len(ours)} episodes are of tasks outside the benchmark")
        findings.replay(ours, rules, jobs, watch)
    return findings


def _unfit(settings: Mapping[str, Any], what: str, here: Any) -> list[str]:
    """A sentence if a recorded setting differs from the required value."""
    if settings.get(what) == here:
        return []
    said = f"{settings[what]!r} is recorded" if what in settings else "nothing is recorded"
    return [f"{what}: {said}, and it must be {here!r}"]


def check_entry(
    path: Path | str,
    *,
    everything: bool = False,
    seed: int | None = None,
    jobs: int | None = None,
    watch: Watch = lambda _: None,
) -> tuple[Entry, Findings]:
    """Reads an entry, and replays a random part of the episodes that count.

    All of these are checked for what is seen without playing them: their length, and that failures have the score 0.
    The choice of episodes does not depend on the file, whose author could otherwise alter it until the choice is good.

    Args:
        path: the file.
        everything: replay all episodes.
        seed: with which a check can be repeated: the same seed chooses the same episodes; None: nobody knows which.
        jobs: the number of processes; None: one per core.
        watch: called with the result of each chunk of episodes.

    Raises:
        EvaluationError: if the file is not a valid entry; see `magical_mj.leaderboard.entry.unpacked`.
        InvalidSeedError: if `seed` is not an integer, or negative.
    """
    check_extra("leaderboards", "eval")
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise EvaluationError(f"{path} cannot be read: {error.strerror}") from error
    entry = unpacked(data, path)
    findings = Findings(unfit=[] if entry.protocol == PROTOCOL else ["no protocol's number was recorded"])
    if not entry.counted:
        findings.unfit.append(f"none of its episodes starts in the scenes of seeds 0 to {SEEDS - 1}")
    if everything:
        findings.replay(entry.episodes, entry.rules, jobs, watch)
        return entry, findings
    playable = []
    for episode in entry.counted:
        problem = contradiction(episode, task_spec(episode.task).horizon(entry.rules))
        if problem is not None:
            findings.differing.append(f"{episode}: {problem}")
        elif episode.failure is None:
            playable.append(episode)
    findings.replay(_sample(playable, seed), entry.rules, jobs, watch)
    return entry, findings


def _sample(episodes: Sequence[Claim], seed: int | None) -> list[Claim]:
    count = min(MOST_REPLAYED, math.ceil(SHARE * len(episodes)))
    return random.Random(secrets.randbits(64) if seed is None else check_seed(seed)).sample(episodes, count)  # noqa: S311
