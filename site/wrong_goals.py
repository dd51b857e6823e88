"""The gallery of wrong goals: what failed policies moved instead, for each task, with films, and shares by method."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from contextlib import closing
from functools import cache
from html import escape
from pathlib import Path
from typing import Final, NamedTuple

from pictures import film
from scipy.stats import binomtest

from magical_mj.evaluation.replay import engine_for, obstacle
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.attribution import demonstrated_blocks
from magical_mj.intents.names import EIGHT
from magical_mj.intents.readings import ELSEWHERE, READINGS, ending
from magical_mj.leaderboard.standings import Standing
from magical_mj.policies.interface import actions_of
from magical_mj.tasks.registry import TASKS
from magical_mj.web.pursued import Pursued, pursued

ENDED: Final = Path(__file__).parent.parent / "docs" / "endings.csv"
SCENES: Final = 5
"""The number of scenes of each environment that the file covers."""
BLIND: Final = "random"
"""The entry that every card shows for comparison."""
UNINTENDED: Final = (*READINGS, *ELSEWHERE)
MOST: Final = 3
METHODS: Final = 3
"""The most wrong goals of a task, and the most methods below each."""
WORDS: Final = {
    "same place": "The block in the demonstrated place",
    "same colour": "A block of the demonstrated colour",
    "same shape": "A block of the demonstrated shape",
    "nearest": "The block nearest to the robot",
    "another block": "Another block",
    "incompetent": "A right block, but the task is not solved",
}
WITHOUT_BLOCKS: Final = {"same place": "Where the demonstrations' region was", "incompetent": "Elsewhere"}
TEMPLATE: Final = """## Wrong goals

What did policies do that failed? For each task, their commonest wrong goals, each with the methods
that pursued it most often, and random actions: a share that is not above theirs shows no goal. The shares are of all
episodes of one run, in the first scenes of each environment (16 to 40 episodes, in brackets 95 % intervals over
scenes), by the [endings](#endings) below. Where every block has to be moved, no block is wrong. Point at a picture to
animate it.

{tasks}"""
TASK: Final = '### {task}\n\n<div class="cards small">{cards}</div>'
CARD: Final = """<article class="card"><img src="media/{still}" data-moving="media/{moving}" width="192" height="192"
loading="lazy" alt="An episode in {place}"><strong>{words}</strong> {sentence}
<small>{shares}</small><span><a href="play/#{place}-{seed}@{entry}" aria-label="Watch {entry} in {place}">Watch</a>
<a href="play/#{place}-{seed}" aria-label="Play this scene: {place}, {seed}">Play this scene</a></span></article>"""


def wrong_goals(methods: Mapping[str, Standing], media: Path) -> str:
    """The gallery in Markdown with HTML. Its pictures are written to `media`."""
    tasks = []
    for task in TASKS:
        cards = "".join(_card(task, kind, methods, media) for kind in _commonest(task))
        tasks.append(TASK.format(task=task, cards=cards))
    return TEMPLATE.format(tasks="\n\n".join(tasks))


@cache
def measured() -> tuple[dict[str, str], ...]:
    """The rows of docs/endings.csv, which `python -m tools.attribution endings` writes, in the order of the tasks."""
    with ENDED.open(encoding="utf-8", newline="") as file:
        return tuple(sorted(csv.DictReader(file), key=lambda row: TASKS.index(row["task"])))


class _Share(NamedTuple):
    """A share of some episodes."""

    value: float
    episodes: int

    def __str__(self) -> str:
        """In per cent, with Wilson's interval."""
        found = binomtest(round(self.value * self.episodes), self.episodes).proportion_ci(method="wilson")
        return f"{100 * self.value:.0f}&nbsp;% [{100 * found.low:.0f},&nbsp;{100 * found.high:.0f}]"


def _shares(task: str, kind: str) -> dict[str, _Share]:
    """Entry -> the share of its episodes in a task that ended in this way. The largest first."""
    rows = [(row["entry"], int(row["episodes"]), float(row[kind])) for row in measured() if row["task"] == task]
    shares = {entry: _Share(ended / episodes, episodes) for entry, episodes, ended in rows}
    return dict(sorted(shares.items(), key=lambda one: -one[1].value))


def _commonest(task: str) -> list[str]:
    """The commonest wrong goals of a task's methods. If there are fewer than two, also the right one, not reached."""
    total = {kind: sum(share.value for share in _shares(task, kind).values()) for kind in UNINTENDED}
    kinds = sorted((kind for kind in UNINTENDED if total[kind]), key=lambda kind: -total[kind])[:MOST]
    return kinds if len(kinds) > 1 else [*kinds, "incompetent"]


def _card(task: str, kind: str, methods: Mapping[str, Standing], media: Path) -> str:
    shares = _shares(task, kind)
    learners = [name for name in shares if name in methods and methods[name].entry.observations is not None][:METHODS]
    blind = [f"<i>random actions {shares[BLIND]}</i>"] if BLIND in shares else []
    episode, entry, told = _example(task, kind, {name: methods[name] for name in learners})
    name = f"goal-{task}-{kind.replace(' ', '-')}"
    still, moving = film(engine_for(episode), actions_of(episode.actions), media / name)
    return CARD.format(
        still=still,
        moving=moving,
        place=f"{task}-{episode.variant}",
        seed=episode.seed,
        entry=entry,
        words=(WORDS if EIGHT[task].conjuncts[0].definition.of_blocks else WITHOUT_BLOCKS)[kind],
        sentence=escape(told.sentence),
        shares="; ".join([*(f"{escape(methods[name].name)} {shares[name]}" for name in learners), *blind]),
    )


def _example(task: str, kind: str, methods: Mapping[str, Standing]) -> tuple[EpisodeResult, str, Pursued]:
    """An episode with this ending alone. Without one, the episode where this ending has the largest share."""
    best, found = 0.0, None
    for name, method in methods.items():
        for episode in failures(method, task):
            kinds, told = what_it_pursued(episode)
            if kinds.get(kind, 0.0) > best:
                best, found = kinds[kind], (episode, name, told)
            if best == 1.0 and found:
                return found
    if found is None:
        raise SystemExit(f"{ENDED} has {kind!r} in {task}, but no stored episode ended in it: measure it again")
    return found


def failures(method: Standing, task: str) -> Iterator[EpisodeResult]:
    """The unsolved episodes of a method's first run in the scenes that docs/endings.csv covers."""
    first = method.entry.runs[0]
    for episode in method.entry.counted:
        chosen = episode.task == task and episode.run == first and episode.seed < SCENES
        if chosen and episode.score < 1.0 and episode.failure is None and obstacle(episode) is None:
            yield episode


def what_it_pursued(episode: EpisodeResult) -> tuple[Mapping[str, float], Pursued]:
    """The ending of an unsolved episode, as shares of kinds, and its sentence."""
    with closing(engine_for(episode)) as engine:
        for action in actions_of(episode.actions):
            engine.step(action)
        initial, final = engine.initial_scene, engine.scene
    kinds = ending(EIGHT[episode.task], demonstrated_blocks(episode.task), initial, final, solved=False)
    return kinds, pursued(episode.task, initial, final, episode.score)
