"""Four tasks for Inspect (https://inspect.aisi.org.uk): what were demonstrations for?

`inspect eval magical_mj/choose --model PROVIDER/MODEL -T scenes=4 -T form=pictures` evaluates a language model or a
vision-language model. The other tasks are `say`, `place` and `act`; see `magical_mj.intents.questions`. Inspect brings
models, retries, logs and a viewer. Needs the extra ``inspect``.
"""

from __future__ import annotations

from typing import Any

from inspect_ai import Task, task
from inspect_ai.dataset import MemoryDataset, Sample
from inspect_ai.model import ChatMessageUser
from inspect_ai.solver import Solver, generate

from magical_mj.integrations.inspect_ai.acting import agent
from magical_mj.integrations.inspect_ai.content import FORMS, contents
from magical_mj.integrations.inspect_ai.scoring import judged, misread, repaired
from magical_mj.intents.question import Question, questions
from magical_mj.intents.question_text import prompt
from magical_mj.protocol import INTENTS
from magical_mj.utils.errors import check_name


@task
def choose(form: str = "text", **options: Any) -> Task:
    """Choose the final scene that satisfies the demonstrated intent: one of four, so a guess scores .25.

    Args:
        form: "text" shows scenes as tables of poses, "pictures" as pictures with numbered blocks, "both" as both.
        **options: set, scenes, demonstrations, contrasting, frames, given, seed and limit; see
            `magical_mj.intents.questions`.
    """
    return _task("choose", form, options, generate())


@task
def say(form: str = "text", english: bool = False, **options: Any) -> Task:
    """Say the intent. The score is the agreement with the intent in 50 scenes.

    Args:
        form: as for `choose`.
        english: ask for one of the language's sentences instead of one of its texts.
        **options: as for `choose`.
    """
    return _task("say", form, options, generate(), repaired(english), english=english)


@task
def place(form: str = "text", **options: Any) -> Task:
    """Place the blocks in a new scene. The final poses must be legal and satisfy the intent.

    Args:
        form: as for `choose`.
        **options: as for `choose`.
    """
    return _task("place", form, options, generate())


@task
def act(form: str = "text", **options: Any) -> Task:
    """Reach the intent in a simulated scene, with the tools move, drive, look and done.

    Args:
        form: as for `choose`.
        **options: as for `choose`. The seed is that of the scene.
    """
    return _task("act", form, options, agent(form))


def _task(name: str, form: str, options: dict[str, Any], *solvers: Solver, english: bool = False) -> Task:
    check_name("form", form, FORMS)
    samples = [_sample(question, form, english) for question in questions(name, **options)]
    return Task(
        dataset=MemoryDataset(samples, name=name),
        solver=list(solvers),
        scorer=[judged(english), misread(english)],
        version=INTENTS,
    )


def _sample(question: Question, form: str, english: bool) -> Sample:
    content = [part for shown in prompt(question, english=english) for part in contents(shown, form)]
    return Sample(
        id=question.id,
        input=[ChatMessageUser(content=content)],
        target=question.answer,
        metadata={"question": question.data},
    )
