"""Measures shifts: the scores of the built-in agents, the speed, the changes of pictures; and draws docs/shifts.png.

Agents play only the axes that change the physics. The built-in agents see no pictures, so the other axes do not change
their scores. Each finished episode is saved, so that an interrupted run can be continued.

    python tools/shifts.py play --episodes 50 --strengths 0,5 --processes 2    (nice -n 19: hours)
    python tools/shifts.py table        scores of the played episodes
    python tools/shifts.py speed        processor time of steps with and without each axis at strength 5
    python tools/shifts.py distance     mean CIELAB distance of pictures from those without a shift
    python tools/shifts.py picture      docs/shifts.png
"""

from __future__ import annotations

import argparse
import itertools
import json
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from pathlib import Path
from time import process_time
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

import magical_mj
from magical_mj.policies.interface import AGENTS, Episode, begin, play_actions
from magical_mj.shifts import SHIFTS, shift_label

PHYSICAL = ("pose", "clutter", "latency", "slip", "friction")
SEEN = {"pose": 1, "camera": 3, "light": 4, "texture": 3, "palette": 3, "clutter": 7, "sensor": 0}
"""The axes that are visible in pictures -> the seed in docs/shifts.png."""
ROOT = Path(__file__).parents[1]
EPISODES = ROOT / "out" / "shifts.jsonl"
Key = tuple[str, str, str, int]
"""Agent, task, label of the shift, seed."""


def episode(key: Key) -> tuple[Key, float]:
    """Plays one episode of a Demo environment. Returns its key and score."""
    agent, task, label, seed = key
    policy = AGENTS[agent]()
    with closing(magical_mj.Engine(task, seed=seed, shifts=label.replace("+", ","))) as env:
        begin(policy, Episode(task, "Demo", seed, env=env))
        for _ in play_actions(env, iter(lambda: policy(None), None)):
            pass
        return key, env.score()


def keys(agents: list[str], tasks: list[str], axes: list[str], strengths: list[int], episodes: int) -> Iterator[Key]:
    """The episodes in the order of play: all axes of a seed come before the next seed."""
    settings = [{axis: strength} for axis, strength in itertools.product(axes, strengths) if strength]
    labels = [*([""] if 0 in strengths else []), *map(shift_label, settings)]
    for seed, agent, label, task in itertools.product(range(episodes), agents, labels, tasks):
        axis = label.partition(":")[0]
        if not axis or not SHIFTS[axis].supports(task):
            yield agent, task, label, seed


def scores() -> dict[Key, float]:
    """The scores of the episodes that were played so far."""
    lines = EPISODES.read_text().splitlines() if EPISODES.exists() else []
    return {tuple(key): score for key, score in map(json.loads, lines)}


def table() -> str:
    """A table of mean scores with a row for each agent and axis, and a column for each strength."""
    groups: dict[tuple[str, str, int], list[float]] = defaultdict(list)
    for (agent, _, label, _), score in scores().items():
        axis, _, strength = label.partition(":")
        groups[agent, axis, int(strength or 0)].append(score)

    def cell(agent: str, axis: str, strength: int) -> str:
        values = groups.get((agent, axis if strength else "", strength))
        return f"{sum(values) / len(values):.3f} ({len(values)})" if values else ""

    lines = ["| Agent | Axis | 0 | 1 | 2 | 3 | 4 | 5 |", "|---|---|---|---|---|---|---|---|"]
    for agent, axis in itertools.product(("expert", "random", "noop"), PHYSICAL):
        lines.append(f"| {agent} | {axis} | " + " | ".join(cell(agent, axis, strength) for strength in range(6)) + " |")
    return "\n".join(lines)


def speed(renderer: str = "software", repeats: int = 5, episodes: int = 10) -> str:
    """A table of processor times in milliseconds per step with the paper's observations, including resets.

    Each is the best of several repeats.
    """
    actions = np.random.default_rng(0).integers(0, 18, 100)

    def run(env: Any) -> float:
        start = process_time()
        for seed in range(episodes):
            env.reset(seed=seed)
            for action in actions:
                env.step(action)
        return 1000 * (process_time() - start) / episodes / len(actions)

    names = [None, *(f"{axis}:5" for axis in SHIFTS)]
    envs = {
        name: gymnasium.make("magical_mj/FindDupe-Demo-LoRes4E-v0", renderer=renderer, shifts=name) for name in names
    }
    times = {name: min(run(env) for _ in range(repeats)) for name, env in envs.items()}
    rows = [f"| {name or 'none'} | {taken:.3f} | {times[None] / taken:.0%} |" for name, taken in times.items()]
    return "\n".join(["| Shift | ms/step | speed |", "|---|---|---|", *rows])


def lab(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    """A picture in CIELAB (D65). Shape (size, size, 3)."""
    level = picture / 255
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    xyz = linear @ np.array([[0.4124, 0.2126, 0.0193], [0.3576, 0.7152, 0.1192], [0.1805, 0.0722, 0.9505]])
    xyz /= [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.stack([116 * f[..., 1] - 16, 500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], axis=-1)


def drawn(axis: str, strength: int, seed: int, size: int, view: str = "ego") -> NDArray[np.uint8]:
    """The first picture of an episode of FindDupe."""
    with closing(magical_mj.Engine("FindDupe", seed=seed, shifts={axis: strength}, renderer="software")) as env:
        return env.render(view, size)


def distance(seeds: int = 30) -> str:
    """A table of the mean CIELAB distance over all pixels and seeds."""
    lines = ["| Axis | 1 | 2 | 3 | 4 | 5 |", "|---|---|---|---|---|---|"]
    for axis in SEEN:
        means = []
        for strength in range(1, 6):
            pairs = [[lab(drawn(axis, each, seed, 96)) for each in (0, strength)] for seed in range(seeds)]
            means.append(np.mean([np.linalg.norm(a - b, axis=-1).mean() for a, b in pairs]))
        lines.append(f"| {axis} | " + " | ".join(f"{mean:.1f}" for mean in means) + " |")
    return "\n".join(lines)


def picture(path: Path = ROOT / "docs" / "shifts.png", size: int = 144) -> None:
    """Draws a column for each axis and a row for each strength. The seed of each axis makes it clearly visible."""
    gap, left, top = 6, 22, 22
    sheet = Image.new("RGB", (left + len(SEEN) * (size + gap), top + 6 * (size + gap)), "white")
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    for column, (axis, seed) in enumerate(SEEN.items()):
        x = left + column * (size + gap)
        draw.text((x + size / 2, top / 2), axis, "black", font, anchor="mm")
        for strength in range(6):
            y = top + strength * (size + gap)
            sheet.paste(Image.fromarray(drawn(axis, strength, seed, size)), (x, y))
            if column == 0:
                draw.text((left / 2, y + size / 2), str(strength), "black", font, anchor="mm")
    sheet.save(path, optimize=True)


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("play", "table", "speed", "distance", "picture"))
    parser.add_argument("--agents", default="expert,random,noop")
    parser.add_argument("--tasks", default=",".join(magical_mj.TASKS))
    parser.add_argument("--axes", default=",".join(PHYSICAL))
    parser.add_argument("--strengths", default="0,1,2,3,4,5")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    if given.command in ("speed", "distance", "picture"):
        print({"speed": speed, "distance": distance, "picture": picture}[given.command]() or "")
        return
    if given.command == "play":
        played = scores()
        strengths = [int(strength) for strength in given.strengths.split(",")]
        agents, tasks, axes = (each.split(",") for each in (given.agents, given.tasks, given.axes))
        wanted = keys(agents, tasks, axes, strengths, given.episodes)
        missing = [key for key in wanted if key not in played]
        EPISODES.parent.mkdir(exist_ok=True)
        with ProcessPoolExecutor(given.processes) as pool, EPISODES.open("a") as file:
            for result in pool.map(episode, missing):
                file.write(json.dumps(result) + "\n")
                file.flush()
    print(table())


if __name__ == "__main__":
    main()
