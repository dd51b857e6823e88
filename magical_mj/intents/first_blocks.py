"""Which block policies move first, where the right one is not where it is in the demonstrations.

This tells a policy that chose a wrong block from one that did not succeed with the right one.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Iterator, Sequence
from typing import Final

import numpy as np

from magical_mj.evaluation.reports.intervals import mean_over
from magical_mj.evaluation.reports.tables import NONE, Table
from magical_mj.intents.attribution import Attribution, demonstrated_blocks, shown_task
from magical_mj.intents.names import task_intent
from magical_mj.intents.readings import readings, refutes, selects_some
from magical_mj.scene import Scene

Flags = dict[tuple[int, Hashable], bool]
"""A flag for each run and scene."""
CAPTION: Final = (
    "Right block first: the share of episodes that moved a block first that has to be moved. Then solved: the share of "
    "these with score 1. Both with 95 % intervals, in the scenes of tasks with a choice of blocks where the right ones "
    "are not at the demonstrated places"
)


def misplaced(task: str, initial: Scene) -> bool:
    """Whether a task has a choice of blocks, and the right ones are not at the demonstrated places in this scene."""
    intent = task_intent(task)
    return selects_some(intent) and refutes(intent, readings(demonstrated_blocks(task), initial)["same place"], initial)


def first_block_table(results: Sequence[Attribution]) -> Iterator[Table]:
    """The table with a row for each method, if there is such a scene."""
    firsts, solved = defaultdict[str, Flags](dict), defaultdict[str, Flags](dict)
    for result in results:
        episode = result.episode
        if misplaced(shown_task(episode), result.initial):
            place = episode.run, (episode.task, episode.variant, episode.seed)
            firsts[episode.method][place] = result.right_first
            if result.right_first:
                solved[episode.method][place] = episode.score == 1.0
    if rows := tuple((name, _cell(flags), _cell(solved[name]), str(len(flags))) for name, flags in firsts.items()):
        yield Table("first_blocks", CAPTION, ("Method", "right block first", "then solved", "episodes"), (("", rows),))


def _cell(flags: Flags) -> str:
    """The mean over runs of the share of true flags, with its interval."""
    if not flags:
        return NONE
    runs, scenes = (
        {name: index for index, name in enumerate(dict.fromkeys(names))} for names in zip(*flags, strict=True)
    )
    shown = np.full((len(runs), len(scenes)), np.nan)
    for (run, scene), flag in flags.items():
        shown[runs[run], scenes[scene]] = flag
    value, low, high = mean_over([("", "", shown)])
    return f"{value:.2f}" + ("" if np.isnan(low) else f" [{low:.2f}, {high:.2f}]")
