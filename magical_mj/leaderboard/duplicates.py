"""Duplicates: runs whose actions are those of another run, and that are no trainings of their own."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Hashable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Final, TypeVar

from magical_mj.leaderboard.claims import Claim
from magical_mj.leaderboard.entry import Entry

Run = TypeVar("Run", bound=Hashable)

ALIKE: Final = 0.9
"""The share of episodes with the same actions above which a run is a copy.

Different trainings of ours share up to a fifth of all episodes, and up to three quarters in an easy environment.
"""


def copies(runs: Mapping[Run, Sequence[Claim]]) -> Iterator[tuple[Run, Run]]:
    """Pairs of a run and an earlier one of which it is a copy; the first such one only. Failed episodes do not count.

    Args:
        runs: the episodes of each run.
    """
    players: dict[tuple[str, str, int, str], list[Run]] = defaultdict(list)
    played: Counter[Run] = Counter()
    for run, episodes in runs.items():
        for episode in episodes:
            if episode.failure is None:
                players[episode.task, episode.variant, episode.seed, episode.actions].append(run)
                played[run] += 1
    shared = Counter(pair for alike in players.values() for pair in combinations(alike, 2))
    found: dict[Run, Run] = {}
    for (earlier, later), count in shared.items():
        if count > ALIKE * min(played[earlier], played[later]):
            found.setdefault(later, earlier)
    yield from found.items()


def copied(entries: Mapping[str, Entry]) -> dict[str, str]:
    """File -> a sentence, for each entry that repeats a run or the name of one before it, scored by the same rules."""
    found: dict[str, str] = {}
    for rules in sorted({entry.rules for entry in entries.values()}):
        alike = {file: entry for file, entry in entries.items() if entry.rules == rules}
        runs = {
            (file, run): [episode for episode in entry.counted if episode.run == run]
            for file, entry in alike.items()
            for run in entry.runs
        }
        for (file, run), (other, original) in copies(runs):
            if file != other:
                found.setdefault(file, f"its run {run} has the same actions as run {original} in {other}")
        owners: dict[str, str] = {}
        for file, entry in alike.items():
            owner = owners.setdefault(entry.method, file)
            if owner != file:
                found.setdefault(file, f"it has the name of the method in {owner}, {entry.method}")
    return found
