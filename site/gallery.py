"""The gallery: an animated card for each environment, shift and body, with links to play and inspect it."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from pictures import film
from shifted import PHYSICAL, SWEPT, scenes

from magical_mj.engine import Engine
from magical_mj.policies.interface import actions_of
from magical_mj.scene.bodies import BODIES, GRIPPER
from magical_mj.shifts import SHIFTS
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, task_spec
from magical_mj.variants import varied_axes
from magical_mj.web.page_data import environment_scenes

AXES: Final = {
    "jitter": "small changes of poses",
    "layout": "poses",
    "colour": "colours",
    "shape": "shapes",
    "count": "counts",
    "dynamics": "dynamics",
}
"""Axis of variation -> its description."""
SHIFTED: Final = "FindDupe"
"""The task for the pictures of shifts, in its demo scene."""
STRENGTH: Final = 4
TEMPLATE: Final = """# Gallery

An expert in each of the 60 environments, and the effects of shifts on one of them. Point at a picture to animate it.

<form class="filter" role="search" aria-label="Environments">
<label>Task <select name="task"><option value="">all</option>{tasks}</select></label>
<label>What varies <select name="axis"><option value="">anything</option>
<option value="nothing">nothing: Demo</option>{axes}</select></label>
<output>{count} environments</output>
</form>

<div class="cards small gallery">{environments}</div>

## Shifts

[Shifts](shifts.md) change any environment, with strengths from 1 to 5. Here each has strength {strength}, in the demo
scene of {shifted}. The actions are those of a demonstration that solves the scene without the shift.

<div class="cards small">{shifts}</div>

## Other bodies

[SweepToTop](bodies.md), x-magical's task, with its four bodies and their experts.

<div class="cards small">{bodies}</div>
"""
PICTURE: Final = (
    '<img src="media/{still}" data-moving="media/{moving}" width="192" height="192" loading="lazy" alt="{about}">'
)
CARD: Final = """<article class="card" data-task="{task}" data-axes="{axes}">
<a href="play/#{name}-0" tabindex="-1">{picture}</a><strong>{name}</strong> {words}
<span><a href="play/#{name}-0" aria-label="Play {name}">Play</a>
<a href="play/inspect.html#{name}-0" aria-label="Inspect {name}">Inspect</a></span></article>"""
OTHER: Final = '<article class="card">{picture}<strong>{name}</strong> {words}{link}</article>'
LINKS: Final = """<span><a href="play/#{address}" aria-label="Play {name}">Play</a>
<a href="play/inspect.html#{address}" aria-label="Inspect {name}">Inspect</a></span>"""


def gallery(media: Path) -> str:
    """The page in Markdown with HTML. Its pictures are written to `media`."""
    cards = [_card(task, variant, media) for task, variant in ENVIRONMENTS]
    shifts = [_shift(name, media) for name in SHIFTS if name != "words"]
    return TEMPLATE.format(
        tasks="".join(f"<option>{task}</option>" for task in TASKS),
        axes="".join(f'<option value="{axis}">{words}</option>' for axis, words in AXES.items()),
        count=len(cards),
        environments="".join(cards),
        strength=STRENGTH,
        shifted=SHIFTED,
        shifts="".join(shifts),
        bodies="".join(_body(body, media) for body in BODIES),
    )


def _expert(task: str, variant: str) -> list[int]:
    return list(actions_of(environment_scenes(task, variant)["scenes"][0]["expert"]))


def _card(task: str, variant: str, media: Path) -> str:
    name, varied = f"{task}-{variant}", varied_axes(task_spec(task), variant)
    still, moving = film(Engine(task, variant, seed=0), _expert(task, variant), media / f"gallery-{name}")
    return CARD.format(
        task=task,
        name=name,
        axes=" ".join(varied) or "nothing",
        picture=PICTURE.format(still=still, moving=moving, about=f"The first scene of {name}"),
        words=f"Varies {', '.join(AXES[axis] for axis in varied)}" if varied else "The scene of the demonstrations",
    )


def _shift(name: str, media: Path) -> str:
    engine = Engine(SHIFTED, seed=0, shifts={name: STRENGTH})
    still, moving = film(engine, _expert(SHIFTED, "Demo"), media / f"gallery-shift-{name}")
    picture = PICTURE.format(still=still, moving=moving, about=f"{SHIFTED} with {name} at strength {STRENGTH}")
    address = f"{SHIFTED}-Demo-0?shifts={name}:{STRENGTH}"
    link = LINKS.format(address=address, name=f"{SHIFTED} with {name}") if name in PHYSICAL else ""
    return OTHER.format(picture=picture, name=name, words=SHIFTS[name].summary, link=link)


def _body(body: str, media: Path) -> str:
    shift = "" if body == GRIPPER else f"body:{body}"
    (entry, *_) = scenes(SWEPT, "Layout", [shift])[0]["scenes"]
    still, moving = film(Engine(SWEPT, "Layout", seed=0, body=body), entry["expert"], media / f"gallery-body-{body}")
    picture = PICTURE.format(still=still, moving=moving, about=f"{SWEPT} with the {body}")
    address = f"{SWEPT}-Layout-0{shift and '?shifts='}{shift}"
    return OTHER.format(picture=picture, name=body, words="", link=LINKS.format(address=address, name=f"the {body}"))
