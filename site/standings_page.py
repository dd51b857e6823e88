"""The leaderboard as a page of the site, from results/: tables that can be sorted, and episodes to watch."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Final

import numpy as np
from charts import chart

from magical_mj.evaluation.replay import obstacle
from magical_mj.leaderboard.page import label
from magical_mj.leaderboard.standings import BLOCKS, OVERALL, Estimate, Standing, own_standings, published
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.web.page_data import SCENES

ROOT: Final = Path(__file__).parent.parent
HEADLINE: Final = {
    "state-goals": "Goals and planning",
    "state-bc": "BC from states",
    "pixels-bc-quick": "BC from pictures",
    "state-gail": "GAIL from states",
    "random": "Random actions",
}
"""The entries in the home page's chart, with their names there."""
INTRODUCTION: Final = (
    "Interquartile means of the scores over tasks and runs, in [0, 1]. Our own runs have 95 % intervals. An agent "
    "learns from demonstrations in Demo, and is evaluated in all variants. Click a heading to sort. Click a method for "
    "its scores in each environment, the command that repeats them, and episodes to watch: your browser replays the "
    "stored actions. Methods that were evaluated in only some environments are listed last."
)


def standings_page(methods: Mapping[str, Standing]) -> str:
    """The page in Markdown with HTML. `methods` maps the file name of an entry to its standing."""
    blocks: dict[str, list[tuple[str, Standing]]] = defaultdict(list)
    for name, method in [*methods.items(), *(("", one) for one in published())]:
        blocks["published" if method.kind == "published" else method.block].append((name, method))
    parts = ["# Leaderboard", INTRODUCTION, "How to submit an entry: [Entries of the leaderboard](leaderboard.md)."]
    for block, heading in {**BLOCKS, "published": "The paper's, in the original simulator †"}.items():
        rows = sorted(blocks.get(block, ()), key=lambda row: (not row[1].everywhere, -_value(row[1], OVERALL)))
        if rows:
            parts += [f"## {heading}", _table(heading, rows)]
    return "\n\n".join(parts) + "\n"


def _value(method: Standing, variant: str) -> float:
    return method.scores[variant].value if variant in method.scores else -1.0


def _table(heading: str, rows: Sequence[tuple[str, Standing]]) -> str:
    columns = {OVERALL: "Overall"} | {variant: variant for variant in VARIANTS}
    head = "".join(
        f'<th scope="col" aria-sort="{"descending" if name == OVERALL else "none"}"><button>{text}</button></th>'
        for name, text in {"": "Method", "runs": "Runs", "played": "Played", **columns}.items()
    )
    body = "".join(_row(name, method, tuple(columns)) for name, method in rows)
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(heading)}"><table class="standings"><thead>'
        f"<tr>{head}</tr></thead>{body}</table></div>"
    )


def _row(name: str, method: Standing, columns: Sequence[str]) -> str:
    """A table body with a method's scores, and a hidden row with details."""
    cells = "".join(_cell(method.scores.get(column)) for column in columns)
    runs = len(method.entry.runs) or ""
    title = f'<button class="opens" aria-expanded="false">{escape(label(method))}</button>'
    details = f'<tr class="details" hidden><td colspan="{len(columns) + 3}">{_details(name, method)}</td></tr>'
    figures = f"<td>{runs}</td><td>{len(method.means)}/{len(ENVIRONMENTS)}</td>{cells}"
    return f'<tbody><tr><th scope="row">{title}</th>{figures}</tr>{details}</tbody>'


def _cell(estimate: Estimate | None) -> str:
    if estimate is None:
        return "<td></td>"
    interval = "" if np.isnan(estimate.low) else f"<small>{estimate.low:.2f} to {estimate.high:.2f}</small>"
    return f'<td class="figure" style="--share: {round(100 * estimate.value)}%">{estimate.value:.2f}{interval}</td>'


def _details(name: str, method: Standing) -> str:
    rows, stored = [], _stored(method)
    for task in TASKS:
        cells = []
        for variant in VARIANTS:
            means = method.means.get((task, variant))
            if means is None:
                cells.append("<td></td>")
                continue
            text = f"{means.mean():.2f}"
            if set(range(1 if variant == "Demo" else SCENES)) <= stored.get((task, variant), {}).keys():
                text = f'<a href="play/#{task}-{variant}-0@{name}" title="Watch it in {task}-{variant}">{text}</a>'
            cells.append(f'<td class="figure" style="--share: {round(100 * means.mean())}%">{text}</td>')
        rows.append(f'<tr><th scope="row">{task}</th>{"".join(cells)}</tr>')
    head = "".join(f'<th scope="col">{variant}</th>' for variant in ("Task", *VARIANTS))
    about = "" if method.kind == "published" else f"<p>{escape(method.entry.card.description or '')}</p>"
    command = "" if method.kind == "published" else "\n".join(method.entry.card.commands or ())
    repeat = f"<p>Repeat it:</p><div class='highlight'><pre>{escape(command)}</pre></div>" if command else ""
    watch = f"<p>Mean scores{'; each opens the first episode there' if method.entry.episodes else ''}.</p>"
    table = f'<table class="heat"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    return f"{about}{watch}{table}{repeat}"


def _stored(method: Standing) -> dict[tuple[str, str], dict[int, str]]:
    """The actions of the first run in the scenes of the page for playing, as letters, by environment and seed."""
    episodes: dict[tuple[str, str], dict[int, str]] = defaultdict(dict)
    if method.entry.episodes:
        first = method.entry.runs[0]
        for episode in method.entry.counted:
            shown = episode.run == first and episode.seed < SCENES and episode.failure is None
            if shown and obstacle(episode) is None:
                episodes[episode.task, episode.variant][episode.seed] = episode.actions
    return episodes


def write_replays(methods: Mapping[str, Standing], folder: Path) -> None:
    """Writes a file `<name>.json` with the stored actions of each method, and `index.json` with the methods' names."""
    folder.mkdir(parents=True)
    index = {}
    for name, method in methods.items():
        if method.kind == "published":
            continue
        episodes = _stored(method)
        content = {
            f"{task}-{variant}": {str(seed): actions for seed, actions in sorted(episodes[task, variant].items())}
            for task, variant in ENVIRONMENTS
            if (task, variant) in episodes
        }
        index[name] = method.name
        (folder / f"{name}.json").write_text(json.dumps(content, separators=(",", ":")), encoding="utf-8")
    (folder / "index.json").write_text(json.dumps(index), encoding="utf-8")


def headline(methods: Mapping[str, Standing]) -> str:
    """A chart of some entries' mean scores over all tasks, by variant."""
    lines = {
        text: [
            float(np.mean([means.mean() for pair, means in methods[name].means.items() if pair[1] == variant]))
            for variant in VARIANTS
        ]
        for name, text in HEADLINE.items()
    }
    about = "Mean scores over all tasks, by variant: all but planning fall from Demo to Layout"
    return chart(lines, tuple(VARIANTS), about)


def read_methods() -> dict[str, Standing]:
    """The entries of results/."""
    return own_standings(ROOT / "results")
