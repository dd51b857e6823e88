"""`magical-mj demos questions`: questions about what demonstrations were for, as files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from magical_mj.cli.console import console, counting
from magical_mj.utils.errors import counted


def make_questions(
    task: Annotated[str, Argument(help="choose, say, place or act.")],
    to: Annotated[Path, Option(help="The folder, which must not exist, or be empty.")],
    set_: Annotated[str, Option("--set", help="The set of intents.")] = "dev",
    scenes: Annotated[int, Option(help="Number of demo scenes: 1, 2, 4 or 8.")] = 4,
    demonstrations: Annotated[
        int | None, Option(help="Number of demonstrations.", show_default="one in each demo scene")
    ] = None,
    contrasting: Annotated[bool, Option("--contrasting", help="Choose demo scenes that refute simple rivals.")] = False,
    frames: Annotated[int, Option(help="Scenes between the first and the last one of a demonstration.")] = 0,
    given: Annotated[str, Option(help="demonstrations, sentence, both, nothing or wrong.")] = "demonstrations",
    seed: Annotated[int, Option(help="The seed of the questions.")] = 0,
    limit: Annotated[int | None, Option(help="The largest number of questions.", show_default="all")] = None,
) -> None:
    """Write questions about what demonstrations were for: JSON lines with pictures, and a Croissant file."""
    from magical_mj.intents.question import expected, questions
    from magical_mj.intents.question_files import write  # imported late: it loads the simulator

    made = questions(
        task,
        set_,
        scenes=scenes,
        demonstrations=demonstrations,
        contrasting=contrasting,
        frames=frames,
        given=given,
        seed=seed,
        limit=limit,
    )
    screen = console()
    total = expected(task, set_, scenes, limit)
    with counting(screen, "questions") as watch:
        number = write(made, to, f"magical_mj-{task}-{set_}", lambda count: watch(count, total))
    screen.print(f"{counted(number, 'question')} in {to}", soft_wrap=True)
