"""A page for each task, from the registry and from the docstring of the task's module."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from pictures import ANIMATION, animation, examples, scenes

from magical_mj.leaderboard.page import label
from magical_mj.leaderboard.standings import BLOCKS, Standing, published
from magical_mj.scene.constants import CONTROL_RATE
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, task_spec
from magical_mj.web.page_data import sections

METHODS = ("BC (ST)", "BC (MT)", "GAIL (ST)", "WGAIL-GP (ST)", "AL (ST)")
ABOUT = "An expert at work, from above and as the robot sees it"


def write_task_pages(folder: Path, media: Path, own: Iterable[Standing]) -> str:
    """Writes `<Task>.md` for each task, and `tasks.md` with cards of all tasks.

    Args:
        folder: the folder of the pages.
        media: the folder of the pictures.
        own: the methods with results that are listed below the paper's.

    Returns:
        The cards of all tasks, as HTML.
    """
    methods = [*(one for one in published() if one.name in METHODS), *own]
    cards = []
    for task in TASKS:
        still = animation(task, media / f"{task}.webp")
        (folder / f"{task}.md").write_text(_page(task, methods, media), encoding="utf-8")
        goal = _sentence(task_spec(task).summary)
        moves = f'src="media/{still}" data-moving="media/{task}.webp" loading="lazy"'
        shown = f'<img class="wide" {moves} width="{2 * ANIMATION}" height="{ANIMATION}" alt="{ABOUT}">'
        cards.append(f'<a class="card" href="{task}.html">{shown}<strong>{task}</strong> {goal}</a>')
    cards_html = f'<div class="cards">{"".join(cards)}</div>'
    listed = "```{toctree}\n:hidden:\n\n" + "\n".join(TASKS) + "\n```"
    (folder / "tasks.md").write_text(f"# Tasks\n\n{listed}\n\n{cards_html}\n", encoding="utf-8")
    return cards_html


def _page(task: str, methods: list[Standing], media: Path) -> str:
    spec, texts = task_spec(task), sections(task)
    variants = [variant for known, variant in ENVIRONMENTS if known == task]
    paper, released = spec.horizon("paper"), spec.horizon("released")
    steps = f"An episode has {paper} steps, which are {paper / CONTROL_RATE:g} s"
    parts = [
        f"# {task}",
        f"{_sentence(spec.summary)} {_play(task, 'Demo', 'Play it')}",
        _animation(task, media),
        texts["Goal"],
        f"{steps}." if released == paper else f"{steps} ({released} steps under the released code's rules).",
        "## Variants",
        texts["What varies"],
        _variants(task, variants, media),
        "## Score",
        texts["Score"],
        _examples(task, media),
        "## Results",
        _results(task, variants, methods),
        "## Differences from the original",
        texts["Differences from the original"],
    ]
    return "\n\n".join(parts) + "\n"


def _animation(task: str, media: Path) -> str:
    """The animation of a task. Browsers with reduced motion show the initial scene instead."""
    still = next(iter(scenes(task, "Demo", media))).name
    size = f'width="{2 * ANIMATION}" height="{ANIMATION}"'
    image = f'<img class="wide" src="media/{task}.webp" {size} alt="{ABOUT}">'
    return f'<picture><source media="(prefers-reduced-motion: reduce)" srcset="media/{still}">{image}</picture>'


def _sentence(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}."


def _play(task: str, variant: str, text: str, seed: int = 0) -> str:
    """A link to the page for playing, in HTML, because Sphinx does not know that page."""
    return f'<a class="play" href="play/#{task}-{variant}-{seed}">{text}</a>'


def _variants(task: str, variants: list[str], media: Path) -> str:
    rows = []
    for variant in variants:
        links = (
            _play(task, variant, f'<img src="media/{path.name}" alt="Scene {seed}" loading="lazy">', seed)
            for seed, path in enumerate(scenes(task, variant, media))
        )
        rows.append(f"<tr><th>{variant}</th><td>{' '.join(links)}</td></tr>")
    text = "Initial scenes of the first seeds. Click one to play it."
    return f'{text}\n\n<table class="scenes">{"".join(rows)}</table>'


def _examples(task: str, media: Path) -> str:
    figures = (
        f'<figure><img src="media/{path.name}" alt="A state with score {score:.2f}"><figcaption>{score:.2f}'
        "</figcaption></figure>"
        for score, path in examples(task, media)
    )
    return f'<div class="examples">{"".join(figures)}</div>'


def _results(task: str, variants: list[str], methods: list[Standing]) -> str:
    lines = [f"| Method | {' | '.join(variants)} |", f"| --- |{' ---: |' * len(variants)}"]
    played = [one for one in methods if any(pair[0] == task for pair in one.means)]
    for block, heading in BLOCKS.items():
        group = [one for one in played if one.block == block]
        lines += [f"| **{heading}** |{' |' * len(variants)}"] if group else []
        for one in group:
            means = [one.means.get((task, variant)) for variant in variants]
            cells = ["" if values is None else f"{values.mean():.2f}" for values in means]
            lines.append(f"| {label(one)} | {' | '.join(cells)} |")
    return (
        "Mean scores of the runs. †: the paper's results, in the original simulator. ST was trained on this task, MT "
        "on all tasks. The last category has the paper's and ours by the same rules.\n\n"
        + "\n".join(lines)
        + "\n\nScores of the scripted expert: [The experts](experts.md). "
        "The [leaderboard](standings.md) lists the commands that repeat our results."
    )
