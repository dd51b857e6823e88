"""The leaderboard as a page of the site, made from results/: tables to sort and filter, and methods to compare."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from itertools import permutations
from pathlib import Path
from typing import Final

import numpy as np
from charts import Chart, text
from wrong_goals import measured

from magical_mj.evaluation.replay import obstacle
from magical_mj.evaluation.reports.intervals import Estimate
from magical_mj.evaluation.scores import EpisodeResult
from magical_mj.intents.readings import ENDINGS
from magical_mj.leaderboard.page import label, signed
from magical_mj.leaderboard.standings import (
    ABOVE,
    BLOCKS,
    COLUMNS,
    LEAST_RUNS,
    NEW_PLACES,
    Standing,
    improvement,
    published,
)
from magical_mj.tasks.registry import ENVIRONMENTS, TASKS, VARIANTS
from magical_mj.web.page_data import SCENES
from tools.intent_baselines import EPISODES, baselines
from tools.scores import by_released_rules, own_methods
from tools.stored_episodes import stored
from tools.test_scenes import right_first

ROOT: Final = Path(__file__).parent.parent
HEADLINE: Final = {
    "state-goals": "Goals and planning",
    "state-relational": "Relational from states",
    "pixels-redraw-quick": "Redraw from images",
    "state-bc": "BC from states",
    "pixels-bc-quick": "BC from images",
    "state-gail": "GAIL from states",
    "random": "Random actions",
}
"""The entries in the home page's chart, and their names there."""
COMPARED: Final = ("state-relational", "state-bc")
"""The two methods that are compared at first."""
INTRODUCTION: Final = """An agent learns from demonstrations of one scene (Demo), and is tested in scenes that differ.
Compare methods within a category. A method's name opens its scores in each environment, how to repeat them, and
episodes to watch. Add [yours](leaderboard.md); [how scores and intervals are computed](statistics.md)."""
INTENTS: Final = """What do policies reach that receive an [intent](intents-evaluation.md#baselines) at test time, by
what they are given? Clean success and the score in the first test intents of each set in Layout and All, with 95 %
intervals over runs and intents. Their episodes are in the repository, in `results/intents.jsonl.xz`."""
FIRST: Final = "Right object first"
RANK: Final = "Rank"
AT_FIRST: Final = (FIRST, "Generalisation", RANK)
"""The columns that are shown at first, after the methods. The others are shown on request."""
NONE: Final = Estimate(float("nan"))
GLOSSARY: Final = {
    "ST, MT": "one policy for each task, one policy for all tasks",
    "quick": "a small network and a short training",
    "allo.": "sees the arena from above instead of from the robot",
    "State": "observes a vector of positions instead of pictures",
    "no aug., no trans./rot. aug.": "without augmentations of pictures, without translations and rotations",
    "★": "official: all 60 environments, 100 episodes in each, five runs or more, and re-run",
    "†": "published: the paper's results, in the original simulator",
    "Memory": "mean score in Demo, Jitter and Dynamics, which hardly change the scene",
    "Distraction": "mean score in Colour and Shape, which change how objects look",
    "Generalisation": "mean score in Layout, CountPlus and All, which move, add and remove objects",
    NEW_PLACES: "mean score in the scenes where it is wrong to go to the same places as in the demonstrations",
    ABOVE: "generalisation on a scale from 0, the best agent that does not look, to 1, the full score",
    "In a frame": "what a method uses besides the demonstrations as its policy observes them",
    FIRST: "how often the first block that moves is one to move, in MatchRegions, FindDupe and FixColour, in scenes "
    "where the right block is not where it is in the demonstrations",
    RANK: "in the category, from the best to the worst that the 95 % intervals of the generalisation allow; "
    "the paper's results have no intervals. At the same best rank, methods with five runs or more are first",
    "category": "methods with the same rules, the same observations, and the same kind of help",
    "[0.10, 0.12]": "95 % interval over scenes and runs; of one run over scenes only",
    "(2/8)": "mean over two of the eight tasks, which does not compare with others; such methods are always last",
}
FULL_SIZE: Final = {
    "BC (ST)": "pixels-bc",
    "BC (ST, allo.)": "pixels-bc-allo",
    "BC (ST, no aug.)": "pixels-bc-no-augmentation",
    "BC (ST, no trans./rot. aug.)": "pixels-bc-no-trans-rot",
    "BC (MT)": "pixels-bc-multi",
    "GAIL (ST)": "pixels-gail",
    "GAIL (ST, allo.)": "pixels-gail-allo",
    "GAIL (ST, no aug.)": "pixels-gail-no-augmentation",
    "GAIL (MT)": "pixels-gail-multi",
    "WGAIL-GP (ST)": "pixels-wgail-gp",
    "AL (ST)": "pixels-al",
}
"""The paper's methods -> the experiments in tools/full_size that train them in the paper's size."""


def standings_page(methods: Mapping[str, Standing]) -> str:
    """The page in Markdown with HTML in it; `methods`: file name of an entry -> its standing."""
    rows = [*methods.items(), *(("", one) for one in (*published(), *by_released_rules()))]
    ranked = sorted(methods.items(), key=lambda item: item[1].rank)
    own = {name: method for name, method in ranked if method.everywhere}
    beats = _beats(own)
    parts = ["# Leaderboard", INTRODUCTION, _glossary(), _comparison(own, beats), _filter()]
    for block, heading in BLOCKS.items():
        group = [row for row in rows if row[1].block == block]
        if group:
            table = _table(heading, group)
            parts.append(f'<section class="block" data-block="{block}">\n\n## {heading}\n\n{table}\n\n</section>')
    parts += ["## By variant", _dots(own.values())]
    parts += ["## Who beats whom", _duels(own, beats), "## What it cost", _costs(methods.values())]
    if episodes := stored(EPISODES):
        parts += ["## Intents", INTENTS, baselines(episodes)]
    parts.append('<script src="_static/standings.js" type="module"></script>')
    return "\n\n".join(parts) + "\n"


def _glossary() -> str:
    items = "".join(f"<dt>{escape(word)}</dt><dd>{escape(meaning)}</dd>" for word, meaning in GLOSSARY.items())
    return f'<details class="glossary"><summary>What the words and signs mean</summary><dl>{items}</dl></details>'


def _filter() -> str:
    def select(name: str, title: str, options: Mapping[str, str]) -> str:
        choices = "".join(f'<option value="{value}">{shown}</option>' for value, shown in options.items())
        return f'<label>{title} <select name="{name}"><option value="">all</option>{choices}</select></label>'

    sees = {"pictures": "images", "states": "states", "nothing": "nothing"}
    uses = {"usual": "no more than the paper's setting", "more": "more than that"}
    by = {"own": "this project", "published": "the paper"}
    fields = select("sees", "Sees", sees) + select("uses", "May use", uses) + select("by", "Run by", by)
    more = '<label><input type="checkbox" name="columns" value="all"> all columns</label>'
    return f'<form class="kinds">{fields}{more}<output></output></form>'


def _table(heading: str, rows: Sequence[tuple[str, Standing]]) -> str:
    further = ("Runs", *(column for column in COLUMNS if column not in AT_FIRST))
    head = "".join(
        f'<th scope="col"{_more(name)} data-column="{name}" aria-sort="none"><button>{_heading(name)}</button></th>'
        for name in ("Method", *AT_FIRST, *further)
    )
    ranks = _ranks([method for _, method in rows])
    few = {name: method.kind != "published" and len(method.entry.runs) < LEAST_RUNS for name, method in rows}
    rows = sorted(rows, key=lambda row: (row[1].rank[0], ranks.get(row[1].name, (0, 0))[0], few[row[0]], row[1].rank))
    body = "".join(_row(name, method, ranks.get(method.name)) for name, method in rows)
    return (
        f'<div class="wide" tabindex="0" role="region" aria-label="{escape(heading)}"><table class="standings"><thead>'
        f"<tr>{head}</tr></thead>{body}</table></div>"
    )


def _ranks(methods: Sequence[Standing]) -> dict[str, tuple[int, int]]:
    """Method -> its best and worst rank by the intervals of its generalisation. Without an interval, by the mean."""
    scores = {one.name: one.scores["Generalisation"] for one in methods if one.everywhere}
    lows = {name: score.value if np.isnan(score.low) else score.low for name, score in scores.items()}
    highs = {name: score.value if np.isnan(score.high) else score.high for name, score in scores.items()}
    return {
        name: (1 + sum(low > highs[name] for low in lows.values()), sum(high >= lows[name] for high in highs.values()))
        for name in scores
    }


def _more(column: str) -> str:
    return "" if column in ("Method", *AT_FIRST) else ' class="more"'


def _heading(column: str) -> str:
    return f"{column} ({len(COLUMNS[column])})" if column in VARIANTS else column


def _row(name: str, method: Standing, rank: tuple[int, int] | None) -> str:
    """A body of a table: the method in words and its figures, and below them what opens."""
    chips = " ".join(f"<span>{escape(privilege)}</span>" for privilege in method.privileges)
    runs = 5 if method.kind == "published" else len(method.entry.runs)
    words = (method.entry.card.description or "").partition(". ")[0].removesuffix(".")
    title = f'<button class="opens" aria-expanded="false">{escape(label(method))}</button>'
    title += f"<small>{escape(words)}</small>" if words else ""
    title += f'<div class="chips">{chips}</div>' if chips else ""
    details = f'<tr class="details" hidden><td colspan="{len(COLUMNS) + 4}">{_details(name, method)}</td></tr>'
    ranks = "" if rank is None else f"{rank[0]}" if rank[0] == rank[1] else f"{rank[0]}-{rank[1]}"
    first = _figure(right_first(name)[0] or NONE, "", FIRST)
    figures = f"{first}{_cell(method, 'Generalisation')}<td>{ranks}</td>"
    figures += f'<td class="more">{runs}</td>'
    figures += "".join(_cell(method, column) for column in COLUMNS if column not in AT_FIRST)
    sees = "nothing" if method.entry.observations is None else "states" if method.sees_states else "pictures"
    usual = method.block in ("pictures", "states", "nothing") or method.kind == "published"
    kinds = f'data-sees="{sees}" data-uses="{"usual" if usual else "more"}"'
    key = name or f"{method.block} {method.name}"
    by = "published" if method.kind == "published" else "own"
    kinds += f' data-by="{by}" data-name="{escape(key)}"'
    whole = "" if method.everywhere else ' class="partial"'
    return f'<tbody {kinds}{whole}><tr><th scope="row">{title}</th>{figures}</tr>{details}</tbody>'


def _cell(method: Standing, column: str) -> str:
    lacks = method.lacks(column)
    score = None if lacks and column not in VARIANTS else method.scores.get(column)
    return _figure(score or NONE, lacks, column)


def _figure(score: Estimate, lacks: str, column: str) -> str:
    if np.isnan(score.value):
        return f"<td{_more(column)}></td>"
    below = lacks or ("" if np.isnan(score.low) else f"{score.low:.2f} to {score.high:.2f}".replace("-0.00", "0.00"))
    shown = f"{score.value:.2f}".replace("-0.00", "0.00")
    small = f"<small>{below}</small>" if below else ""
    more = " more" if _more(column) else ""
    return f'<td class="figure{more}" style="--share: {round(100 * max(score.value, 0))}%">{shown}{small}</td>'


def _details(name: str, method: Standing) -> str:
    rows, stored = [], _stored(method) if name else {}
    for task in TASKS:
        cells = []
        for variant in VARIANTS:
            means = method.means.get((task, variant))
            if means is None:
                cells.append("<td></td>")
                continue
            shown = f"{means.mean():.2f}"
            if set(range(1 if variant == "Demo" else SCENES)) <= stored.get((task, variant), {}).keys():
                shown = f'<a href="play/#{task}-{variant}-0@{name}" title="Watch it in {task}-{variant}">{shown}</a>'
            cells.append(f'<td class="figure" style="--share: {round(100 * means.mean())}%">{shown}</td>')
        rows.append(f'<tr><th scope="row">{task}</th>{"".join(cells)}</tr>')
    head = "".join(f'<th scope="col">{variant}</th>' for variant in ("Task", *VARIANTS))
    about = (
        "" if method.kind == "published" else f"<p>{escape(method.entry.card.description or '')}</p>{_checked(method)}"
    )
    watch = f"<p>Mean scores{'; each opens the first episode there' if stored else ''}.</p>"
    table = f'<table class="heat"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    return f"{about}{watch}{table}{_endings(name)}{_repeat(method)}"


def _checked(method: Standing) -> str:
    """How the method was checked, and what it lacks to be official."""
    words = "the actions lead to these scores, but anybody can tape an expert."
    if method.rerun:
        found = (f"{signed(difference)} ({what})" for what, difference in method.rerun.items())
        words = f"in fresh scenes, its mean score differs by {' and by '.join(found)}."
    lacks = f" Partial: {', '.join(method.gaps)}." if method.gaps else ""
    level = f'<a href="leaderboard.html#making-the-leaderboard">{method.level.capitalize()}</a>'
    return f"<p>{level}: {escape(words + lacks)}</p>"


def _endings(name: str) -> str:
    """What the method's episodes did in each task."""
    own = [row for row in measured() if row["entry"] == name]
    if not own:
        return ""
    heads = ("Task", "Episodes", *ENDINGS)
    head = "".join(f'<th scope="col">{escape(text)}</th>' for text in heads)
    body = "".join(f"<tr>{_ending_cells(row)}</tr>" for row in own)
    words = 'What its episodes did, in per cent (<a href="explain.html#endings">endings</a>):'
    return f'<p>{words}</p><table class="heat"><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>'


def _ending_cells(row: Mapping[str, str]) -> str:
    shares = [100 * float(row[name]) / int(row["episodes"]) for name in ENDINGS]
    cells = "".join(f"<td>{share:.0f}</td>" if share else "<td></td>" for share in shares)
    return f'<th scope="row">{row["task"]}</th><td>{row["episodes"]}</td>{cells}'


def _repeat(method: Standing) -> str:
    """The commands that repeat it. The paper's methods have the commands that train them here, in the paper's size."""
    commands, words = method.entry.card.commands or [], "Repeat it:"
    if method.kind == "published":
        words = "The scores are the paper's, from the original code. The same method here, in the paper's size:"
        name = FULL_SIZE[method.name]
        commands = [f"magical-mj experiment tools/full_size/{name}.toml --out runs/{name}"]
    elif method.block == "released":
        commands = [
            *commands,
            "python -m tools.released    # its scores by the released rules",
        ]
    return f"<p>{words}</p><div class='highlight'><pre>{escape(chr(10).join(commands))}</pre></div>"


def _dots(methods: Iterable[Standing]) -> str:
    scores = {method.name: [method.scores[variant] for variant in VARIANTS] for method in methods}
    shown = [method.name for name, method in own_methods().items() if name in HEADLINE]
    about = "Mean scores over the tasks that have the variant, with 95 % intervals"
    variants = [_heading(variant) for variant in VARIANTS]
    chart = Chart(scores, variants, "Variant (number of tasks)", about, shown=shown)
    return f"{about}. The list below switches methods on and off.\n\n{chart.html()}"


Chances = Mapping[tuple[str, str], float]
"""Two methods -> the probability that a run of the first beats one of the second."""


def _comparison(methods: Mapping[str, Standing], beats: Chances) -> str:
    """A form to choose two methods; site.js fills in their scores, and shows their episodes."""
    data = {
        "scores": {name: {column: text(one.scores[column]) for column in COLUMNS} for name, one in methods.items()},
        "beats": {f"{a} {b}": f"{chance:.2f}" for (a, b), chance in beats.items()},
        "watched": {name: ["-".join(pair) for pair in _stored(one)] for name, one in methods.items()},
    }
    options = "".join(f'<option value="{name}">{escape(one.name)}</option>' for name, one in methods.items())
    first, second = (options.replace(f'"{name}"', f'"{name}" selected') for name in COMPARED)
    pairs = "".join(f"<option>{task}-{variant}</option>" for task, variant in ENVIRONMENTS)
    seeds = "".join(f"<option>{seed}</option>" for seed in range(SCENES))
    fields = (
        f'<label>Method <select name="first">{first}</select></label>'
        f'<label>and <select name="second">{second}</select></label>'
        f'<label>in <select name="environment">{pairs}</select></label>'
        f'<label>scene <select name="seed">{seeds}</select></label><button>Watch both</button>'
    )
    return (
        f'<details class="comparing"><summary>Compare two methods</summary><form class="compare">{fields}</form>'
        f'<div class="wide" tabindex="0" role="region" aria-label="Comparison">'
        f'<table class="compared"></table></div><p class="chance"></p><div class="sides watched"></div>'
        f'<script type="application/json" id="compared">{json.dumps(data)}</script></details>'
    )


def _beats(methods: Mapping[str, Standing]) -> Chances:
    """The probability that a run of the first method beats one of the second, for each pair by the same rules."""
    return {(a, b): improvement(methods[a], methods[b]) for a, b in permutations(methods, 2)}


def _duels(methods: Mapping[str, Standing], beats: Chances) -> str:
    """The probabilities between the methods of a block, whose comparison is fair."""
    words = (
        "The probability that a run of the method on the left beats a run of the method above in the same environment "
        "(equal scores count one half), for the methods of each category."
    )
    parts = [words]
    for block, heading in BLOCKS.items():
        group = {name: method for name, method in methods.items() if method.block == block}
        if len(group) < 2:
            continue
        head = "".join(f'<th scope="col">{escape(method.name)}</th>' for method in group.values())
        body = ""
        for a, method in group.items():
            cells = "".join("<td></td>" if a == b else _chance(beats[a, b]) for b in group)
            body += f'<tr><th scope="row">{escape(method.name)}</th>{cells}</tr>'
        table = f'<table class="duels"><thead><tr><td></td>{head}</tr></thead><tbody>{body}</tbody></table>'
        region = (
            f'<div class="wide" tabindex="0" role="region" aria-label="Who beats whom: {escape(heading)}">{table}</div>'
        )
        parts.append(f"<details><summary>{heading}</summary>{region}</details>")
    return "\n\n".join(parts)


def _chance(chance: float) -> str:
    return f'<td class="figure" style="--share: {round(100 * chance)}%">{chance:.2f}</td>'


def _costs(methods: Iterable[Standing]) -> str:
    lines = [f"| Method | {ABOVE} | Demonstrations a task | Hours a run | Device | Steps a run in the simulator |"]
    lines.append("| --- | ---: | ---: | ---: | --- | ---: |")
    for method in sorted(methods, key=lambda method: method.rank):
        card = method.entry.card
        hours, steps = card.training.hours, card.training.steps
        cells = (
            f"{method.scores[ABOVE].value:.2f}".replace("-0.00", "0.00") if method.everywhere else "",
            card.demonstrations.per_task,
            hours,
            card.training.device,
            None if steps is None else f"{steps:,}" if steps else "none",
        )
        lines.append(f"| {label(method)} | {' | '.join('' if cell is None else str(cell) for cell in cells)} |")
    return "Of one run, as its entry states it. Empty cells are not known.\n\n" + "\n".join(lines)


def _stored(method: Standing) -> dict[tuple[str, str], dict[int, EpisodeResult]]:
    """The first run's episodes in the scenes that the page to play on has, by environment and seed."""
    episodes: dict[tuple[str, str], dict[int, EpisodeResult]] = defaultdict(dict)
    if method.entry.episodes:
        first = method.entry.runs[0]
        for episode in method.entry.counted:
            shown = episode.run == first and episode.seed < SCENES and episode.failure is None
            if shown and obstacle(episode) is None:
                episodes[episode.task, episode.variant][episode.seed] = episode
    return episodes


def write_replays(methods: Mapping[str, Standing], folder: Path) -> None:
    """Writes a file `<name>.json` with the stored actions of each method, and `index.json`.

    The index has the names of the methods, and the scores of the stored episodes by environment and seed.
    """
    folder.mkdir(parents=True)
    index = {}
    for name, method in methods.items():
        if method.kind == "published":
            continue
        stored = _stored(method)
        places = {"-".join(pair): dict(sorted(stored[pair].items())) for pair in ENVIRONMENTS if pair in stored}
        actions = {place: {seed: one.actions for seed, one in of.items()} for place, of in places.items()}
        scores = {place: {seed: round(one.score, 3) for seed, one in of.items()} for place, of in places.items()}
        index[name] = {"name": method.name, "scores": scores}
        (folder / f"{name}.json").write_text(json.dumps(actions, separators=(",", ":")), encoding="utf-8")
    (folder / "index.json").write_text(json.dumps(index, separators=(",", ":")), encoding="utf-8")


def headline(methods: Mapping[str, Standing]) -> str:
    """A chart of some entries' mean scores, by variant."""
    scores = {shown: [methods[name].scores[variant] for variant in VARIANTS] for name, shown in HEADLINE.items()}
    about = "Mean scores over the tasks that have the variant: all but planning fall from Demo to Layout"
    return Chart(scores, [_heading(variant) for variant in VARIANTS], "Variant (number of tasks)", about).html()
