"""The home page: what the benchmark asks, how to install it, one policy in two scenes, and the main results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from conf import PAPER, REPOSITORY
from pictures import film
from standings_page import headline

from magical_mj.engine import Engine
from magical_mj.leaderboard.standings import Standing
from magical_mj.policies.interface import actions_of

SHOWN: Final = "state-bc"
"""The leaderboard entry of the policy on the page."""
TASK: Final = "FindDupe"
VARIANTS: Final = {"Demo": max, "Layout": min}
"""The variants on the page, and the choice of the episode: one with the best score, and one with the worst."""
TEMPLATE: Final = """<p class="question">A robot has seen ten demonstrations of a task in one scene. Does it still solve
the task if poses, colours, shapes or the number of objects change? MAGICAL measures this with 8 tasks and 60
environments. This is MAGICAL re-created on MuJoCo, for Gymnasium and dm_env.</p>

<p class="links"><a href="{paper}">Paper</a> {code}<a href="play/">Play</a> <a href="standings.html">Leaderboard</a></p>

<div class="install highlight-console notranslate"><div class="highlight"><pre>{install}</pre></div></div>

<div class="sides">{sides}</div>

<p>The same policy twice, learnt by behavioural cloning. The task: bring another block that matches the one in the goal
region into the region. <a href="play/inspect.html#FindDupe-Layout-0">Inspect the scene in 3-D</a></p>

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
<figcaption><strong>{words}</strong> ({variant}): mean score {mean:.2f}. <a href="{link}">Watch more</a></figcaption>
</figure>"""


def home(methods: Mapping[str, Standing], cards: str, media: Path) -> str:
    """The page's HTML. Its pictures are written to `media`."""
    return TEMPLATE.format(
        paper=PAPER,
        code=f'<a href="{REPOSITORY}">Code</a> ' if REPOSITORY else "",
        sides="".join(_side(methods[SHOWN], variant, media) for variant in VARIANTS),
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


def _side(method: Standing, variant: str, media: Path) -> str:
    """An animation of the policy in one variant, with its mean score."""
    played = [episode for episode in method.entry.counted if (episode.task, episode.variant) == (TASK, variant)]
    episode = VARIANTS[variant](played, key=lambda episode: episode.score)
    env, actions = Engine(TASK, variant, seed=episode.seed), actions_of(episode.actions or "")
    still, moving = film(env, actions, media / f"home-{variant}", size=448, frames=2 * len(actions))
    return SIDE.format(
        still=f"media/{still}",
        moving=f"media/{moving}",
        place=f"{TASK}-{variant}",
        score=episode.score,
        words="The training scene" if variant == "Demo" else "Other poses",
        variant=variant,
        mean=method.means[TASK, variant].mean(),
        link=f"play/#{TASK}-{variant}-0@{SHOWN}",
    )
