"""What Inspect's logs say: `python -m magical_mj.integrations.inspect_ai`.

- ``misread LOGS``: counts the readings that wrong answers followed.
- ``episodes LOGS --out FOLDER``: an evaluation of the episodes of `act`, in which their actions are played again.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import typer
from inspect_ai.log import EvalSample, list_eval_logs, read_eval_log
from rich.table import Table
from typer import Argument, Option

import magical_mj
from magical_mj.cli.app import run
from magical_mj.cli.console import console
from magical_mj.integrations.inspect_ai.scoring import ACTIONS
from magical_mj.intents import question_of
from magical_mj.policies.interface import NOOP, Episode
from magical_mj.tasks.registry import sample_scene
from magical_mj.utils.errors import SettingsError

app = typer.Typer(no_args_is_help=True, add_completion=False, help=__doc__)
Logs = Annotated[Path, Argument(help="A folder of logs, or one log.", exists=True)]


class Taped:
    """Plays the actions of a model's episodes again.

    Args:
        actions: task -> the actions in the variant All, in the scene of the seed.
        seed: the seed.
    """

    uses_simulation = True  # the model's tools did

    def __init__(self, actions: dict[str, list[int]], seed: int) -> None:
        self._actions, self._seed = actions, seed

    def reset(self, episode: Episode) -> None:
        """Begins an episode."""
        if episode.env is None or episode.env.task is None:
            raise SettingsError("a model's episodes are played again in single environments only")
        if episode.seed != self._seed or episode.variant != "All":
            raise SettingsError(
                f"the model has played seed {self._seed} of All, not {episode.seed} of {episode.variant}"
            )
        self._next = iter(self._actions[episode.env.task])

    def __call__(self, _: Any) -> int:
        """The next action; the no-op after the last one."""
        return next(self._next, NOOP)


@app.command("misread")
def print_misread(logs: Logs) -> None:
    """Count the readings that wrong answers followed."""
    counts = Counter[tuple[str, str]]()
    for sample in _samples(logs):
        score = (sample.scores or {}).get("judged")
        if score is not None and (reading := (score.metadata or {}).get("misread")):
            counts[sample.metadata["question"]["intent"], reading] += 1
    screen = console()
    grid = Table("intent", "taken for", "answers")
    for (intent, reading), number in counts.most_common():
        grid.add_row(intent, reading, str(number))
    screen.print(grid)


@app.command("episodes")
def write_episodes(logs: Logs, out: Annotated[Path, Option(help="The folder of the evaluation.")]) -> None:
    """Make an evaluation of the episodes of `act`. Those in the scenes of seed 0 are played again."""
    actions = dict[str, list[int]]()
    for sample in _samples(logs):
        question = sample.metadata["question"]
        if question["task"] != "act" or ACTIONS not in sample.store:
            continue
        name = question["name"]
        if question_of(question).scene != sample_scene(name, "All", 0):
            raise SettingsError(f"{question['id']} was played with another seed than 0, whose scene evaluations have")
        if name in actions:
            raise SettingsError(f"{question['id']} occurs twice: give the log of one model and one epoch")
        actions[name] = list(sample.store[ACTIONS])
    if not actions:
        raise SettingsError(f"{logs} has no episode of act")
    magical_mj.evaluate(Taped(actions, 0), tasks=list(actions), variants="All", episodes=1, out=out)


def _samples(logs: Path) -> Iterator[EvalSample]:
    names = list_eval_logs(str(logs)) if logs.is_dir() else [str(logs)]
    for name in names:
        yield from read_eval_log(name).samples or ()


if __name__ == "__main__":
    sys.exit(run(commands=app, name="python -m magical_mj.integrations.inspect_ai"))
