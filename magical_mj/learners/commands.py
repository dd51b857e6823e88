"""`magical-mj train` and `magical-mj experiment`: plug-ins of the command line (see pyproject.toml)."""

from __future__ import annotations

import shlex
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magical_mj import learners
from magical_mj.cli.console import Trust, check_fits, console
from magical_mj.learners.method_settings import check_changes, check_used, users, uses
from magical_mj.learners.watching import Watch, bars, how_to_continue, repeating
from magical_mj.policies.agents import AGENTS
from magical_mj.utils.errors import SettingsError, check_name
from magical_mj.utils.parallel import Backend

if TYPE_CHECKING:
    from magical_mj.learners import Progress as Trained

Method = Annotated[str, typer.Argument(help="bc, gail, wgail-gp, al or goals.", show_default=False)]
Tasks = Annotated[str, typer.Option(help="A task; with --multi-task several, separated by commas, or all.")]
Out = Annotated[Path, typer.Option(help="The run's folder.", show_default=False)]
Seed = Annotated[int, typer.Option(min=0, help="Decides which demonstrations are learnt from, and all else.")]
MultiTask = Annotated[bool, typer.Option("--multi-task", help="One policy for all the tasks.")]
Augment = Annotated[str, typer.Option(help="all, none, or no-trans-rot.")]
Preset = Annotated[str, typer.Option(help="What is looked at, such as LoRes4A.")]
Device = Annotated[str, typer.Option(help="auto, cpu, cuda, ...")]
Worlds = Annotated[
    str, typer.Option(help="What gail, wgail-gp and al play in: single, or batched on DEVICE (extra gpu).")
]
Quick = Annotated[bool, typer.Option("--quick", help="Use a smaller network and a shorter training, for two cores.")]
Change = Annotated[
    list[str] | None, typer.Option("--set", help="Any setting, such as ppo.clip=0.02.", show_default=False)
]
Resume = Annotated[bool, typer.Option("--resume", help="Go on with what is in the folder.")]
File = Annotated[
    Path, typer.Argument(help="TOML: methods, tasks, seeds ...; see docs/learners.md.", show_default=False)
]
Folder = Annotated[Path, typer.Option(help="The folder for runs, evaluations and the report.", show_default=False)]
Jobs = Annotated[
    int | None,
    typer.Option(
        min=1,
        help="Number of simultaneous runs, each on one core; a single run uses all cores.",
        show_default="one, or as many as a cluster can do",
    ),
]
Where = Annotated[Backend, typer.Option(help="Where the runs execute: on this machine or on a cluster.")]
Address = Annotated[str | None, typer.Option(help="Of the cluster, such as tcp://host:8786.", show_default=False)]


def experiment(
    file: File, out: Folder, jobs: Jobs = None, backend: Where = "local", address: Address = None, trust: Trust = False
) -> None:
    """Train and evaluate methods x tasks x seeds. Called again, it continues."""
    del trust  # see magical_mj.utils.imports.command_line
    planned = learners.runs(file, out)
    screen, began = console(), time.time()
    watches: dict[str, Watch] = {}
    with how_to_continue(screen, "the same command continues"), bars(screen) as progress:
        bar = progress.add_task("experiment", total=len(planned), unit="runs", latest="")

        def watch(name: str, trained: Trained) -> None:
            watches[name] = watches.get(name) or Watch(progress, name)
            watches[name](trained)
            if trained.update == trained.updates:
                progress.remove_task(watches.pop(name).bar)

        def look() -> None:
            """How far evaluations are, and trainings in other processes; one in this process tells by itself."""
            if not watches:
                news = filter(None, (run.standing(began) for run in planned))
                progress.update(bar, latest=", ".join(news))

        lines = learners.conduct(planned, out, jobs=jobs, backend=backend, address=address, watch=watch)
        with repeating(look):
            for number, line in enumerate(lines, 1):
                screen.print(line, soft_wrap=True)
                done = min(number, len(planned))  # after the runs come lines about all of them
                progress.update(bar, completed=done, latest="")


def train(
    context: typer.Context,
    method: Method,
    tasks: Tasks,
    out: Out,
    seed: Seed = 0,
    multi_task: MultiTask = False,
    augment: Augment = "all",
    preset: Preset = "LoRes4E",
    device: Device = "auto",
    worlds: Worlds = "single",
    quick: Quick = False,
    change: Change = None,
    resume: Resume = False,
) -> None:
    """Train a policy. OUT then holds the policy, for `magical-mj evaluate --policy OUT`, with settings and metrics."""
    check_name("method", method, learners.METHODS)  # which also says what to install, if something is missing
    given = {"seed": seed, "augment": augment, "preset": preset, "device": device, "ppo.worlds": worlds}
    others = dict(_change(text) for text in change or [])
    check_changes(others, ("method", "tasks", "quick", *given))
    check_used({"preset": preset, **others}, [method])
    check_fits(context, uses(method, "augment"), f"with {', '.join(users('augment'))}", "augment")
    settings = learners.load_settings(method, tasks, quick=quick, **given, **others)
    if len(settings.tasks) > 1 and not multi_task:
        raise SettingsError(
            "one policy for several tasks needs --multi-task; magical-mj experiment trains one for each"
        )
    from magical_mj.learners.learner import keep_freed_memory

    keep_freed_memory()
    screen = console()
    with how_to_continue(screen, "the same command with --resume continues"), bars(screen) as progress:
        learners.train(settings, out, resume=resume, watch=Watch(progress, method))
    folder = shlex.quote(f"./{out}" if str(out) in AGENTS else str(out))
    again = f"magical-mj evaluate --policy {folder} --tasks {','.join(settings.tasks)} --preset {settings.preset}"
    screen.print(f"the policy is in {out}; to evaluate it: {again} --out ...", soft_wrap=True)


def _change(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        raise SettingsError(f"--set wants NAME=VALUE, such as ppo.clip=0.02, not {text!r}")
    return name, value
