"""What Inspect's logs say: `python -m magical_mj.integrations.inspect_ai`.

- ``misread LOGS``: what the answers of models, and of people in studies (``study.jsonl``), follow.
- ``episodes LOGS --out FOLDER``: an evaluation of the episodes of `act`, whose actions are played again.
"""

from __future__ import annotations

import json
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer
from inspect_ai.log import EvalSample, list_eval_logs, read_eval_log
from rich.table import Table
from typer import Argument, Option

import magical_mj
from magical_mj.cli.app import run
from magical_mj.cli.console import console
from magical_mj.integrations.inspect_ai.scoring import ACTIONS, KINDS_OF_ANSWERS, followed, group_of, interval
from magical_mj.intents import question_of
from magical_mj.intents.question import Verdict
from magical_mj.policies.interface import NOOP, Episode
from magical_mj.tasks.registry import sample_scene
from magical_mj.utils.errors import SettingsError
from magical_mj.utils.lines import read_lines

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


class Given(NamedTuple):
    """An answer.

    Attributes:
        who: the model, or "people".
        group: the set and the kind of the question.
        followed: one of `KINDS_OF_ANSWERS`.
        intent: the intent.
        misread: the reading that the answer took it for; empty if it is right, or none is known.
    """

    who: str
    group: str
    followed: str
    intent: str
    misread: str


@app.command("misread")
def print_misread(
    logs: Annotated[list[Path], Argument(help="Logs, folders of them, and study.jsonl of studies.", exists=True)],
) -> None:
    """Print what answers follow, in each set with an interval of 95 %, and the readings of wrong answers."""
    given = [answer for path in logs for answer in (_people(path) if path.suffix == ".jsonl" else _models(path))]
    groups = defaultdict[tuple[str, str], list[Given]](list)
    for answer in given:
        groups[answer.who, answer.group].append(answer)
    shares = Table("answers of", "questions", "follow", "share", "95 %", "answers")
    for (who, group), answers in groups.items():
        for kind in KINDS_OF_ANSWERS:
            flags = [float(answer.followed == kind) for answer in answers]
            if any(flags):
                ends = "{:.2f} to {:.2f}".format(*interval(flags))
                count = f"{sum(flags):.0f} of {len(flags)}"
                shares.add_row(who, group, kind, f"{sum(flags) / len(flags):.2f}", ends, count)
    asked = Counter((answer.who, answer.intent) for answer in given)
    taken = Counter((answer.who, answer.intent, answer.misread) for answer in given if answer.misread)
    readings = Table("answers of", "intent", "taken for", "share", "answers")
    for (who, intent, reading), number in taken.most_common():
        count = asked[who, intent]
        readings.add_row(who, intent, reading, f"{number / count:.2f}", f"{number} of {count}")
    console().print(shares, *([readings] if taken else []))


def _models(logs: Path) -> Iterator[Given]:
    for model, sample in _samples(logs):
        scores = sample.scores or {}
        if "misread" not in scores:  # an error
            continue
        question = sample.metadata["question"]
        (kind,) = (kind for kind, flag in scores["misread"].as_dict().items() if flag)
        misread = (scores["judged"].metadata or {})["misread"]
        yield Given(model, group_of(question), kind, question["intent"], misread)


@app.command("episodes")
def write_episodes(logs: Logs, out: Annotated[Path, Option(help="The folder of the evaluation.")]) -> None:
    """Make an evaluation of the episodes of `act`. Those in the scenes of seed 0 are played again."""
    actions = dict[str, list[int]]()
    for _, sample in _samples(logs):
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


def _people(log: Path) -> Iterator[Given]:
    """The answers of the participants of a study, from its study.jsonl."""
    for _, line in read_lines(log, SettingsError):
        event = json.loads(line)
        if event["event"] == "answered":
            verdict = Verdict(float(event["right"]), event["right"], event["right"], event["misread"])
            yield Given("people", group_of(event), followed(verdict), event["intent"], event["misread"])


def _samples(logs: Path) -> Iterator[tuple[str, EvalSample]]:
    """The samples of logs, each with its model."""
    names = list_eval_logs(str(logs)) if logs.is_dir() else [str(logs)]
    for log in map(read_eval_log, names):
        yield from ((log.eval.model, sample) for sample in log.samples or ())


if __name__ == "__main__":
    sys.exit(run(commands=app, name="python -m magical_mj.integrations.inspect_ai"))
