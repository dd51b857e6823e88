"""Plays the expert, the random and the no-op agent in shifted environments: the table of docs/shifts.md.

Only axes that change the physics are played: the others change neither what these agents see nor what they do, so that
their scores are those without a shift. Episodes are kept as they end, so that an interrupted run goes on.

    python tools/shifts.py play --episodes 50 --strengths 0,5 --processes 2
    python tools/shifts.py table
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

import magical_mj
from magical_mj.policies.agents import AGENTS
from magical_mj.policies.interface import Episode, begin, play
from magical_mj.shifts import SHIFTS, shift_label

PHYSICAL = ("pose", "clutter", "latency", "slip", "friction")
EPISODES = Path(__file__).parents[1] / "out" / "shifts.jsonl"
Key = tuple[str, str, str, int]
"""Agent, task, label of the shift, seed."""


def episode(key: Key) -> tuple[Key, float]:
    """Plays one episode of a Demo environment; its score."""
    agent, task, label, seed = key
    policy = AGENTS[agent]()
    with closing(magical_mj.Engine(task, seed=seed, shifts=label.replace("+", ","))) as env:
        begin(policy, Episode(task, "Demo", seed, env=env))
        for _ in play(env, iter(lambda: policy(None), None)):
            pass
        return key, env.score()


def keys(agents: list[str], axes: list[str], strengths: list[int], episodes: int) -> Iterator[Key]:
    """The episodes in the order in which they are played: all axes of a seed before the next seed."""
    settings = [{axis: strength} for axis, strength in itertools.product(axes, strengths) if strength]
    labels = [*([""] if 0 in strengths else []), *map(shift_label, settings)]
    for seed, agent, label, task in itertools.product(range(episodes), agents, labels, magical_mj.TASKS):
        axis = label.partition(":")[0]
        if not axis or not SHIFTS[axis].supports(task):
            yield agent, task, label, seed


def scores() -> dict[Key, float]:
    """The episodes that were played so far."""
    lines = EPISODES.read_text().splitlines() if EPISODES.exists() else []
    return {tuple(key): score for key, score in map(json.loads, lines)}


def table() -> str:
    """Mean scores: a row for each agent and axis, a column for each strength."""
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


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("play", "table"))
    parser.add_argument("--agents", default="expert,random,noop")
    parser.add_argument("--axes", default=",".join(PHYSICAL))
    parser.add_argument("--strengths", default="0,1,2,3,4,5")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--processes", type=int, default=1)
    given = parser.parse_args()
    if given.command == "play":
        played = scores()
        strengths = [int(strength) for strength in given.strengths.split(",")]
        wanted = keys(given.agents.split(","), given.axes.split(","), strengths, given.episodes)
        missing = [key for key in wanted if key not in played]
        EPISODES.parent.mkdir(exist_ok=True)
        with ProcessPoolExecutor(given.processes) as pool, EPISODES.open("a") as file:
            for result in pool.map(episode, missing):
                file.write(json.dumps(result) + "\n")
                file.flush()
    print(table())


if __name__ == "__main__":
    main()
