"""Scores the entries in results/ by the rules of the paper's released code, by which the paper's results were scored.

python -m tools.released                     # entries without such scores; a minute on one core for five runs
python -m tools.released pixels-bc-quick     # or some

Writes `released.json` into an entry's folder: environment -> run -> seed -> score, of the episodes whose score differs.
Both Cluster tasks have shorter episodes by these rules, so all their episodes have to be replayed. That takes hours:
only the first scenes of each of their environments are scored, in all runs.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter, defaultdict
from collections.abc import Mapping
from contextlib import closing
from dataclasses import replace as with_values
from functools import cache
from pathlib import Path
from typing import Final

from msgspec.structs import replace as with_items

from magical_mj import sample_scene
from magical_mj.engine import Engine
from magical_mj.evaluation.scores import SCORE_TOLERANCE, EpisodeResult
from magical_mj.leaderboard.entry import Entry, entry_files, read_entry
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.spec import Rules

RESULTS: Final = Path(__file__).parent.parent / "results"
RULES: Final[Rules] = "released"
NAME: Final = "released.json"
CLUSTERS: Final = ("ClusterColour", "ClusterShape")
SCENES: Final = 10
"""The number of scenes in each environment of `CLUSTERS`. The other environments have all of the protocol."""
Scores = dict[str, dict[str, dict[str, float]]]
"""Environment -> run -> seed -> score."""


def is_scored(episode: EpisodeResult) -> bool:
    """Whether an episode gets a score by the released rules."""
    return episode.task not in CLUSTERS or episode.seed < SCENES


def may_differ(episode: EpisodeResult) -> bool:
    """Whether the rules can give an episode another score; see the docstrings of these tasks."""
    if episode.task == "MakeLine":
        return episode.score == 0.5  # two of three blocks
    if episode.task == "FindDupe":
        return episode.score == 0 and has_duplicates(episode.variant, episode.seed)
    return episode.task in CLUSTERS


@cache
def has_duplicates(variant: str, seed: int) -> bool:
    """Whether a scene of FindDupe has three blocks of one kind: the query and two duplicates."""
    kinds = Counter((block.shape, block.colour) for block in sample_scene("FindDupe", variant, seed).blocks)
    return max(kinds.values()) > 2


def rescored(entry: Entry) -> Scores:
    """The scores by the released rules that differ from those of the entry, from replays of its actions."""
    environments: dict[tuple[str, str], list[EpisodeResult]] = defaultdict(list)
    for episode in entry.counted:
        if is_scored(episode) and may_differ(episode) and episode.failure is None:
            environments[episode.task, episode.variant].append(episode)
    scores: Scores = defaultdict(lambda: defaultdict(dict))
    for (task, variant), episodes in sorted(environments.items()):
        episodes.sort(key=lambda episode: (episode.seed, episode.run))
        with closing(Engine(task, variant, seed=episodes[0].seed, rules=RULES)) as engine:
            for episode in episodes:
                engine.reset(seed=None if episode.seed == engine.seed else episode.seed)  # None keeps the scene
                for action in actions_of(episode.actions[: engine.horizon]):
                    engine.step(action)
                score = engine.score()
                if abs(score - episode.score) > SCORE_TOLERANCE:
                    scores[f"{task}-{variant}"][str(episode.run)][str(episode.seed)] = round(score, 6)
    return scores


def by_released_rules(entry: Entry, folder: Path) -> Entry | None:
    """The entry's scored episodes with their scores by the released rules. None if its folder has none."""
    path = folder / NAME
    if entry.rules == RULES:
        return entry
    if not path.exists():
        return None
    scores: Mapping[str, Mapping[str, Mapping[str, float]]] = json.loads(path.read_text("utf-8"))

    def score(episode: EpisodeResult) -> float:
        runs = scores.get(f"{episode.task}-{episode.variant}", {})
        return runs.get(str(episode.run), {}).get(str(episode.seed), episode.score)

    episodes = [with_values(episode, score=score(episode), rules=RULES) for episode in filter(is_scored, entry.counted)]
    return with_items(entry, rules=RULES, episodes=episodes)


def main() -> None:
    """Scores the named entries, or those without scores."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("entries", nargs="*", help="the names of folders in results/")
    names = parser.parse_args().entries
    for folder in [RESULTS / name for name in names] or entry_files(RESULTS):
        if names or not (folder / NAME).exists():
            text = json.dumps(rescored(read_entry(folder)), separators=(",", ":"))
            (folder / NAME).write_text(f"{text}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
