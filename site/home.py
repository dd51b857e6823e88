"""The home page: what the benchmark asks, how to install it, one policy in two scenes, and the main results."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Final

from conf import PAPER, REPOSITORY
from pictures import film
from standings_page import headline
from wrong_goals import UNINTENDED, failures, what_it_pursued

from magical_mj.evaluation.replay import engine_for
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.leaderboard.standings import Standing
from magical_mj.policies.interface import actions_of

SHOWN: Final = "state-bc"
"""The leaderboard entry of the policy on the page."""
TASK: Final = "FindDupe"
TRAINED: Final = "Demo"
TESTED: Final = "Layout"
"""The variants on the page: a solved episode of the first, and one of the second that pursued a wrong goal."""
TEMPLATE: Final = """<p class="question">A robot has seen ten demonstrations of a task in one scene. Does it still solve
the task if poses, colours, shapes or the number of objects change? MAGICAL measures this with 8 tasks and 60
environments. This is MAGICAL re-created on MuJoCo, for Gymnasium and dm_env.</p>

<p class="links"><a href="play/#puzzle">What does it want?</a> <a href="explain.html">Watch policies fail</a>
<a href="evaluation.html">Evaluate yours</a></p>

<div class="install highlight-console notranslate"><div class="highlight"><pre>{install}</pre></div></div>

<div class="sides">{sides}</div>

<p>The same policy twice, learnt by behavioural cloning. The task: bring another block that matches the one in the goal
region into the region. <a href="play/inspect.html#FindDupe-Layout-0">Inspect the scene in 3-D</a>,
<a href="play/">play</a> all environments, <a href="play/intents.html">build a goal</a>, or see the
<a href="standings.html">leaderboard</a>, the <a href="{paper}">paper</a>{code}.</p>

## The eight tasks

{cards}

<p>All 60 environments, and the effects of shifts: <a href="gallery.html">gallery</a>.</p>

## Scores of methods

<p>Mean over the tasks. All methods learn from demonstrations of Demo only. Only the method that infers the goal and
plans towards it keeps its score. All methods: <a href="standings.html">leaderboard</a>.</p>

{chart}
"""
SIDE: Final = """<figure><picture><source media="(prefers-reduced-motion: reduce)" srcset="{still}">
<img src="{moving}" width="448" height="448" fetchpriority="low" decoding="async"
alt="The policy drives in {place}; the score is {score:.2f}"></picture>
<figcaption><strong>{words}</strong> ({variant}): mean score {mean:.2f}. {told} <a href="{link}">Watch</a></figcaption>
</figure>"""


def home(methods: Mapping[str, Standing], cards: str, media: Path) -> str:
    """The page's HTML. Its pictures are written to `media`."""
    method = methods[SHOWN]
    solved = (one for one in method.entry.counted if (one.task, one.variant, one.score) == (TASK, TRAINED, 1.0))
    failed = (one for one in failures(method, TASK) if one.variant == TESTED)
    wrong = ((one, told) for one in failed for kinds, told in [what_it_pursued(one)] if kinds.keys() & {*UNINTENDED})
    sides = [_side(method, next(solved), "The training scene", "", media)]
    episode, told = next(wrong)
    sides.append(_side(method, episode, "Other poses", told.sentence, media))
    return TEMPLATE.format(
        paper=PAPER,
        code=f', or the <a href="{REPOSITORY}">code</a>' if REPOSITORY else "",
        sides="".join(sides),
        install=install(),
        cards=cards,
        chart=headline(methods),
    )


def install() -> str:
    """The commands that install the package, in a shell."""
    pip = 'pip install ".[video]"'
    if not REPOSITORY:
        return f"# in a checkout of the repository\n{pip}"
    return f"git clone --depth 1 {REPOSITORY}\ncd {REPOSITORY.rpartition('/')[2]}\n{pip}"


def _side(method: Standing, episode: EpisodeResult, words: str, told: str, media: Path) -> str:
    """An animation of an episode, with the method's mean score in its variant, and what the episode pursued."""
    place, actions = f"{TASK}-{episode.variant}", actions_of(episode.actions)
    still, moving = film(engine_for(episode), actions, media / f"home-{episode.variant}", 448, 2 * len(actions))
    return SIDE.format(
        still=f"media/{still}",
        moving=f"media/{moving}",
        place=place,
        score=episode.score,
        words=words,
        variant=episode.variant,
        mean=method.means[TASK, episode.variant].mean(),
        told=escape(told),
        link=f"play/#{place}-{episode.seed}@{SHOWN}",
    )
