"""How Inspect scores the answers to questions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from typing import Any, Final

from inspect_ai.model import ChatMessageUser
from inspect_ai.scorer import (
    Metric,
    SampleScore,
    Score,
    Scorer,
    Target,
    Value,
    ci_wilson,
    mean,
    metric,
    scorer,
)
from inspect_ai.solver import Generate, Solver, TaskState, solver

from magical_mj.intents.choices import SHORTCUTS
from magical_mj.intents.intent import parse
from magical_mj.intents.question import Question, Verdict, question_of
from magical_mj.intents.question_text import read_answer
from magical_mj.scene import Scene
from magical_mj.utils.errors import MagicalError

KINDS_OF_ANSWERS: Final = ("intended", *SHORTCUTS, "another reading", "another goal", "no answer")
"""What an answer follows: the intent, a shortcut, another reading of the demonstrations, or another goal."""
FINAL, ACTIONS = "final scene", "actions"
"""The names in a sample's store of an episode's final scene, as JSON, and of its actions."""


@metric
def by_set() -> Metric:
    """The mean in each set, for each kind of question, with an interval of 95 %.

    The interval is Wilson's score interval over the questions. It covers which intents and scenes were drawn.
    """

    def compute(scores: list[SampleScore]) -> Value:
        groups = defaultdict[str, list[float]](list)
        for score in scores:
            groups[group_of((score.sample_metadata or {})["question"])].append(score.score.as_float())
        values: dict[str, float] = {}
        for name, group in groups.items():
            values |= {name: sum(group) / len(group)}
            values |= {f"{name} {end}": bound for end, bound in zip(("lower", "upper"), interval(group), strict=True)}
        return values

    return compute


def group_of(question: Mapping[str, Any]) -> str:
    """The set and the kind of a question, from its data."""
    return " ".join(filter(None, (question["set"], question["kind"])))


def interval(values: Sequence[float]) -> tuple[float, float]:
    """Wilson's interval of 95 % for the mean of values in [0, 1]."""
    ends: Any = ci_wilson()([SampleScore(score=Score(value=value)) for value in values])
    return ends["lower"], ends["upper"]


@scorer(metrics={"*": [mean(), by_set()]})
def judged(english: bool = False) -> Scorer:
    """Checks answers exactly. The metadata of a score has the reading that a wrong answer follows."""

    async def score(state: TaskState, target: Target) -> Score:  # noqa: ARG001 - Inspect passes both
        question, verdict = _checked(state, english)
        values = {
            "choose": {"right": verdict.score},
            "say": {"agreement": verdict.score, "exact": float(verdict.right)},
        }.get(question.task, {"right": verdict.score, "clean": float(verdict.clean)})
        return Score(
            value=values,
            answer=state.output.completion[-200:],
            explanation=verdict.problem or f"The intent is {question.intent}.",
            metadata={"misread": verdict.misread},
        )

    return score


@scorer(metrics={"*": [mean(), by_set()]})
def misread(english: bool = False) -> Scorer:
    """What answers follow: 1 for one of `KINDS_OF_ANSWERS`, and 0 for the others."""

    async def score(state: TaskState, target: Target) -> Score:  # noqa: ARG001 - Inspect passes both
        _, verdict = _checked(state, english)
        return Score(value={kind: float(kind == followed(verdict)) for kind in KINDS_OF_ANSWERS})

    return score


def followed(verdict: Verdict) -> str:
    """What an answer follows: one of `KINDS_OF_ANSWERS`."""
    if verdict.right:
        return "intended"
    if verdict.problem:
        return "no answer"
    named = verdict.misread if verdict.misread in SHORTCUTS else "another reading"
    return named if verdict.misread else "another goal"


def _checked(state: TaskState, english: bool) -> tuple[Question, Verdict]:
    question = question_of(state.metadata["question"])
    try:
        return question, question.check(_answer(question, state, english))
    except MagicalError as error:  # no answer, or one of another form
        return question, Verdict(0.0, False, False, problem=str(error))


def _answer(question: Question, state: TaskState, english: bool) -> str | Scene:
    if question.task == "act":
        return Scene.from_json(state.store.get(FINAL, question.scene.to_json()))
    return read_answer(question, state.output.completion, english=english)


@solver
def repaired(english: bool = False) -> Solver:
    """Gives a model one chance to repair an answer that cannot be read. It is shown the position of the error."""

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        question = question_of(state.metadata["question"])
        try:
            parse(str(read_answer(question, state.output.completion, english=english)))
        except MagicalError as error:
            text = f"This answer cannot be read:\n{error}\nPlease correct it."
            state.messages.append(ChatMessageUser(content=text))
            return await generate(state)
        return state

    return solve
